from __future__ import annotations

from py_trees.common import Status

from behaviours.board import TRACKING
from behaviours.goal_settled import GoalSettled
from tests.mocks.stage import Stage, put


def test_it_is_not_settled_before_tracking_has_started() -> None:
    stage = Stage()
    stage.build(lambda services: GoalSettled("goal settled?", services))

    assert stage.tick() is Status.FAILURE


def test_it_is_settled_once_tracking_has_started() -> None:
    stage = Stage()
    stage.build(lambda services: GoalSettled("goal settled?", services))
    put(TRACKING, True)

    assert stage.tick() is Status.SUCCESS
    assert stage.root.feedback_message == "the goal is approved and followed"
