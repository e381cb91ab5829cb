"""A pull that somebody else steers, with what the tissue model expects of it: the estimate asks for that after every exposure."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from hardware.gate import Lease
from hardware.interface import Array
from skills.estimate.grid import Grid
from skills.expose.expected import Expected, Sight, SightConfig, expected_of, sight, tissue_seen
from skills.expose.hypotheses import SeparationConfig
from skills.expose.outcome import ExposeOutcome, Forecast
from skills.expose.pull import Steering, Stop
from skills.grasp import Grasped
from skills.skill import Steps, computed
from skills.tracking.tracks import TrackedGoal


class SteeringForeseen:
    """Steers as `steering` does. Where no model can be built, nothing is expected and the pull goes on."""

    def __init__(
        self,
        steering: Steering,
        config: SightConfig,
        separation: SeparationConfig,
        executor: Executor,
        gaps: Callable[[], Array | None],
    ) -> None:
        self._steering = steering
        self._config = config
        self._separation = separation
        self._executor = executor
        self._gaps = gaps  # openings (E,) [px] along the grid's edges since t_d, nan undecided (`GapWatch.decided`)
        self._expected: Expected | None = None
        self._from = np.zeros(3)

    @property
    def turns(self) -> bool:
        """As the steering does."""
        return self._steering.turns

    def begin(self, lease: Lease, goal: TrackedGoal, grid: Grid, grasped: Grasped) -> Steps[Stop | None]:
        """Let the steering get ready, and build the model."""
        self._expected = None
        stop = yield from self._steering.begin(lease, goal, grid, grasped)
        if stop is None:
            seen = sight(lease, goal, grid, grasped)
            self._expected = yield from computed(self._executor, "building the tissue model", self._build, seen)
        return stop

    def step(self, lease: Lease, here: Array, number: int) -> Steps[Array | Stop]:
        """The steering's step; the model follows the one before."""
        if self._expected is not None and number > 1:
            gaps = self._gaps()
            yield from computed(self._executor, "following the pull", self._expected.executed, here - self._from, gaps)
        self._from = here
        return (yield from self._steering.step(lease, here, number))

    def forecast(self) -> Forecast | None:
        """What was expected so far."""
        return None if self._expected is None else self._expected.forecast()

    def report(self, outcome: ExposeOutcome) -> ExposeOutcome:
        """Add what was expected."""
        told, expected = self._steering.report(outcome), self._expected
        if expected is None:
            return told
        if len(expected.stretches) < len(outcome.path):  # the last step is followed only when there is a next one
            expected.executed(outcome.path[-1] - self._from, self._gaps())
        return replace(told, forecast=expected.forecast())

    def _build(self, seen: Sight) -> Expected | None:
        tissue = tissue_seen(seen, self._config)
        if isinstance(tissue, Stop):
            return None
        expected = expected_of(tissue, seen, self._separation, self._config.xpbd)
        return None if isinstance(expected, Stop) else expected
