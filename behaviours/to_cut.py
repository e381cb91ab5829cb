"""What is to be cut next: the whole goal where it is now, or the corrective segments where they are now."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from behaviours.board import Plan
from hardware.interface import Array
from skills.scene.goal import Goal
from skills.tracking.goal_coordinates import from_goal_coordinates, to_goal_coordinates
from skills.tracking.tracks import TrackedGoal

NO_SEGMENTS = np.zeros((0, 2, 2))


@dataclass(frozen=True)
class ToCut:
    """`polyline` (M, 2) pixels of the whole goal now; `segments` (S, 2, 2) pixels now if the cut is corrective, else None."""

    polyline: Array
    segments: Array | None
    reason: str

    @property
    def pixels(self) -> Array:
        """What will be cut, (..., 2) pixels."""
        return self.polyline if self.segments is None else self.segments


def to_cut(goal: Goal, tracked: TrackedGoal | None, plan: Plan | None, interruptions: int) -> ToCut | None:
    """Say what is to be cut now; None while the goal cannot be seen.

    A plan made before an interruption is stale: then it is the whole goal again, which the operator is asked about anew. A valid
    plan's segments follow the tissue by goal coordinates from the picture they were planned on to the newest one.
    """
    if tracked is None:
        return ToCut(goal.polyline, None, "cut along the goal as drawn")
    if tracked.lost:
        return None
    if plan is None or plan.interruptions != interruptions:
        return ToCut(tracked.polyline, None, "cut along the whole goal, where it is now")
    segments = plan.goal.segments
    if plan.seen is not None and len(segments):
        flat = from_goal_coordinates(tracked, to_goal_coordinates(plan.seen, segments.reshape(-1, 2)))
        segments = flat.reshape(-1, 2, 2)
    if not np.isfinite(segments).all():
        return None
    return ToCut(tracked.polyline, segments, plan.goal.explanation)
