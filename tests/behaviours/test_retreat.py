from __future__ import annotations

from py_trees.common import Status

from behaviours.board import Step, read, result_of
from behaviours.retreat import Retreat
from hardware.codes import Code
from tests.mocks.skills import script
from tests.mocks.stage import Stage


def retreating(**words: str | list[str]) -> Stage:
    stage = Stage(script(**words))
    stage.build(lambda services: Retreat(Step.RETREAT, services))
    return stage


def test_success_leaves_both_arms_holding() -> None:
    stage = retreating(retreat=["running", "ok"])

    assert stage.tick(3) is Status.SUCCESS
    assert stage.settled()


def test_failure_carries_the_code() -> None:
    stage = retreating(retreat="end")

    assert stage.tick(2) is Status.FAILURE
    result = read(result_of(Step.RETREAT))
    assert result is not None and result.code is Code.MOVE_TIMEOUT


def test_it_moves_under_a_lease() -> None:
    stage = retreating(retreat="running")

    assert stage.tick(2) is Status.RUNNING
    assert stage.gate.lease is not None


def test_preempted_the_arms_hold() -> None:
    stage = retreating(retreat="running")
    stage.tick(3)

    stage.root.stop(Status.INVALID)

    assert stage.settled()
