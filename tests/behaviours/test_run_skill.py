"""What all leaves that run a skill have in common, shown on exposure."""

from __future__ import annotations

import numpy as np
import pytest
from py_trees.common import Status

from behaviours.board import Step, lease_of, read, result_of
from behaviours.expose import Expose
from behaviours.session_outcome import StepResult
from hardware.codes import Code
from hardware.interface import CUTTER, GRASPER
from skills.skill import Progress, Steps
from tests.mocks.skills import script
from tests.mocks.stage import Stage


def exposing(**words: str | list[str]) -> Stage:
    stage = Stage(script(**words))
    stage.build(lambda services: Expose(Step.EXPOSE, services))
    return stage


def test_a_skill_starts_under_a_lease_and_says_what_it_does() -> None:
    stage = exposing(expose="running")

    assert stage.tick(2) is Status.RUNNING
    assert stage.gate.lease is not None and stage.gate.lease.holder == "expose"
    assert stage.root.feedback_message == "expose goes on"
    assert read(lease_of(Step.EXPOSE))


def test_success_ends_the_lease_holds_the_arms_and_closes_the_skill() -> None:
    stage = exposing()

    assert stage.tick(2) is Status.SUCCESS
    assert stage.settled()
    assert read(result_of(Step.EXPOSE)) == StepResult(stage.bench.now(), Code.OK, "expose: ok")
    assert not read(lease_of(Step.EXPOSE))


def test_failure_carries_the_code_and_the_sentence() -> None:
    stage = exposing(expose="look")

    assert stage.tick(2) is Status.FAILURE
    assert stage.settled()
    assert read(result_of(Step.EXPOSE)) == StepResult(stage.bench.now(), Code.GOAL_LOST, "expose: goal_lost")


def test_preempting_revokes_the_lease_before_the_skill_can_do_anything() -> None:
    stage = exposing(expose="running")
    stage.tick(3)
    refused: list[Code] = []

    def closing() -> Steps[None]:
        lease = stage.gate.lease
        assert lease is not None
        try:
            yield Progress("moving")
        finally:
            refused.append(lease.move_jaw(GRASPER, 0.5).report().code)

    stage.root._steps = closing()  # type: ignore[attr-defined]
    stage.tick()
    stage.root.stop(Status.INVALID)

    assert refused == [Code.LEASE_REVOKED]
    assert stage.gate.lease is None and stage.bench.holding()
    assert stage.root.feedback_message == "interrupted"


def test_an_exception_is_a_failure_with_its_text_and_the_arms_hold() -> None:
    stage = exposing(expose=["running", "raise"])

    assert stage.tick(3) is Status.FAILURE
    assert stage.settled()
    result = read(result_of(Step.EXPOSE))
    assert result is not None and (result.code, result.message) == (Code.INTERNAL_ERROR, "RuntimeError: expose broke")


def test_stopping_a_leaf_that_never_ran_commands_nothing() -> None:
    stage = exposing()

    stage.root.stop(Status.INVALID)

    assert stage.bench.log == []


def test_stopping_twice_holds_once() -> None:
    stage = exposing(expose="running")
    stage.tick(2)

    stage.root.stop(Status.INVALID)
    before = len(stage.bench.log)
    stage.root.stop(Status.INVALID)

    assert len(stage.bench.log) == before


def test_a_skill_waits_until_the_arms_have_come_to_rest() -> None:
    stage = exposing()
    stage.bench.cutter.delay = 0.2
    stage.bench.cutter.move_jaw(0.5)

    assert stage.tick() is Status.RUNNING
    assert stage.skills.opened == [] and "PSM2 to come to rest" in stage.root.feedback_message
    stage.tick(10)
    assert stage.root.status is Status.SUCCESS


def test_an_arm_that_never_comes_to_rest_trips() -> None:
    stage = exposing()
    stage.bench.cutter.delay = np.inf
    stage.bench.cutter.move_jaw(0.5)

    stage.tick(40)

    assert stage.gate.tripped is not None and stage.gate.tripped.code is Code.ARM_FAULT
    assert stage.skills.begun == []


def test_a_skill_whose_lease_the_gate_has_ended_waits_and_its_outcome_does_not_count() -> None:
    stage = exposing(expose=["running", "ok"])
    stage.tick(2)
    stage.bench.at(stage.bench.now() + 0.01, stage.bench.cutter.power_off)

    assert stage.tick(3) is Status.RUNNING
    assert stage.root.feedback_message == "the safety gate has taken the arms away"
    assert stage.bench.holding()


def test_an_outcome_reached_in_the_very_step_in_which_the_gate_trips_does_not_count() -> None:
    stage = exposing()
    choose = stage.skills.choose

    def trip(step: str, options: tuple[str, ...]) -> str:
        stage.gate.trip(Code.TENSION_ABORT, "the tissue is pulled with 6.0 N")
        return choose(step, options)

    stage.skills.choose = trip

    assert stage.tick(2) is Status.RUNNING
    assert read(result_of(Step.EXPOSE)) is None


def test_nothing_begins_while_the_gate_is_tripped() -> None:
    stage = exposing()
    stage.gate.trip(Code.EMERGENCY_STOP, "the emergency stop is pressed")

    assert stage.tick() is Status.RUNNING
    assert stage.skills.begun == [] and stage.gate.lease is None


def test_a_skill_that_cannot_be_closed_trips() -> None:
    stage = exposing(expose="running")
    stage.tick(2)

    def endless() -> Steps[None]:
        while True:
            try:
                yield Progress("going on")
            except GeneratorExit:
                yield Progress("not ending")

    stage.root._steps = endless()  # type: ignore[attr-defined]
    stage.tick()
    stage.root.stop(Status.INVALID)

    assert stage.gate.lease is None
    assert stage.gate.tripped is not None and stage.gate.tripped.code is Code.INTERNAL_ERROR


@pytest.mark.parametrize("arm", [GRASPER, CUTTER])
def test_both_arms_hold_after_any_end(arm: str) -> None:
    stage = exposing(expose=["running", "retry"])

    stage.tick(3)

    assert [command.name for command in stage.bench.log if command.arm == arm][-1] == "hold"
