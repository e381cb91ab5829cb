from __future__ import annotations

from py_trees.common import Status

from behaviours.approve import Approve
from behaviours.board import GRANTED_GOAL, GRANTS, PLAN, TRACKING, Plan, Step
from behaviours.permitted import Permitted
from hardware.codes import Code
from hardware.gate import Approval
from skills.replan.next_goal import NextGoal
from tests.mocks.skills import SEGMENTS, goal_seen
from tests.mocks.stage import Stage, put


def approved() -> Stage:
    """Give a stage on which the tracked goal has just been approved, and the question whether it is permitted."""
    stage = Stage(approval_lifetime=1.0)
    stage.skills.following = True
    put(TRACKING, True)
    stage.build(lambda services: Approve(Step.APPROVE_GOAL, services, GRANTED_GOAL))
    stage.tick(2)
    stage.build(lambda services: Permitted("permitted?", services, GRANTS))
    return stage


def test_what_was_approved_is_permitted() -> None:
    stage = approved()

    assert stage.tick() is Status.SUCCESS
    assert stage.root.feedback_message == "approved by the operator"


def test_nothing_is_permitted_without_an_approval() -> None:
    stage = Stage()
    stage.build(lambda services: Permitted("permitted?", services, GRANTS))

    assert stage.tick() is Status.FAILURE


def test_an_approval_that_has_expired_permits_nothing() -> None:
    stage = approved()
    stage.bench.advance(1.1)

    assert stage.tick() is Status.FAILURE
    assert stage.root.feedback_message == "there is no live approval"


def test_a_scene_that_has_moved_must_be_asked_about_again() -> None:
    stage = approved()
    stage.skills.shift = 9.0

    assert stage.tick() is Status.FAILURE
    assert stage.root.feedback_message == "the goal has moved by 9 px, 8 px are allowed"


def test_a_goal_that_is_not_seen_is_not_permitted() -> None:
    stage = approved()
    stage.skills.lost = True

    assert stage.tick() is Status.FAILURE
    assert stage.root.feedback_message == "the goal cannot be seen"


def test_an_approval_of_the_goal_does_not_permit_corrective_segments() -> None:
    stage = approved()
    put(PLAN, Plan(NextGoal(Code.OK, "1 segment", SEGMENTS, ((0,),)), goal_seen(), 0))

    assert stage.tick() is Status.FAILURE
    assert stage.root.feedback_message == "the approval is for another cut"


def test_an_approval_of_something_never_asked_permits_nothing() -> None:
    stage = approved()
    now = stage.bench.now()
    stage.gate.approve(Approval("unknown", "nobody", 0, now, now + 10.0))

    assert stage.tick() is Status.FAILURE
    assert stage.root.feedback_message == "the approval is for another goal"
