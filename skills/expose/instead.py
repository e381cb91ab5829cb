"""A pull for tissue of which no model can be built: a goal that bends sharply where it gapes, a surface that scatters."""

from __future__ import annotations

from dataclasses import replace

from hardware.codes import Code
from hardware.gate import Lease
from hardware.interface import Array
from skills.estimate.grid import Grid
from skills.expose.outcome import ExposeOutcome, Forecast
from skills.expose.pull import Steering, Stop
from skills.grasp import Grasped
from skills.skill import Steps
from skills.tracking.tracks import TrackedGoal


class SteeringInstead:
    """Steers as `first` does. Where that finds no usable surface twice in a row, as `second`, which needs none; the outcome says so.

    Once may be the picture's fault, and a model tells more than a pull without one, so another look comes first.
    """

    def __init__(self, first: Steering, second: Steering) -> None:
        self._first, self._second = first, second
        self._now = first
        self._failed = False  # whether the run before found no surface

    @property
    def turns(self) -> bool:
        """As the one that steers now."""
        return self._now.turns

    def begin(self, lease: Lease, goal: TrackedGoal, grid: Grid, grasped: Grasped) -> Steps[Stop | None]:
        """Let the first get ready, or the second one where it cannot again."""
        failed, self._failed, self._now = self._failed, False, self._first
        stop = yield from self._first.begin(lease, goal, grid, grasped)
        if stop is None or stop.code is not Code.SURFACE_INVALID:
            return stop
        if not failed:
            self._failed = True
            return stop
        self._now = self._second
        return (yield from self._second.begin(lease, goal, grid, grasped))

    def step(self, lease: Lease, here: Array, number: int) -> Steps[Array | Stop]:
        """As the one that steers now."""
        return (yield from self._now.step(lease, here, number))

    def forecast(self) -> Forecast | None:
        """As the one that steers now."""
        return self._now.forecast()

    def report(self, outcome: ExposeOutcome) -> ExposeOutcome:
        """As the one that steers now, and that it is the second."""
        told = self._now.report(outcome)
        if self._now is self._first:
            return told
        return replace(told, message=f"{told.message}; pulled straight, as no tissue model could be built")
