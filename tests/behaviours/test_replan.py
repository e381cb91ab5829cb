from __future__ import annotations

from py_trees.common import Status

from behaviours.board import ESTIMATE, INTERRUPTIONS, PLAN, Estimate, Plan, Step, read, result_of
from behaviours.replan import Replan
from hardware.codes import Code
from skills.estimate.graph import EdgeState
from skills.replan.next_goal import NextGoal
from tests.mocks.skills import SEGMENTS, graph, script
from tests.mocks.stage import Stage, put


def planning(**words: str | list[str]) -> Stage:
    stage = Stage(script(**words))
    stage.build(lambda services: Replan(Step.REPLAN, services))
    put(ESTIMATE, Estimate(graph(EdgeState.CONNECTED), 1, 2))
    put(INTERRUPTIONS, 2)
    put(PLAN, Plan(NextGoal(Code.OK, "an old plan", SEGMENTS, ((0,),)), None, 0))
    return stage


def code_of() -> Code:
    result = read(result_of(Step.REPLAN))
    assert result is not None
    return result.code


def test_success_keeps_the_plan_with_the_picture_it_was_made_on() -> None:
    stage = planning()
    stage.skills.following = True

    assert stage.tick(2) is Status.SUCCESS
    plan = read(PLAN)
    assert plan is not None and plan.interruptions == 2 and plan.seen is not None
    assert stage.noted("plan")[0]["segments"] == SEGMENTS.tolist()


def test_failure_carries_the_code_and_leaves_no_plan() -> None:
    stage = planning(replan="end")

    assert stage.tick(2) is Status.FAILURE
    assert code_of() is Code.NO_CANDIDATE and read(PLAN) is None


def test_an_empty_plan_is_a_failure() -> None:
    stage = planning(replan="empty")

    assert stage.tick(2) is Status.FAILURE
    assert code_of() is Code.NO_CANDIDATE and read(PLAN) is None


def test_while_it_runs_the_old_plan_is_gone() -> None:
    stage = planning(replan="running")

    assert stage.tick(2) is Status.RUNNING
    assert read(PLAN) is None


def test_preempted_there_is_no_plan() -> None:
    stage = planning(replan="running")
    stage.tick(2)

    stage.root.stop(Status.INVALID)

    assert read(PLAN) is None and stage.skills.opened == []


def test_without_an_estimate_it_fails() -> None:
    stage = planning()
    put(ESTIMATE, None)

    assert stage.tick() is Status.FAILURE
    assert code_of() is Code.INTERNAL_ERROR
