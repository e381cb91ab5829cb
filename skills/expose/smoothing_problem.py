"""What the smoothing of the gripper's steps is given, and whether a plan keeps its limits.

The check looks at the limits and the plan alone. It shares nothing with the program that makes the plan (`smoothing.py`), so that a
mistake in the one does not pass unseen in the other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hardware.codes import Code
from hardware.interface import Array


@dataclass(frozen=True)
class SmoothingConfig:
    """Weight and limits of the smoothing. Lengths [m], time [s]."""

    weight: float = 2.0  # w; 1 to 5 takes out three quarters of the jerk or more at the same exposure
    max_step: float = 0.5e-3  # Euclidean length of a step
    max_speed: float = 5e-3  # [m/s]
    period: float = 0.1  # [s] that one step takes; with max_speed another bound on its length
    max_change: float | None = (
        None  # per axis, from one step to the next; None: only the weight acts. As a limit it forbids a sudden stop
    )
    min_tool_distance: float = 3.0e-3  # gripper to other tool, at the end of each step
    tolerance: float = 1e-6  # excess over a limit, as a length of gripper motion, that the check lets pass

    def __post_init__(self) -> None:
        for name in ("max_step", "max_speed", "period", "min_tool_distance", "tolerance"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} must be finite and above 0, not {value}")
        if not (math.isfinite(self.weight) and self.weight >= 0):
            raise ValueError(f"weight must be finite and not below 0, not {self.weight}")
        if self.max_change is not None and not self.max_change > 0:
            raise ValueError(f"max_change must be above 0 or None, not {self.max_change}")

    @property
    def longest(self) -> float:
        """The longest step [m] that length and speed allow."""
        return min(self.max_step, self.max_speed * self.period)


@dataclass(frozen=True)
class Predicted:
    """A quantity predicted at the end of each step of the nominal, and how it changes with the gripper's place there.

    `value` (h,) and `gradient` (h, 3) [per m], as `sensitivities` gives them; `limit` (inf: none).
    """

    value: Array
    gradient: Array
    limit: float = math.inf


@dataclass(frozen=True)
class SmoothingProblem:
    """What is to be smoothed and what limits it. Left camera frame, [m].

    `nominal` (h, 3) the planned steps u_hat; `position` (3,) of the gripper now; `past` (2, 3) the two steps executed last, the later
    one last, zeros if the gripper stood still; `low`, `high` (3,) the workspace's corners; `other_tool` (3,) where the other tool
    stands; `tension` [N] and `strain` as predicted for the nominal. None: no such limit.
    """

    nominal: Array
    position: Array
    past: Array
    low: Array | None = None
    high: Array | None = None
    other_tool: Array | None = None
    tension: Predicted | None = None
    strain: Predicted | None = None


@dataclass(frozen=True)
class Smoothed:
    """`code` OK and the `steps` (h, 3) [m], or SMOOTHING_INFEASIBLE, a sentence that names the limit, and steps of zeros: hold."""

    code: Code
    message: str
    steps: Array


@dataclass(frozen=True)
class Violation:
    """One limit that a plan breaks: `name`, step number from 1, `excess` [m] of gripper motion, `detail` in the quantity's own unit."""

    name: str
    step: int
    excess: float
    detail: str


def violations(problem: SmoothingProblem, steps: Array, config: SmoothingConfig) -> list[Violation]:
    """The limits that `steps` (h, 3) [m] break by more than the tolerance, worst first.

    Tension and strain are counted as the motion that would bring them back: their excess over the length of their gradient.
    """
    found: list[Violation] = []

    def note(name: str, excess: Array, detail: Array, text: str) -> None:
        t = int(np.argmax(excess))
        if excess[t] > config.tolerance:
            found.append(Violation(name, t + 1, float(excess[t]), text.format(detail[t])))

    path = problem.position + np.cumsum(steps, axis=0)
    length = np.linalg.norm(steps, axis=1) - config.longest
    note("the length of a step", length, length * 1e3, "exceeded by {:.3g} mm")
    if config.max_change is not None:
        change = np.abs(np.diff(np.vstack([problem.past[-1:], steps]), axis=0)).max(axis=1) - config.max_change
        note("the change from step to step", change, change * 1e3, "exceeded by {:.3g} mm")
    outside = np.full(len(steps), -math.inf)
    if problem.low is not None:
        outside = np.maximum(outside, (problem.low - path).max(axis=1))
    if problem.high is not None:
        outside = np.maximum(outside, (path - problem.high).max(axis=1))
    note("the workspace", outside, outside * 1e3, "left by {:.3g} mm")
    if problem.other_tool is not None:
        near = config.min_tool_distance - np.linalg.norm(path - problem.other_tool, axis=1)
        note("the distance to the other tool", near, near * 1e3, "too small by {:.3g} mm")
    planned = problem.position + np.cumsum(problem.nominal, axis=0)
    for name, predicted, unit in (("tension", problem.tension, " N"), ("strain", problem.strain, "")):
        if predicted is None or not math.isfinite(predicted.limit):
            continue
        over = predicted.value + np.einsum("ti,ti->t", predicted.gradient, path - planned) - predicted.limit
        slope = np.maximum(np.linalg.norm(predicted.gradient, axis=1), 1e-9)
        note(f"the predicted {name}", over / slope, over, "above its limit by {:.3g}" + unit)
    return sorted(found, key=lambda violation: -violation.excess)


def unusable(problem: SmoothingProblem) -> str:
    """Why the problem cannot be put to a solver at all; empty if it can."""
    needed: list[tuple[str, Array | None]] = [
        ("planned steps", problem.nominal),
        ("gripper's position", problem.position),
        ("executed steps", problem.past),
        ("other tool's position", problem.other_tool),
    ]
    for name, predicted in (("tension", problem.tension), ("strain", problem.strain)):
        if predicted is None:
            continue
        if not predicted.limit > -math.inf:  # nan as well
            return f"the limit of the {name} is {predicted.limit}"
        if math.isfinite(predicted.limit):
            needed += [(f"predicted {name}", predicted.value), (f"gradient of the {name}", predicted.gradient)]
    for name, values in needed:
        if values is not None and not np.isfinite(values).all():
            return f"the {name} hold a value that is not a finite number"
    if any(corner is not None and np.isnan(corner).any() for corner in (problem.low, problem.high)):
        return "the workspace holds a value that is not a number"
    if problem.low is not None and problem.high is not None and not (problem.low <= problem.high).all():
        return "the workspace is empty: its low corner lies above its high corner"
    return ""
