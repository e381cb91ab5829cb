from __future__ import annotations

import json
from dataclasses import fields

import numpy as np
import pytest
from py_trees.common import Status

from behaviours.board import Step, read, result_of
from behaviours.expose import Expose
from hardware.codes import Code
from hardware.gate import Lease
from hardware.interface import GRASPER
from skills.estimate.grid import Grid
from skills.expose.outcome import ExposeOutcome, Forecast, Planned
from skills.expose.pull import Exposure, PullConfig
from skills.skill import Progress, Steps
from tests.mocks.exposing import HangingExecutor, goal_on_sheet, grid_on_sheet, show, steering, take_sheet
from tests.mocks.skills import script
from tests.mocks.stage import Stage
from trees.session import create_root


def exposing(**words: str | list[str]) -> Stage:
    stage = Stage(script(**words))
    stage.build(lambda services: Expose(Step.EXPOSE, services))
    return stage


def test_success_records_how_far_it_went() -> None:
    stage = exposing()

    assert stage.tick(2) is Status.SUCCESS
    how_far = {"steps": 0, "path": [], "tension": [], "strain": [], "stamps": []}
    assert stage.noted("exposed") == [
        {"code": "ok", "message": "expose: ok", "stopped_by": "exposure_steps_done", **how_far},
    ]


def test_what_was_measured_and_expected_is_recorded_as_json_can_say_it(monkeypatch: pytest.MonkeyPatch) -> None:
    two = np.array([0.1, 0.2])
    forecast = Forecast(
        np.array([3, 8]), np.array([[1.0, 1.1], [1.2, np.inf]]), np.ones((2, 2)), np.zeros((2, 2)), np.array([-0.5, np.nan])
    )
    planned = Planned(**{field.name: two * (k + 1) for k, field in enumerate(fields(Planned))})
    outcome = ExposeOutcome(
        Code.OK,
        "pulled 2 of 35 steps",
        Code.STRAIN,
        path=np.array([[0.0005, 0.0, 0.1], [0.001, 1e-9, 0.1]]),
        tension=two,
        strain=np.array([np.nan, 0.3]),
        stamps=np.array([1.4, 1.5]),
        forecast=forecast,
        planned=planned,
    )
    stage = exposing()

    def expose(lease: Lease) -> Steps[ExposeOutcome]:
        yield Progress("exposing")
        return outcome

    monkeypatch.setattr(stage.skills, "expose", expose)

    assert stage.tick(2) is Status.SUCCESS
    (told,) = stage.noted("exposed")
    assert json.loads(json.dumps(told, allow_nan=False)) == told
    assert told["path"] == [[0.0005, 0.0, 0.1], [0.001, 0.0, 0.1]]
    assert (told["steps"], told["tension"], told["strain"], told["stamps"]) == (2, [0.1, 0.2], [None, 0.3], [1.4, 1.5])
    assert told["forecast"]["edges"] == [3, 8]
    assert told["forecast"]["severed"] == [[1.0, 1.1], [1.2, None]] and told["forecast"]["separation"] == [-0.5, None]
    assert list(told["planned"]) == [field.name for field in fields(Planned)] and told["planned"]["deform"] == [0.2, 0.4]


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


def computing(monkeypatch: pytest.MonkeyPatch, free: int) -> tuple[Stage, HangingExecutor]:
    """A session whose controller has had `free` of its computations done and waits for the next one, which does not end."""
    show(monkeypatch)
    stage, executor = Stage(), HangingExecutor(free)
    stage.build(create_root)
    exposure = Exposure(PullConfig(settle=0.1), steering(executor))

    def mark() -> Steps[Grid | None]:
        yield Progress("taking the reference")
        return grid_on_sheet()

    def expose(lease: Lease) -> Steps[ExposeOutcome]:
        grasped = take_sheet(stage.bench)
        return exposure.run(lease, goal_on_sheet, grasped, stage.bench.cutter.pose, mark)

    monkeypatch.setattr(stage.skills, "expose", expose)
    for _ in range(300):
        stage.tick()
        if executor.busy:
            break
    assert executor.busy == 1 and stage.gate.lease is not None and stage.gate.lease.holder == Step.EXPOSE
    return stage, executor


@pytest.mark.parametrize("free", [0, 1, 3], ids=["model", "first step", "third step"])
def test_the_emergency_stop_ends_an_exposure_that_is_computing_within_two_ticks(
    monkeypatch: pytest.MonkeyPatch, free: int
) -> None:
    stage, executor = computing(monkeypatch, free)
    moved = len(stage.bench.motions())

    stage.bench.pressed = True

    assert stage.tick(2) is Status.FAILURE
    assert stage.gate.tripped is not None and stage.gate.tripped.code is Code.EMERGENCY_STOP
    assert stage.settled() and executor.busy == 1
    assert len(stage.bench.motions()) == moved


def test_a_guard_interrupts_an_exposure_that_is_computing(monkeypatch: pytest.MonkeyPatch) -> None:
    stage, _ = computing(monkeypatch, 2)
    stage.bench.eye.freeze()

    for _ in range(10):
        stage.tick()
        if stage.bench.holding():
            break

    assert stage.root.status is Status.RUNNING and stage.gate.tripped is None
    assert stage.settled()


def test_a_plan_that_comes_after_the_exposure_was_stopped_moves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    stage, executor = computing(monkeypatch, 2)
    moved = len(stage.bench.motions(GRASPER))
    stage.bench.pressed = True
    stage.tick(2)

    executor.finish()
    stage.tick(5)

    assert len(stage.bench.motions(GRASPER)) == moved > 0
    assert stage.settled()
