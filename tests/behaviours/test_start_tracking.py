from __future__ import annotations

from py_trees.common import Status

from behaviours.board import TRACKING, Step, read, result_of
from behaviours.start_tracking import StartTracking
from hardware.codes import Code
from tests.mocks.skills import script
from tests.mocks.stage import Stage


def starting(**words: str | list[str]) -> Stage:
    stage = Stage(script(**words))
    stage.build(lambda services: StartTracking(Step.START_TRACKING, services))
    return stage


def test_success_is_remembered() -> None:
    stage = starting()

    assert stage.tick(2) is Status.SUCCESS
    assert read(TRACKING)


def test_failure_carries_the_code() -> None:
    stage = starting(start_tracking="failed")

    assert stage.tick(2) is Status.FAILURE
    result = read(result_of(Step.START_TRACKING))
    assert result is not None and result.code is Code.GOAL_LOST
    assert not read(TRACKING)


def test_it_runs_over_several_ticks() -> None:
    stage = starting(start_tracking=["running", "running", "ok"])

    assert stage.tick(3) is Status.RUNNING
    assert stage.tick() is Status.SUCCESS


def test_preempted_it_has_not_started() -> None:
    stage = starting(start_tracking="running")
    stage.tick(2)

    stage.root.stop(Status.INVALID)

    assert not read(TRACKING) and stage.skills.opened == []
