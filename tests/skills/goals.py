"""Tracked goals for tests."""

from __future__ import annotations

import numpy as np

from hardware.interface import Array
from skills.scene.polyline import left_normals
from skills.tracking.tracks import TrackedGoal


def tracked_goal(polyline: Array, half: Array | float = 8.0, grasp: tuple[float, float] = (320.0, 60.0)) -> TrackedGoal:
    """Make a fully seen goal with the near row on the left of `polyline` (M, 2), `half` (M,) or one number [px] away."""
    middle = np.asarray(polyline, dtype=np.float64)
    offset = left_normals(middle) * np.broadcast_to(np.asarray(half, dtype=np.float64), (len(middle),))[:, None]
    return TrackedGoal(
        stamp=0.0,
        polyline=middle,
        near=middle + offset,
        far=middle - offset,
        visible=np.ones(len(middle), dtype=bool),
        grasp=np.array(grasp),
        grasp_visible=True,
        lost=False,
        strain=float("nan"),
    )


def straight(length: float = 320.0, count: int = 41, v: float = 240.0) -> Array:
    """Make a horizontal goal (M, 2), drawn right to left so that its left normal points up the image."""
    return np.column_stack([np.linspace(160.0 + length, 160.0, count), np.full(count, v)])
