"""Pull the tissue so that what still bridges the goal is seen and stretched."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from py_trees.common import Status

from behaviours.run_skill import RunSkill
from hardware.gate import Lease
from skills.expose.outcome import ExposeOutcome, Forecast, Planned
from skills.skill import Steps

DECIMALS = 6  # micrometres, micronewtons, microseconds


class Expose(RunSkill[ExposeOutcome]):
    """SUCCESS when the tissue was pulled as far as planned or as a limit allows; FAILURE with the skill's code."""

    MOVES = True

    def skill(self, lease: Lease | None) -> Steps[ExposeOutcome]:
        """Expose under the lease."""
        assert lease is not None
        return self.services.skills.expose(lease)

    def judge(self, outcome: ExposeOutcome) -> Status:
        """Record how it went, and with the controller what was expected of it."""
        expected = {"forecast": outcome.forecast, "planned": outcome.planned}
        self.services.tell(
            "exposed",
            code=outcome.code.value,
            message=outcome.message,
            stopped_by=outcome.stopped_by.value,
            steps=len(outcome.path),
            path=_numbers(outcome.path),
            tension=_numbers(outcome.tension),
            strain=_numbers(outcome.strain),
            stamps=_numbers(outcome.stamps),
            **{name: _columns(columns) for name, columns in expected.items() if columns is not None},
        )
        return super().judge(outcome)


def _columns(columns: Forecast | Planned) -> dict[str, Any]:
    return {field.name: _numbers(getattr(columns, field.name)) for field in fields(columns)}


def _numbers(values: ArrayLike) -> Any:
    """Nested lists of plain numbers; None where a number is not finite, which JSON cannot say."""
    array = np.asarray(values)
    plain = np.round(array, DECIMALS).astype(object)
    plain[~np.isfinite(array)] = None
    return plain.tolist()
