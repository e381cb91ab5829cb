"""A segment on the image lifted to 3D: where the blades go, along which way, and how the surface lies there."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array, CameraModel
from skills.scene.stereo import DepthMap, depth_at
from skills.tracking.goal_coordinates import from_goal_coordinates
from skills.tracking.tracks import TrackedGoal

PLACES = 25  # along a segment where depth is read
LEAST_KNOWN = 4  # of these,
LEAST_SHARE = 0.3  # and the share of them, that must have a depth
BESIDE = 8.0  # [px] from a corrective segment to where the tissue that still holds is looked for, on either side of it
REACH = 10.0  # [px] by which a cut of what holds runs into what is open
SUPPORT = 50.0  # [px] along a corrective segment, at least, that tell how the surface lies: over a few, noise in depth tilts it
DEPTH_RADIUS = 5  # [px] of the neighbourhood that a depth is read from


@dataclass(frozen=True)
class Path:
    """A segment lifted to 3D: `points` (N, 3) [m], `across` (N, 3) towards the grasp's side, `pixels` (N, 2), arc length (N,) [m]."""

    points: Array
    across: Array
    pixels: Array
    arc: Array

    @staticmethod
    def through(points: Array, across: Array, pixels: Array, known: NDArray[np.bool_], degree: int = 3) -> Path:
        """Smooth points with gaps: a polynomial in the parameter for each coordinate keeps single bad depths from bending the path.

        Of `degree` where more than 8 points are known, else straight.
        """
        t = np.linspace(-1.0, 1.0, len(points))
        degree = degree if known.sum() > 8 else 1

        def smooth(values: Array) -> Array:
            weights = known.astype(float)
            for _ in range(3):
                fit = np.polynomial.polynomial.polyfit(t[known], values[known], degree, w=weights[known])
                fitted = np.polynomial.polynomial.polyval(t, fit).T
                error = np.linalg.norm(values - fitted, axis=1)
                scale = max(float(np.nanmedian(error[known])), 5e-5)
                weights = np.where(known, 1.0 / (1.0 + (error / (2.5 * scale)) ** 2), 0.0)
            return np.asarray(fitted)

        points, across = smooth(points), smooth(across)
        arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
        return Path(points, across, pixels, arc)

    def part(self, begin: float, end: float) -> Path:
        """The path from the share `begin` to the share `end` of its samples; as many samples."""
        index = np.linspace(begin, end, len(self.points)) * (len(self.points) - 1)

        def read(values: Array) -> Array:
            return np.column_stack([np.interp(index, np.arange(len(values)), values[:, i]) for i in range(values.shape[1])])

        arc = np.interp(index, np.arange(len(self.arc)), self.arc)
        return Path(read(self.points), read(self.across), read(self.pixels), arc - arc[0])

    @property
    def length(self) -> float:
        """[m]."""
        return float(self.arc[-1])

    def pixels_at(self, arcs: tuple[float, ...]) -> Array:
        """Pixels (K, 2) at arc lengths [m]."""
        return np.column_stack([np.interp(arcs, self.arc, self.pixels[:, i]) for i in range(2)])

    def frame_at(self, at: float, stretch: float) -> tuple[Array, Array, Array]:
        """Point, unit tangent over `stretch` [m], and unit surface normal towards the camera, at arc length `at` [m]."""

        def read(values: Array, s: float) -> Array:
            return np.array([np.interp(s, self.arc, values[:, i]) for i in range(3)])

        point = read(self.points, at)
        tangent = read(self.points, min(self.length, at + stretch / 2)) - read(self.points, max(0.0, at - stretch / 2))
        tangent = tangent / np.linalg.norm(tangent)
        normal = np.cross(tangent, read(self.across, at))
        normal = normal / np.linalg.norm(normal)
        if normal @ point > 0:
            normal = -normal
        return point, tangent, normal


def between_rows(goal: TrackedGoal, depth: DepthMap, camera: CameraModel, segment: Array) -> Path | None:
    """Lift a `segment` (2, 2) in goal coordinates between the two rows beside the goal, whose own line may lie in an open gap.

    None where too little depth is known.
    """
    along = np.linspace(segment[0], segment[1], PLACES)
    near, far = (
        _lifted(from_goal_coordinates(goal, np.column_stack([along[:, 0], np.full(PLACES, side)])), depth, camera)
        for side in (1.0, -1.0)
    )
    share = (1.0 + along[:, 1:]) / 2.0
    points = share * near + (1.0 - share) * far
    return _path(points, near - far, from_goal_coordinates(goal, along), 3)


def on_tissue(goal: TrackedGoal, depth: DepthMap, camera: CameraModel, segment: Array, tissue: NDArray[np.bool_]) -> Path | None:
    """Lift a `segment` (2, 2) in goal coordinates onto the `tissue` (H, W) that is seen on both sides of it.

    Where a cut has opened, the rows are the rims of a hole and one of them may be lifted high: the middle between them is thin air, and
    the plane through them no surface. What still holds the two together is right beside the segment. None where too little of it is seen.
    """
    around = _around(goal, segment)
    own, wide = (_on_sides(goal, depth, camera, part, tissue) for part in (segment, around))
    if own is None or wide is None:
        return own
    # Where the surface lies is told by the segment's own tissue, how it is tilted by what is around: over a few pixels noise tilts it.
    steady = wide.part(*_shares(segment, around))
    middle = len(own.points) // 2
    return replace(steady, points=steady.points + own.points[middle] - steady.points[middle])


def _around(goal: TrackedGoal, segment: Array) -> Array:
    """The `segment` (2, 2) in goal coordinates, longer at both ends until it is `SUPPORT` pixels long, but not past the goal's ends."""
    length = _length(from_goal_coordinates(goal, np.linspace(segment[0], segment[1], PLACES)))
    beyond = max(0.0, SUPPORT / max(length, 1.0) - 1.0) / 2.0  # of the segment, at either end
    along = segment[1] - segment[0]
    room = np.where(along[0] > 0.0, [segment[0, 0], 1.0 - segment[1, 0]], [1.0 - segment[0, 0], segment[1, 0]])
    before, after = np.clip(np.maximum(room, 0.0) / max(abs(along[0]), 1e-9), 0.0, beyond)
    return np.asarray(np.array([segment[0] - before * along, segment[1] + after * along]))


def _shares(segment: Array, around: Array) -> tuple[float, float]:
    """Where a `segment` begins and ends within the longer one `around` it on the same line, as shares of that."""
    along = around[1] - around[0]
    begin, end = ((segment - around[0]) @ along) / max(float(along @ along), 1e-18)
    return float(begin), float(end)


def _on_sides(goal: TrackedGoal, depth: DepthMap, camera: CameraModel, segment: Array, tissue: NDArray[np.bool_]) -> Path | None:
    pixels, near, far = _beside(goal, depth, camera, segment, tissue)
    return _path((near + far) / 2.0, near - far, pixels, 1)


def held_part(goal: TrackedGoal, depth: DepthMap, camera: CameraModel, segment: Array, tissue: NDArray[np.bool_]) -> Array:
    """The part (2, 2) of a `segment` in goal coordinates from the first to the last place where tissue is seen on both sides of it.

    Blades that go in where nothing holds push at the rim. `REACH` is added, so that the cut runs into the opening; a segment is left
    as it is where no tissue is seen.
    """
    pixels, near, far = _beside(goal, depth, camera, segment, tissue)
    held = np.flatnonzero(np.isfinite(near + far).all(axis=1))
    length = _length(pixels)
    if not len(held) or not length > 0.0:
        return segment
    ends = np.clip(held[[0, -1]] / (PLACES - 1) + np.array([-1.0, 1.0]) * REACH / length, 0.0, 1.0)
    return np.asarray(segment[0] + ends[:, None] * (segment[1] - segment[0]))


def _beside(
    goal: TrackedGoal, depth: DepthMap, camera: CameraModel, segment: Array, tissue: NDArray[np.bool_]
) -> tuple[Array, Array, Array]:
    """Pixels (N, 2) along the segment, and points (N, 3) on the tissue beside it, nearer to the grasp and farther; nan where none is."""
    along = np.linspace(segment[0], segment[1], PLACES)
    pixels = from_goal_coordinates(goal, along)
    near, far = (from_goal_coordinates(goal, np.column_stack([along[:, 0], np.full(PLACES, side)])) for side in (1.0, -1.0))
    towards = near - far
    step = BESIDE * towards / np.maximum(np.linalg.norm(towards, axis=1, keepdims=True), 1e-9)
    sides = pixels + step, pixels - step
    seen = (np.where(_at(tissue, side)[:, None], side, np.nan) for side in sides)
    near, far = (_lifted(side, depth, camera) for side in seen)
    return pixels, near, far


def _length(pixels: Array) -> float:
    return float(np.linalg.norm(np.diff(pixels, axis=0), axis=1).sum())


def _path(points: Array, across: Array, pixels: Array, degree: int) -> Path | None:
    known: NDArray[np.bool_] = np.asarray(np.isfinite(points).all(axis=1))
    if known.sum() < max(LEAST_KNOWN, LEAST_SHARE * len(points)):
        return None
    return Path.through(points, across, pixels, known, degree)


def _lifted(pixels: Array, depth: DepthMap, camera: CameraModel) -> Array:
    return camera.unproject(pixels, depth_at(depth, pixels, DEPTH_RADIUS))


def _at(mask: NDArray[np.bool_], pixels: Array) -> NDArray[np.bool_]:
    """Whether the `mask` (H, W) holds at each of `pixels` (N, 2); not outside the image."""
    height, width = mask.shape
    with np.errstate(invalid="ignore"):
        nearest = np.rint(np.nan_to_num(pixels, nan=-1.0)).astype(np.int64)
    inside = (nearest >= 0).all(axis=1) & (nearest[:, 0] < width) & (nearest[:, 1] < height)
    return np.asarray(inside & mask[np.clip(nearest[:, 1], 0, height - 1), np.clip(nearest[:, 0], 0, width - 1)])
