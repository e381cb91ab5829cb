from __future__ import annotations

from py_trees.common import Status

from behaviours.board import Step, read, result_of
from behaviours.expose import Expose
from hardware.codes import Code
from tests.mocks.skills import script
from tests.mocks.stage import Stage


def exposing(**words: str | list[str]) -> Stage:
    stage = Stage(script(**words))
    stage.build(lambda services: Expose(Step.EXPOSE, services))
    return stage


def test_success_records_how_far_it_went() -> None:
    stage = exposing()

    assert stage.tick(2) is Status.SUCCESS
    assert stage.noted("exposed") == [{"code": "ok", "message": "expose: ok", "stopped_by": "exposure_steps_done", "steps": 0}]


def test_failure_carries_the_code() -> None:
    stage = exposing(expose="retry")

    assert stage.tick(2) is Status.FAILURE
    result = read(result_of(Step.EXPOSE))
    assert result is not None and result.code is Code.GRASP_SLIPPED


def test_it_pulls_over_many_ticks_under_one_lease() -> None:
    stage = exposing(expose="running")
    stage.tick()
    lease = stage.gate.lease

    assert stage.tick(10) is Status.RUNNING
    assert lease is not None and stage.gate.lease is lease


def test_preempted_the_arms_hold_and_the_grasp_is_kept() -> None:
    stage = exposing(expose="running")
    stage.tick(3)
    jaw = stage.bench.grasper.jaw

    stage.root.stop(Status.INVALID)

    assert stage.settled() and stage.bench.grasper.jaw == jaw
