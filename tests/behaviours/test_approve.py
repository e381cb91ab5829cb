from __future__ import annotations

import numpy as np
from py_trees.common import Status

from behaviours.approve import Approve
from behaviours.board import GRANTED_GOAL, INTERRUPTIONS, PLAN, TRACKING, Plan, Step, read, result_of
from behaviours.proposal import Answer, goal_id
from hardware.codes import Code
from skills.replan.next_goal import NextGoal
from tests.mocks.skills import GOAL, SEGMENTS, goal_seen, script
from tests.mocks.stage import Stage, put


def approving(followed: bool = False, **words: str | list[str]) -> Stage:
    stage = Stage(script(**words), approval_lifetime=10.0, max_asks=2)
    stage.skills.following = followed
    stage.build(lambda services: Approve(Step.APPROVE_GOAL, services, GRANTED_GOAL))
    put(TRACKING, followed)
    return stage


def planned(interruptions: int = 0) -> Plan:
    return Plan(NextGoal(Code.OK, "1 segment to sever 1 attachment", SEGMENTS, ((0,),)), goal_seen(), interruptions)


def code_of(stage: Stage) -> Code:
    result = read(result_of(Step.APPROVE_GOAL))
    assert result is not None
    return result.code


def test_the_operator_is_asked_about_the_goal_as_drawn() -> None:
    stage = approving(answer="wait")

    assert stage.tick() is Status.RUNNING
    (proposal,) = stage.approver.asked
    assert (proposal.kind, proposal.goal_id, proposal.frame_sequence) == ("goal", goal_id(GOAL.polyline), 1)
    np.testing.assert_array_equal(proposal.polyline, GOAL.polyline)
    assert len(proposal.segments) == 0 and "goal as drawn" in proposal.reason
    assert stage.gate.approval is None


def test_yes_gives_the_gate_an_approval_bound_to_goal_frame_and_time() -> None:
    stage = approving()

    assert stage.tick(2) is Status.SUCCESS
    approval = stage.gate.approval
    assert approval is not None
    assert (approval.goal_id, approval.by, approval.frame_sequence) == (goal_id(GOAL.polyline), "the operator", 1)
    assert approval.expires == approval.granted + 10.0 == stage.bench.now() + 10.0
    assert read(GRANTED_GOAL) is stage.approver.asked[0]
    assert [note["event"] for note in stage.noted("approval")] == ["asked", "approved"]


def test_no_is_a_failure_and_gives_no_approval() -> None:
    stage = approving(answer="no")

    assert stage.tick(2) is Status.FAILURE
    assert code_of(stage) is Code.NOT_APPROVED and stage.gate.approval is None


def test_it_waits_as_long_as_the_operator_thinks() -> None:
    stage = approving(answer="wait")

    assert stage.tick(100) is Status.RUNNING
    assert stage.root.feedback_message.startswith("waiting for the operator")
    assert len(stage.approver.asked) == 1


def test_preempted_it_withdraws_the_question() -> None:
    stage = approving(answer="wait")
    stage.tick(2)

    stage.root.stop(Status.INVALID)

    assert stage.approver.open is None and stage.gate.approval is None


def test_an_answer_to_another_question_is_not_heard() -> None:
    stage = approving(answer="wait")
    stage.tick()
    stage.approver.answer = lambda: Answer("another goal", True, "the operator")  # type: ignore[method-assign]

    assert stage.tick() is Status.RUNNING
    assert stage.gate.approval is None


def test_when_the_scene_has_moved_it_asks_again_with_what_is_seen_now() -> None:
    stage = approving(followed=True, answer=["wait", "yes"])
    stage.tick(2)
    stage.skills.shift = 9.0

    assert stage.tick() is Status.RUNNING
    assert stage.gate.approval is None
    first, second = stage.approver.asked
    np.testing.assert_array_equal(second.polyline - first.polyline, np.tile([9.0, 0.0], (3, 1)))
    assert "moved by 9 px" in second.reason
    assert stage.tick() is Status.SUCCESS


def test_a_small_movement_does_not_matter() -> None:
    stage = approving(followed=True, answer=["wait", "yes"])
    stage.tick(2)
    stage.skills.shift = 7.0

    assert stage.tick() is Status.SUCCESS


def test_a_late_answer_does_not_count() -> None:
    stage = approving(answer=["wait", "yes"])
    stage.tick(2)
    stage.bench.advance(10.0)

    assert stage.tick() is Status.RUNNING
    assert len(stage.approver.asked) == 2 and stage.gate.approval is None


def test_it_gives_up_when_the_scene_never_rests() -> None:
    stage = approving(followed=True)
    stage.tick()
    for _ in range(2):
        stage.skills.shift += 20.0
        stage.tick()

    assert stage.root.status is Status.FAILURE
    assert code_of(stage) is Code.SCENE_MOVED and stage.approver.open is None


def test_a_goal_that_cannot_be_seen_cannot_be_approved() -> None:
    stage = approving(followed=True)
    stage.skills.lost = True

    assert stage.tick() is Status.FAILURE
    assert code_of(stage) is Code.GOAL_LOST and stage.approver.asked == []


def test_a_plan_is_proposed_where_its_segments_are_now() -> None:
    stage = approving(followed=True)
    put(PLAN, planned())
    stage.skills.shift = 30.0

    stage.tick()

    (proposal,) = stage.approver.asked
    assert proposal.kind == "corrective" and proposal.reason == "1 segment to sever 1 attachment"
    np.testing.assert_allclose(proposal.segments, SEGMENTS + np.array([30.0, 0.0]), atol=1e-6)


def test_a_plan_made_before_an_interruption_is_not_proposed() -> None:
    stage = approving(followed=True)
    put(PLAN, planned())
    put(INTERRUPTIONS, 1)

    stage.tick()

    assert stage.approver.asked[0].kind == "goal"


def test_an_operator_that_raises_is_a_failure_not_a_crash() -> None:
    stage = approving()
    stage.approver.request = lambda proposal: 1 / 0  # type: ignore[method-assign,assignment,return-value]

    assert stage.tick() is Status.FAILURE
    assert code_of(stage) is Code.INTERNAL_ERROR
