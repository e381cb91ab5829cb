"""A lattice of pixels that follows the goal: one row on its line, the others beside it, and the triangles between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from hardware.interface import Array
from skills.scene.polyline import arc_lengths, at_length, directions
from skills.scene.segments import cross
from skills.scene.tissue import Mask

LEAST_OPENNESS = 0.35  # on the inner side of a bend, before the normals are smoothed more
INSIDE = 6  # a triangle is compared with a mask at its points of barycentric coordinates in steps of 1 / INSIDE


@dataclass(frozen=True)
class Lattice:
    """Vertices in rows across and columns along the goal. Index of a vertex: row * columns + column.

    `pixels` (rows, columns, 2); `station` (columns,) [px] along the goal, 0 at its start; `lateral` (rows,) [px], increasing, 0 on
    the row that lies on the goal; `goal_length` [px].
    """

    pixels: Array
    station: Array
    lateral: Array
    goal_length: float

    def openness(self) -> float:
        """Least area at any corner of any cell as a share of its nominal one: 1 along a straight goal, <= 0 where rows fold over."""
        nominal = np.diff(self.lateral)[:, None] * np.diff(self.station)[None, :]
        return min(float((self._turn() * area / nominal).min()) for area in self._areas())

    def _areas(self) -> list[Array]:
        """Signed area (rows - 1, columns - 1) [px^2] at each of the four corners of each cell, positive turning from u to v."""
        along, across = np.diff(self.pixels, axis=1), np.diff(self.pixels, axis=0)
        return [cross(a, b) for a in (along[:-1], along[1:]) for b in (across[:, :-1], across[:, 1:])]

    def _turn(self) -> float:
        """+1 if lateral lies to the left-normal side of the goal, else -1."""
        return 1.0 if sum(float(area.sum()) for area in self._areas()) >= 0 else -1.0

    def triangles(self, covered: Mask) -> NDArray[np.int32]:
        """Triangles (F, 3) that lie wholly in the mask `covered` (H, W), wound so that normals face the camera.

        The diagonals alternate, so that no direction is stiffer than another; where one corner of a cell lies outside, the triangle
        of the other three is kept.
        """
        rows, columns = self.pixels.shape[:2]
        index = np.arange(rows * columns).reshape(rows, columns)
        a, b, c, d = (q.ravel() for q in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
        # Both ways to halve the cell a b c d: along a-c, and along b-d.
        choices: NDArray[np.int64] = np.stack([[[a, b, c], [a, c, d]], [[a, b, d], [b, c, d]]])  # (2, 2, 3, cells)
        flat = self.pixels.reshape(-1, 2)
        inside = _inside(flat[np.moveaxis(choices, 2, -1)], covered)  # (2, 2, cells)
        even = (np.add.outer(np.arange(rows - 1), np.arange(columns - 1)) % 2).ravel() == 0
        count = inside.sum(axis=1)
        first = np.where(count[0] == count[1], even, count[0] > count[1])
        chosen = np.where(first, choices[0], choices[1])  # (2, 3, cells)
        kept = np.where(first, inside[0], inside[1])
        triangles = np.moveaxis(chosen, 1, -1)[kept]
        # With v down, a triangle that turns from u to v looks away from the camera.
        return np.ascontiguousarray(triangles[:, ::-1] if self._turn() > 0 else triangles, dtype=np.int32)


def lay(
    polyline: Array, side: float, spacing: tuple[float, float], along: tuple[float, float], across: tuple[float, float]
) -> Lattice:
    """Lay the lattice on `polyline` (M, 2), which goes straight on beyond its ends. All lengths in pixels.

    `side` is +1 if lateral is positive on the side of `left_normals`, else -1; `spacing` (along, across); the lattice reaches at
    least `along` (before, beyond) the goal and `across` (far, near) to its sides.
    """
    s = arc_lengths(polyline)
    length = float(s[-1])
    count = max(2, round(length / spacing[0]))
    step = length / count
    before, beyond = (max(1, int(np.ceil(m / step))) for m in along)
    station = step * np.arange(-before, count + beyond + 1, dtype=np.float64)
    far, near = (max(1, int(np.ceil(m / spacing[1]))) for m in across)
    lateral = spacing[1] * np.arange(-far, near + 1, dtype=np.float64)
    line = at_length(polyline, station)
    # Beyond its ends the line keeps the direction of its first and last cell; a tracked line's last segment may be short and crooked.
    first, last = line[before + 1] - line[before], line[-beyond - 1] - line[-beyond - 2]
    for direction, past in ((first, np.minimum(station, 0.0)), (last, np.maximum(station - length, 0.0))):
        line = line + past[:, None] * direction / max(float(np.linalg.norm(direction)), 1e-9)
    angle = np.unwrap(np.arctan2(*directions(line).T[::-1]))
    # Where the goal bends, rows on the inner side crowd and at last fold over: normals that turn more slowly keep them apart.
    for width in (0.7, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0):
        smooth = gaussian_filter1d(angle, width, mode="nearest")
        normals = side * np.column_stack([-np.sin(smooth), np.cos(smooth)])
        pixels = line[None] + lateral[:, None, None] * normals[None]
        lattice = Lattice(pixels, station, lateral, length)
        if lattice.openness() >= LEAST_OPENNESS:
            break
    return lattice


def _inside(corners: Array, covered: Mask) -> NDArray[np.bool_]:
    """Which triangles of `corners` (..., 3, 2) pixels lie in `covered` (H, W) at all points of a fine grid on them."""
    height, width = covered.shape
    i, j = np.meshgrid(np.arange(INSIDE + 1), np.arange(INSIDE + 1), indexing="ij")
    i, j = i[i + j <= INSIDE], j[i + j <= INSIDE]
    weights = np.column_stack([i, j, INSIDE - i - j]) / INSIDE
    points = np.rint(weights @ corners)
    within: NDArray[np.bool_] = np.asarray(((points >= 0) & (points < (width, height))).all(axis=-1))
    at = np.where(within[..., None], points, 0).astype(np.int64)
    return np.asarray((within & covered[at[..., 1], at[..., 0]]).all(axis=-1))
