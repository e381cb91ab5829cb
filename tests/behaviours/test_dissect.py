from __future__ import annotations

import numpy as np
from py_trees.common import Status

from behaviours.board import CUTTING_BEGAN, INTERRUPTIONS, PLAN, Plan, Step, read, result_of
from behaviours.dissect import Dissect
from hardware.codes import Code
from hardware.gate import Approval
from hardware.interface import CUTTER
from skills.replan.next_goal import NextGoal
from tests.mocks.skills import SEGMENTS, goal_seen, script
from tests.mocks.stage import Stage, put


def dissecting(**words: str | list[str]) -> Stage:
    stage = Stage(script(**words))
    stage.skills.following = True
    stage.build(lambda services: Dissect(Step.DISSECT, services))
    stage.gate.approve(Approval("goal", "the operator", 0, 0.0, 100.0))
    return stage


def test_success_cuts_the_whole_goal_and_uses_the_approval_up() -> None:
    stage = dissecting(dissect=["running", "ok"])

    assert stage.tick(3) is Status.SUCCESS
    assert stage.skills.segments == [None] and read(CUTTING_BEGAN)
    assert [command.target for command in stage.bench.motions(CUTTER)] == [0.8, 0.1]
    assert stage.settled()
    assert stage.noted("dissected") == [{"code": "ok", "message": "dissect: ok", "snips": 0, "closed": 0}]


def test_failure_carries_the_agents_code() -> None:
    stage = dissecting(dissect="retry")

    assert stage.tick(2) is Status.FAILURE
    result = read(result_of(Step.DISSECT))
    assert result is not None and result.code is Code.GRASP_EMPTY
    assert stage.settled()


def test_it_cuts_snip_by_snip_over_many_ticks() -> None:
    stage = dissecting(dissect="running")

    assert stage.tick(10) is Status.RUNNING
    assert len(stage.bench.motions(CUTTER)) == 18


def test_preempted_it_holds_and_withdraws_the_approval() -> None:
    stage = dissecting(dissect="running")
    stage.tick(3)

    stage.root.stop(Status.INVALID)

    assert stage.settled()
    assert read(CUTTING_BEGAN)


def test_without_an_approval_the_scissors_stay_open() -> None:
    stage = dissecting(dissect="running")
    stage.gate.withdraw_approval()

    stage.tick(3)

    assert [command.target for command in stage.bench.motions(CUTTER)] == [0.8, 0.8]


def test_corrective_segments_are_cut_where_they_are_now() -> None:
    stage = dissecting()
    put(PLAN, Plan(NextGoal(Code.OK, "1 segment", SEGMENTS, ((0,),)), goal_seen(), 0))
    stage.skills.shift = 5.0

    stage.tick(2)

    (segments,) = stage.skills.segments
    assert segments is not None
    np.testing.assert_allclose(segments, SEGMENTS + np.array([5.0, 0.0]), atol=1e-6)


def test_a_stale_plan_is_not_cut() -> None:
    stage = dissecting()
    put(PLAN, Plan(NextGoal(Code.OK, "1 segment", SEGMENTS, ((0,),)), goal_seen(), 0))
    put(INTERRUPTIONS, 1)

    stage.tick(2)

    assert stage.skills.segments == [None]


def test_a_goal_that_is_not_seen_is_not_cut() -> None:
    stage = dissecting()
    stage.skills.lost = True

    assert stage.tick() is Status.FAILURE
    result = read(result_of(Step.DISSECT))
    assert result is not None and result.code is Code.GOAL_LOST
    assert stage.skills.begun == []
