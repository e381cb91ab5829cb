"""How a step and how a session ended: codes with a sentence, and the rule that picks the one that people are told."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from hardware.codes import Code


@dataclass(frozen=True)
class StepResult:
    """How one leaf ended, at bench time `stamp` [s]."""

    stamp: float
    code: Code
    message: str


@dataclass(frozen=True)
class SessionOutcome:
    """How the session ended: COMPLETE when no tissue connection is left across the goal, otherwise why not."""

    code: Code
    message: str

    @property
    def complete(self) -> bool:
        """Whether the goal was reached."""
        return self.code is Code.COMPLETE


def newest_failure(results: Iterable[StepResult | None]) -> SessionOutcome:
    """Pick the failure that came last from `results` in tree order; of two at one instant the later in the tree."""
    failures = [result for result in results if result is not None and result.code is not Code.OK]
    if not failures:
        return SessionOutcome(Code.INTERNAL_ERROR, "a step failed without saying why")
    _, _, last = max((failure.stamp, place, failure) for place, failure in enumerate(failures))
    return SessionOutcome(last.code, last.message)
