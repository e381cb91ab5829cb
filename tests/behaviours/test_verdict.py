from __future__ import annotations

from py_trees.common import Status

from behaviours.board import VERDICT, Step, read, result_of
from behaviours.session_outcome import SessionOutcome
from behaviours.verdict import Verdict
from hardware.codes import Code
from tests.mocks.stage import Stage, put


def judging(outcome: SessionOutcome | None) -> Stage:
    stage = Stage()
    stage.build(lambda services: Verdict(Step.VERDICT, services))
    put(VERDICT, outcome)
    return stage


def test_complete_is_success() -> None:
    assert judging(SessionOutcome(Code.COMPLETE, "nothing is left")).tick() is Status.SUCCESS


def test_anything_else_is_a_failure_with_its_code() -> None:
    stage = judging(SessionOutcome(Code.UNVERIFIED, "nobody looked"))

    assert stage.tick() is Status.FAILURE
    result = read(result_of(Step.VERDICT))
    assert result is not None and (result.code, result.message) == (Code.UNVERIFIED, "nobody looked")


def test_no_verdict_is_a_failure() -> None:
    assert judging(None).tick() is Status.FAILURE


def test_after_a_trip_there_is_no_success() -> None:
    stage = judging(SessionOutcome(Code.COMPLETE, "nothing is left"))
    stage.gate.trip(Code.ARM_FAULT, "PSM1 has a fault")

    assert stage.tick() is Status.RUNNING
