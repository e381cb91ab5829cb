"""Follows the goal on the image: two rows of tissue points to its sides, the grasp, and after a cut the keypoint grid."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array, Frame, Image
from skills.estimate.gap import GapWatch, darkest_along
from skills.estimate.grid import Grid, GridConfig, grid_around
from skills.scene.goal import Goal
from skills.scene.polyline import arc_lengths, left_normals, resample, side_of
from skills.scene.tissue import TissueConfig, hidden_mask, tissue_mask
from skills.tracking.dis import TrackerDIS
from skills.tracking.placed import neighbours, placed
from skills.tracking.relocate import RelocateConfig, flowed, relocate
from skills.tracking.rows import RowConfig, smooth_row
from skills.tracking.stepwise import TrackerConfig
from skills.tracking.tracker import PointTracker
from skills.tracking.tracks import TrackedGoal, Tracks

ASTRAY = 2.0  # stations by which tissue may come to lie along the goal from where it was when the goal was drawn
FINER = 4  # lines across the goal for each station, on the picture that it was drawn on

NEAR, FAR = 0, 1  # groups of points that move together: the grasp's side of the goal and the other


@dataclass(frozen=True)
class GoalTrackerConfig:
    """Layout of the tracked points, and when the goal counts as lost."""

    row_offset: float = 18.0  # [px] of either row from the goal line: clear of a cut that runs 1.5 mm beside it
    station_spacing: float = 8.0  # [px] along the goal
    between: tuple[float, ...] = (-0.375, 0.375)  # [spacings] beside each edge where an opening must be seen too: thin strands
    min_seen: float = 0.3  # share of the stations
    grid: GridConfig = field(default_factory=GridConfig)
    tracker: TrackerConfig = field(default_factory=TrackerConfig)
    rows: RowConfig = field(default_factory=RowConfig)
    relocate: RelocateConfig = field(default_factory=RelocateConfig)
    tissue: TissueConfig = field(default_factory=TissueConfig)


class GoalTracker:
    """Call `start` once, `update` with each new frame, `mark_reference` right after a cut (t_d); from one thread."""

    def __init__(self, config: GoalTrackerConfig | None = None, tracker: PointTracker | None = None) -> None:
        self.config = config or GoalTrackerConfig()
        self._tracker = tracker or TrackerDIS(self.config.tracker)
        self._tracked: TrackedGoal | None = None
        self._grid: Grid | None = None
        self._gaps: GapWatch | None = None
        self._lost_for = 0
        self._known: dict[str, tuple[Image, TrackedGoal]] = {}  # pictures on which the goal was seen

    def start(self, frame: Frame, goal: Goal) -> TrackedGoal:
        """Begin to follow `goal`, drawn on `frame`; an older goal and its grid are forgotten."""
        c = self.config
        count = max(3, round(arc_lengths(goal.polyline)[-1] / c.station_spacing) + 1)
        line = resample(goal.polyline, count)
        towards_grasp = side_of(goal.polyline, goal.grasp) * left_normals(line)
        near, far = line + c.row_offset * towards_grasp, line - c.row_offset * towards_grasp
        self._grid, self._gaps = None, None
        self._darkest_drawn = _darkest_across(frame.image, near, far)
        self._begin(frame, near, far, goal.grasp, np.zeros((0, 2)), np.zeros(0, dtype=bool))
        tracked = self._read()
        self._lost_for, self._known = 0, {} if tracked.lost else {"drawn": (frame.image, tracked)}
        return tracked

    def update(self, frame: Frame) -> TrackedGoal:
        """Follow the goal into `frame`.

        Raises:
            RuntimeError: `start` was not called.
        """
        self._require_started()
        hidden = hidden_mask(frame.image, self.config.tissue)
        self._tracker.update(frame, hidden)
        tracked = self._read()
        self._lost_for = self._lost_for + 1 if tracked.lost else 0
        if not tracked.lost:
            self._known["newest"] = frame.image, tracked
        elif self._lost_for >= self.config.relocate.patience:
            tracked = self._relocated(frame, hidden) or tracked
        if self._gaps is not None:
            part = self._grid_part()
            self._placed = placed(part, self._neighbours, hidden, hidden.shape[::-1])
            self._gaps.look(frame.image, self._beside_the_goal(part), self._placed, hidden if hidden.any() else None)
        return tracked

    def tracked(self) -> TrackedGoal:
        """Give the goal as the newest frame showed it."""
        return self._require_started()

    def mark_reference(self, frame: Frame) -> Grid:
        """Take `frame` as t_d: lay the keypoint grid around the goal as tracked there, and follow it from now on.

        The rows are laid anew where their smoothed positions are, so that points lost while tools were in the way count again. If
        the goal is lost, so is the grid: all its keypoints stay unseen.
        """
        tracked = self.update(frame)
        tissue = tissue_mask(frame.image, self.config.tissue) | hidden_mask(frame.image, self.config.tissue)
        self._grid = grid_around(tracked, self.config.row_offset, self.config.grid, tissue)
        self._begin(frame, tracked.near, tracked.far, tracked.grasp, self._grid.points, self._grid.near_side)
        self._grid_valid = not tracked.lost
        if not tracked.lost:
            self._known["reference"] = frame.image, tracked
        grid, between = self._grid, self.config.between
        self._gaps = GapWatch(frame.image, grid.points, grid.edges, grid.crosses_goal, between, self._darkest_before(grid))
        self._neighbours = neighbours(self._grid.points, self._grid.near_side)
        self._placed = self._grid_part().visible
        self._read()
        return self._grid

    def grid(self) -> Grid | None:
        """Give the keypoint grid of the newest reference; None before the first."""
        return self._grid

    def gaps(self) -> GapWatch | None:
        """Give what opened along each edge of the grid since t_d; None before the first reference."""
        return self._gaps

    def placed(self) -> NDArray[np.bool_]:
        """Which keypoints (N,) of the grid have a known place now (`skills.tracking.placed`)."""
        return self._placed.copy()

    def grid_tracks(self) -> tuple[Array, Tracks, Grid]:
        """Give the keypoints at t_d (N, 2), where they are now, and the grid.

        Raises:
            RuntimeError: `mark_reference` was not called since the goal was started.
        """
        if self._grid is None:
            raise RuntimeError("there is no keypoint grid before mark_reference")
        return self._grid.points.copy(), self._grid_part(), self._grid

    def _begin(self, frame: Frame, near: Array, far: Array, grasp: Array, grid: Array, grid_near: NDArray[np.bool_]) -> None:
        """Start the tracker on the rows, the grasp and the grid, in this order."""
        count = len(near)
        points = np.vstack([near, far, grasp[None], grid])
        groups = np.concatenate([np.full(count, NEAR), np.full(count, FAR), [NEAR], np.where(grid_near, NEAR, FAR)])
        self._tracker.start(frame, points, groups.astype(np.int64), hidden_mask(frame.image, self.config.tissue))
        self._laid = near.copy(), far.copy()
        self._grid_valid = True

    def _relocated(self, frame: Frame, hidden: NDArray[np.bool_]) -> TrackedGoal | None:
        """Search for both rows where the tissue may have sprung to, and follow them from there; None if they are not found.

        Tissue that slipped from the jaws looks as it did before it was pulled, so older pictures are asked as well. Flow is asked last,
        for what has hardly moved but is creased. The keypoints of an older reference are lost by that: all of them stay unseen.
        """
        config = self.config.relocate
        known = [self._known[name] for name in ("newest", "reference", "drawn") if name in self._known]
        for image, seen in known:
            near, far = (relocate(image, frame.image, row, hidden, config) for row in (seen.near, seen.far))
            if near is not None and far is not None:
                return self._laid_anew(frame, seen, near, far)
        tissue = tissue_mask(frame.image, self.config.tissue) & ~hidden
        for image, seen in known:
            rows = flowed(image, frame.image, (seen.near, seen.far), tissue, config)
            if rows is not None:
                return self._laid_anew(frame, seen, *rows)
        return None

    def _laid_anew(self, frame: Frame, seen: TrackedGoal, near: Array, far: Array) -> TrackedGoal:
        """Follow both rows from where they were found again."""
        grasp = seen.grasp + np.median(near - seen.near, axis=0)
        points, sides = (np.zeros((0, 2)), np.zeros(0, dtype=bool))
        if self._grid is not None:
            points, sides = self._grid.points, self._grid.near_side
        self._begin(frame, near, far, grasp, points, sides)
        self._grid_valid = False
        return self._read()

    def _read(self) -> TrackedGoal:
        """Make the goal from the tracker's points."""
        c, tracks = self.config, self._tracker.tracks()
        m = len(self._laid[0])
        near, near_good = smooth_row(self._laid[0], tracks.points[:m], tracks.visible[:m], tracks.confidence[:m], c.rows)
        part = slice(m, 2 * m)
        far, far_good = smooth_row(self._laid[1], tracks.points[part], tracks.visible[part], tracks.confidence[part], c.rows)
        visible = near_good & far_good
        self._tracked = TrackedGoal(
            stamp=tracks.stamp,
            polyline=(near + far) / 2,
            near=near,
            far=far,
            visible=visible,
            grasp=tracks.points[2 * m],
            grasp_visible=bool(tracks.visible[2 * m]),
            lost=bool(visible.mean() < c.min_seen),
            strain=float("nan"),
        )
        return self._tracked

    def _grid_part(self) -> Tracks:
        tracks, first = self._tracker.tracks(), 2 * len(self._laid[0]) + 1
        part = Tracks(tracks.stamp, tracks.points[first:], tracks.visible[first:], tracks.confidence[first:])
        if self._grid_valid:
            return part
        return replace(part, visible=np.zeros_like(part.visible), confidence=np.zeros_like(part.confidence))

    def _beside_the_goal(self, part: Tracks) -> Array:
        """The keypoints, those of the two rows next to the goal made smooth along it.

        One that has drifted by a station or two would look for an opening across its neighbour's place, not its own.
        """
        grid = self._grid
        assert grid is not None
        columns = int(grid.crosses_goal.sum())
        points = part.points.copy()
        for first in (len(points) // 2 - columns, len(points) // 2):
            row = slice(first, first + columns)
            points[row], _ = smooth_row(
                grid.points[row], part.points[row], part.visible[row], part.confidence[row], self.config.rows
            )
        return points

    def _darkest_before(self, grid: Grid) -> Array:
        """How bright (E,) the darkest place around each edge across the goal was when that was drawn (`darkest_along`); nan elsewhere."""
        stations = np.linspace(0.0, 1.0, len(self._darkest_drawn))
        reach = ASTRAY / (len(self._laid[0]) - 1)
        near = np.abs(grid.station[:, None] - stations) <= reach
        # Where a vessel may have come from is not known to have been free of one.
        return np.where(grid.crosses_goal, np.where(near, self._darkest_drawn, np.inf).min(axis=1), np.nan)

    def _require_started(self) -> TrackedGoal:
        if self._tracked is None:
            raise RuntimeError("the goal tracker must be started with a frame and a goal first")
        return self._tracked


def _darkest_across(image: Image, near: Array, far: Array) -> Array:
    """Brightness (L,) of the darkest place on each line from the near row to the far one (M, 2), as a share of that at its ends."""
    fine = np.linspace(0, len(near) - 1, FINER * (len(near) - 1) + 1)
    rows = [np.column_stack([np.interp(fine, np.arange(len(row)), row[:, k]) for k in (0, 1)]) for row in (near, far)]
    lines = np.arange(2 * len(fine)).reshape(2, -1).T
    return darkest_along(image, np.vstack(rows), lines)
