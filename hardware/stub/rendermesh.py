"""One mesh of all that the endoscope sees: bed, the sheet as a closed shell with walls at its border and cuts, ligaments, tools."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

from hardware.stub.surface import BaseSurface, Ligaments, SheetSurface
from hardware.stub.toolmesh import ToolMesh

Floats = NDArray[np.float32]
Ints = NDArray[np.int32]


class Label(IntEnum):
    """What a pixel shows."""

    NOTHING = 0
    TOP = 1
    UNDERSIDE = 2
    WALL = 3
    BASE = 4
    TOOL = 5
    SEAM = 6  # the floor of a cut that went only part of the way through, and what else is seen of the ligaments there


# A ligament's corners: both lips at its first end and at its second, on the groove's floor (0 to 3) and below, on the underside (4 to 7).
LIGAMENT_FACES = np.array(
    [[0, 1, 2], [2, 1, 3], [4, 6, 5], [6, 7, 5], [0, 4, 1], [1, 4, 5], [2, 3, 6], [3, 7, 6]],  # floor, underside, both ends
    dtype=np.int32,
)


def boundary_edges(triangles: Ints) -> Ints:
    """Directed edges (E, 2) that belong to one triangle only: the sheet's border and the lips of cuts, tissue on the left."""
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]).astype(np.int64)
    count = int(triangles.max(initial=0)) + 1
    forward = edges[:, 0] * count + edges[:, 1]
    backward = edges[:, 1] * count + edges[:, 0]
    return edges[~np.isin(forward, backward)].astype(np.int32)


def incidence(triangles: Ints, count: int) -> csr_matrix:
    """Matrix (count, T) that sums face vectors at vertices."""
    faces = np.repeat(np.arange(len(triangles)), 3)
    ones = np.ones(faces.size, dtype=np.float32)
    return csr_matrix((ones, (triangles.reshape(-1), faces)), shape=(count, len(triangles)))


def vertex_normals(positions: Floats, triangles: Ints, around: csr_matrix) -> Floats:
    """Unit normals (V, 3), area-weighted, to the side from which `triangles` run counter-clockwise."""
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    e, f = b - a, c - a
    # Written out: np.cross costs three times as much.
    face = np.stack(
        [
            e[:, 1] * f[:, 2] - e[:, 2] * f[:, 1],
            e[:, 2] * f[:, 0] - e[:, 0] * f[:, 2],
            e[:, 0] * f[:, 1] - e[:, 1] * f[:, 0],
        ],
        axis=1,
    )
    normals = np.asarray(around @ face)
    length = np.sqrt(np.einsum("ij,ij->i", normals, normals))
    return (normals / np.maximum(length, 1e-20)[:, None]).astype(np.float32)


@dataclass(frozen=True)
class TextureScale:
    """How lengths become texels: `texels` per metre, and the texel at the origin of the coordinates."""

    texels: float
    origin: tuple[float, float]

    def __call__(self, coordinates: Floats) -> Floats:
        """Texel coordinates (..., 2) of `coordinates` (..., 2) [m]."""
        return (coordinates * self.texels + np.array(self.origin, dtype=np.float32)).astype(np.float32)


class RenderMesh:
    """Vertices, normals and triangles for the kernels; the topology is worked out once, the positions are renewed at every frame.

    Triangles lie in the order bed, underside, walls, ligaments, top, tools, so that drawing from the last to the first finds most
    hidden pixels early; vertices in the order bed, top, underside, ligaments, tools.
    """

    def __init__(
        self,
        sheet: SheetSurface,
        base: BaseSurface,
        tools: Sequence[ToolMesh],
        sheet_scale: TextureScale,
        tile_scale: TextureScale,
    ) -> None:
        self.key = topology_key(sheet, tools)
        self._triangles = sheet.triangles
        self._around = incidence(sheet.triangles, len(sheet.positions))
        beds, count, faces = len(base.positions), len(sheet.positions), len(sheet.triangles)
        self._top = slice(beds, beds + count)
        self._bottom = slice(beds + count, beds + 2 * count)
        self.sheet_triangles = faces
        self.first_bottom = len(base.triangles)

        edges = boundary_edges(sheet.triangles)
        a, b = edges[:, 0], edges[:, 1]
        lower = beds + count
        walls = np.concatenate(
            [np.stack([beds + a, lower + a, beds + b], axis=1), np.stack([beds + b, lower + a, lower + b], axis=1)]
        )
        first = beds + 2 * count
        joined = len(sheet.ligaments.ends)
        self._joined = slice(first, first + 8 * joined)
        inside = (np.arange(first, first + 8 * joined, 8)[:, None, None] + LIGAMENT_FACES).reshape(-1, 3)
        first += 8 * joined
        self.first_top = self.first_bottom + faces + len(walls) + len(inside)
        corners = [base.triangles, sheet.triangles[:, ::-1] + lower, walls, inside, sheet.triangles + beds]
        texels = [
            tile_scale(base.texture[base.triangles]),
            tile_scale(sheet.rest[sheet.triangles[:, ::-1]]),
            tile_scale(_wall_coordinates(sheet, a, b)),
            tile_scale(_ligament_coordinates(sheet)),
            sheet_scale(sheet.rest[sheet.triangles]),
        ]
        order = (Label.BASE, Label.UNDERSIDE, Label.WALL, Label.SEAM, Label.TOP)
        labels = [np.full(len(part), label) for part, label in zip(corners, order, strict=True)]
        self._tools: list[slice] = []
        for tool in tools:
            corners.append(tool.triangles + first)
            texels.append(tile_scale(tool.texture[tool.triangles]))
            labels.append(np.full(len(tool.triangles), Label.TOOL))
            self._tools.append(slice(first, first + len(tool.positions)))
            first += len(tool.positions)
        self.corners = np.ascontiguousarray(np.concatenate(corners), dtype=np.int32)
        self.texels = np.ascontiguousarray(np.concatenate(texels), dtype=np.float32)
        self.labels = np.concatenate(labels).astype(np.uint8)
        self.positions = np.zeros((first, 3), dtype=np.float32)
        self.normals = np.zeros((first, 3), dtype=np.float32)
        self.positions[:beds] = base.positions
        self.normals[:beds] = vertex_normals(base.positions, base.triangles, incidence(base.triangles, beds))

    def update(self, sheet: SheetSurface, tools: Sequence[ToolMesh]) -> None:
        """Take over where sheet and tools are now; both must have the topology this mesh was made for."""
        normals = vertex_normals(sheet.positions, self._triangles, self._around)
        half = normals * np.float32(0.5 * sheet.thickness)
        self.positions[self._top] = sheet.positions + half
        self.positions[self._bottom] = sheet.positions - half
        self.normals[self._top] = normals
        self.normals[self._bottom] = -normals
        self.positions[self._joined] = _ligament_corners(sheet.ligaments, sheet.positions + half, sheet.positions - half)
        for tool, place in zip(tools, self._tools, strict=True):
            self.positions[place] = tool.positions
            self.normals[place] = tool.normals


def topology_key(sheet: SheetSurface, tools: Sequence[ToolMesh]) -> tuple[int | bytes, ...]:
    """What must be equal for a `RenderMesh` to serve again.

    A cut changes the sheet's revision, a tear its ligaments, a tool its number of vertices.
    """
    joined = sheet.ligaments
    return (
        sheet.revision,
        len(sheet.positions),
        len(sheet.triangles),
        joined.ends.tobytes(),
        joined.reach.tobytes(),
        joined.depth.tobytes(),
        *(len(tool.positions) for tool in tools),
    )


def _ligament_corners(ligaments: Ligaments, top: Floats, bottom: Floats) -> Floats:
    """Where the corners (8S, ...) of all ligaments are, of values `top` and `bottom` (V, ...) on the two faces of the sheet."""
    upper, lower = top[ligaments.ends], bottom[ligaments.ends]
    floor = upper + np.repeat(ligaments.depth, 2, axis=1)[:, :, None] * (lower - upper)
    corners = np.stack([floor, lower], axis=1)
    near, far = corners[:, :, :2], corners[:, :, 2:]
    far += (1.0 - ligaments.reach[:, None, None, None]) * (near - far)
    return corners.reshape(-1, top.shape[1])


def _ligament_coordinates(sheet: SheetSurface) -> Floats:
    """Texture coordinates (8S, 3, 2) [m] of the ligaments' triangles: those of the walls, and from lip to lip aslant by one thickness."""
    along = _along(sheet)
    top = np.stack([along, np.zeros_like(along)], axis=1)
    corners = _ligament_corners(sheet.ligaments, top, top + np.array([0.0, sheet.thickness], dtype=np.float32)).reshape(-1, 8, 2)
    corners[:, 1::2] += np.float32(sheet.thickness)  # however far they are apart: the flesh between them stretches
    return corners[:, LIGAMENT_FACES].reshape(-1, 3, 2)


def _along(sheet: SheetSurface) -> Floats:
    """One skew projection (V,) [m] of the rest coordinates serves edges of nearly every direction, and agrees where two walls meet."""
    return np.asarray(sheet.rest @ np.array([1.0, 0.37], dtype=np.float32), dtype=np.float32)


def _wall_coordinates(sheet: SheetSurface, a: Ints, b: Ints) -> Floats:
    """Texture coordinates (2E, 3, 2) [m] of both wall triangles on each boundary edge: along the edge, down the thickness."""
    along = _along(sheet)
    top = np.stack([along, np.zeros_like(along)], axis=1)
    low = np.stack([along, np.full_like(along, sheet.thickness)], axis=1)
    return np.concatenate([np.stack([top[a], low[a], top[b]], axis=1), np.stack([top[b], low[a], low[b]], axis=1)])
