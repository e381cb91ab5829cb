"""The whole tree as a user meets it: how sessions end, what interruptions do, what guards see."""

from __future__ import annotations

from typing import Any

import pytest
from py_trees.common import Status

from behaviours.board import ATTEMPT, INTERRUPTIONS, OUTCOME, Step, read
from behaviours.session_outcome import SessionOutcome
from hardware.codes import Code
from tests.mocks.skills import script
from tests.mocks.stage import Stage
from trees.session import create_root


def session(feedback: bool = True, max_attempts: int = 3, **words: str | list[str]) -> Stage:
    stage = Stage(script(**words), feedback=feedback, max_attempts=max_attempts)
    stage.build(create_root)
    return stage


def outcome() -> SessionOutcome:
    found = read(OUTCOME)
    assert found is not None
    return found


def until_running(stage: Stage, name: str) -> None:
    leaf = next(node for node in stage.root.iterate() if node.name == name)
    for _ in range(200):
        stage.tick()
        if leaf.status is Status.RUNNING:
            return
    raise AssertionError(f"{name} never ran")


def test_a_session_that_severs_everything_is_a_success() -> None:
    stage = session(estimate=["incomplete", "complete"])

    assert stage.tick(100) is Status.SUCCESS
    assert outcome().code is Code.COMPLETE and stage.settled()
    assert [note["event"] for note in stage.noted("approval")] == ["asked", "approved"] * 2
    assert [proposal.kind for proposal in stage.approver.asked] == ["goal", "corrective"]
    assert stage.skills.begun[-1] == "retreat"


def test_the_attempts_run_out() -> None:
    stage = session(max_attempts=2, estimate="incomplete")

    assert stage.tick(100) is Status.FAILURE
    assert outcome().code is Code.ATTEMPTS_USED
    assert stage.skills.begun.count("dissect") == 2 and stage.skills.begun.count("replan") == 1
    assert stage.skills.begun[-1] == "retreat"


def test_without_feedback_nobody_looks_and_the_operator_is_asked_before_each_cut() -> None:
    stage = session(feedback=False)

    assert stage.tick(100) is Status.FAILURE
    assert outcome().code is Code.UNVERIFIED
    assert [name for name in stage.skills.begun if name != "track"] == [
        "checklist",
        "start_tracking",
        "dissect",
        "dissect",
        "dissect",
        "retreat",
    ]
    assert len(stage.approver.asked) == 3


def test_a_goal_that_is_not_approved_moves_nothing() -> None:
    stage = session(answer="no")

    assert stage.tick(100) is Status.FAILURE
    assert outcome().code is Code.NOT_APPROVED and stage.bench.motions() == []


def test_a_failed_checklist_ends_the_session() -> None:
    stage = session(checklist="failed")

    assert stage.tick(100) is Status.FAILURE
    assert outcome().code is Code.CHECKLIST


def test_a_failed_retreat_says_what_came_before() -> None:
    stage = session(retreat="end")

    assert stage.tick(100) is Status.FAILURE
    assert outcome().code is Code.MOVE_TIMEOUT and "no tissue connection is left" in outcome().message


@pytest.mark.parametrize("step", [Step.CHECKLIST, Step.DISSECT, Step.EXPOSE, Step.ESTIMATE, Step.RETREAT])
def test_the_emergency_stop_ends_the_session_in_hold_at_once(step: Step) -> None:
    words: dict[str, Any] = {step.value: "running"}
    stage = session(**words)
    until_running(stage, step)
    stage.bench.pressed = True

    assert stage.tick() is Status.FAILURE
    assert outcome() == SessionOutcome(Code.EMERGENCY_STOP, "the emergency stop is pressed")
    assert stage.settled()


def test_a_stale_camera_holds_and_the_session_resumes_by_looking() -> None:
    stage = session(dissect="running")
    until_running(stage, Step.DISSECT)
    stage.bench.eye.freeze()
    stage.bench.advance(0.25)

    assert stage.tick() is Status.RUNNING
    assert stage.settled() and read(INTERRUPTIONS) == 1
    assert "holding" in stage.root.children[0].children[2].feedback_message
    stage.tick(20)
    assert stage.settled()

    stage.bench.eye.thaw()
    assert stage.tick(100) is Status.SUCCESS
    assert stage.skills.begun.count("dissect") == 1 and stage.skills.begun.count("checklist") == 2
    assert stage.skills.begun.count("start_tracking") == 1 and read(ATTEMPT).number == 1


def test_an_interruption_before_cutting_asks_for_the_goal_again() -> None:
    stage = session(answer="wait")
    until_running(stage, Step.APPROVE_GOAL)
    stage.bench.cutter.power_off()
    stage.tick()
    assert stage.approver.open is None

    stage.bench.cutter.recover()
    stage.tick(5)

    assert len(stage.approver.asked) == 2 and stage.approver.open is not None


def test_a_moment_without_power_between_two_ticks_interrupts_too() -> None:
    stage = session(expose=["running"] * 5 + ["ok"])
    until_running(stage, Step.EXPOSE)
    now = stage.bench.now()
    stage.bench.at(now + 0.01, stage.bench.cutter.power_off)
    stage.bench.at(now + 0.02, stage.bench.cutter.recover)

    stage.tick()

    assert read(INTERRUPTIONS) == 1 and stage.settled()
    assert stage.tick(100) is Status.SUCCESS
    assert stage.skills.begun.count("expose") == 2


def test_arms_that_are_off_do_not_keep_the_checklist_from_powering_them() -> None:
    stage = session(checklist=["running", "running", "ok"])
    stage.bench.grasper.unhome()
    stage.bench.cutter.unhome()

    stage.tick(2)
    assert stage.skills.opened == ["checklist"]
    stage.bench.grasper.recover()
    stage.bench.cutter.recover()

    assert stage.tick(100) is Status.SUCCESS


def test_a_record_that_fails_ends_the_session() -> None:
    stage = session(dissect="running")
    until_running(stage, Step.DISSECT)
    stage.recorder_fault = "the disk is full"

    assert stage.tick() is Status.FAILURE
    assert outcome() == SessionOutcome(Code.RECORDER_FAILED, "the disk is full")
    assert stage.settled()


def test_a_person_who_stops_the_session_finds_it_in_hold() -> None:
    stage = session(expose="running")
    until_running(stage, Step.EXPOSE)

    stage.root.stop(Status.INVALID)

    assert outcome().code is Code.ABORTED and stage.settled()


def test_stopping_after_the_end_does_not_change_the_outcome() -> None:
    stage = session()
    stage.tick(100)

    stage.root.stop(Status.INVALID)

    assert outcome().code is Code.COMPLETE
