"""Where no tissue model can be built twice in a row, the pull goes on without one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hardware.codes import Code
from hardware.interface import Array
from skills.expose.instead import SteeringInstead
from skills.expose.outcome import Forecast
from skills.expose.pull import Stop
from tests.skills.test_pull import NO_WAY, STEP, Pull, ScriptedSteering

FOLDED = Stop(Code.SURFACE_INVALID, "the surface folds over", Code.SURFACE_INVALID)
FORECAST = Forecast(np.zeros(1, np.int64), np.ones((1, 1)), np.ones((1, 1)), np.zeros((1, 1)), np.zeros(1))


class Planned(ScriptedSteering):
    """The first one: it turns, and expects something."""

    def __init__(self) -> None:
        super().__init__()
        self.turns = True

    def forecast(self) -> Forecast:  # type: ignore[override]
        return FORECAST


def straight(number: int) -> Array:
    return STEP[[2, 1, 0]]


def pulls(*answers: Stop | None) -> tuple[list[Pull], Planned, ScriptedSteering]:
    """One pull after another by the same steering, whose first one answers `begin` so."""
    planned, plain = Planned(), ScriptedSteering(straight)
    steering = SteeringInstead(planned, plain)
    made = []
    for answer in answers:
        planned.begins = answer
        pull = Pull(steering, steps=3)  # type: ignore[arg-type]
        pull.outcome = pull.finish()  # type: ignore[attr-defined]
        made.append(pull)
    return made, planned, plain


def test_the_first_one_steers_while_it_can():
    (pull,), _, plain = pulls(None)

    assert pull.outcome.message == "pulled all 3 steps (reported)"
    assert np.diff(pull.outcome.path, axis=0) == pytest.approx(np.array([STEP, STEP]))
    assert pull.steering.turns and pull.exposure.forecast() is FORECAST
    assert not plain.begun


def test_one_surface_that_cannot_be_used_ends_the_pull():
    (pull,), _, plain = pulls(FOLDED)

    assert (pull.outcome.code, len(pull.outcome.path)) == (Code.SURFACE_INVALID, 0)
    assert pull.outcome.message == f"{FOLDED.message} (reported)"
    assert not plain.begun


def test_the_second_in_a_row_is_pulled_without_a_model_and_says_so():
    (_, pull), planned, plain = pulls(FOLDED, FOLDED)

    assert pull.outcome.code is Code.OK
    assert pull.outcome.message == "pulled all 3 steps (reported); pulled straight, as no tissue model could be built"
    assert np.diff(pull.outcome.path, axis=0) == pytest.approx(np.array([straight(1), straight(2)]))
    assert not pull.steering.turns and pull.exposure.forecast() is None
    assert not planned.asked and len(plain.asked) == 3


def test_after_that_the_first_one_is_asked_anew():
    made, _, _ = pulls(FOLDED, FOLDED, None, FOLDED, FOLDED)

    assert [len(pull.outcome.path) for pull in made] == [0, 3, 3, 0, 3]
    assert [pull.outcome.message.endswith("model could be built") for pull in made] == [False, True, False, False, True]


def test_another_reason_is_no_reason_to_pull_without_a_model():
    made, _, plain = pulls(FOLDED, NO_WAY, FOLDED, replace(FOLDED, code=Code.DEPTH_INVALID))

    assert [len(pull.outcome.path) for pull in made] == [0, 0, 0, 0]
    assert not plain.begun


def test_a_second_one_that_cannot_begin_either_ends_the_pull():
    planned, plain = Planned(), ScriptedSteering(straight, begins=NO_WAY)
    planned.begins = FOLDED
    steering = SteeringInstead(planned, plain)
    for expected in (FOLDED, NO_WAY):
        outcome = Pull(steering, steps=3).finish()  # type: ignore[arg-type]

        assert outcome.code is expected.code
