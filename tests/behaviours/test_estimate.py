from __future__ import annotations

from py_trees.common import Status

from behaviours.board import ATTEMPT, ESTIMATE, INTERRUPTIONS, LOOKED_AGAIN, Attempt, Estimate, Step, read, result_of
from behaviours.estimate import EstimateConnectivity
from hardware.codes import Code
from skills.estimate.graph import EdgeState
from tests.mocks.skills import graph, script
from tests.mocks.stage import Stage, put


def estimating(**words: str | list[str]) -> Stage:
    stage = Stage(script(**words))
    stage.build(lambda services: EstimateConnectivity(Step.ESTIMATE, services))
    put(ATTEMPT, Attempt(2, True, 1))
    put(INTERRUPTIONS, 1)
    return stage


def test_success_keeps_the_graph_with_its_attempt_and_interruptions() -> None:
    stage = estimating(estimate="incomplete")

    assert stage.tick(2) is Status.SUCCESS
    estimate = read(ESTIMATE)
    assert estimate is not None and (estimate.attempt, estimate.interruptions) == (2, 1)
    assert not estimate.graph.complete
    (note,) = stage.noted("estimate")
    assert (note["connected"], note["severed"], note["unknown"], note["complete"]) == (1, 0, 0, False)


def test_failure_carries_the_code_and_leaves_no_estimate() -> None:
    stage = estimating(estimate="look")
    put(ESTIMATE, Estimate(graph(EdgeState.SEVERED), 1, 0))

    assert stage.tick(2) is Status.FAILURE
    result = read(result_of(Step.ESTIMATE))
    assert result is not None and result.code is Code.TOO_MANY_UNKNOWN
    assert read(ESTIMATE) is None


def test_too_many_unknown_after_a_second_look_are_kept_for_the_operator_and_never_complete() -> None:
    stage = estimating(estimate="look")
    put(LOOKED_AGAIN, 2)

    assert stage.tick(2) is Status.SUCCESS
    estimate = read(ESTIMATE)
    assert estimate is not None and estimate.graph.uncut.any() and not estimate.graph.complete


def test_a_second_look_in_an_earlier_attempt_does_not_count() -> None:
    stage = estimating(estimate="look")
    put(LOOKED_AGAIN, 1)

    assert stage.tick(2) is Status.FAILURE
    assert read(ESTIMATE) is None


def test_while_it_runs_there_is_no_estimate() -> None:
    stage = estimating(estimate="running")
    put(ESTIMATE, Estimate(graph(EdgeState.SEVERED), 1, 0))

    assert stage.tick(2) is Status.RUNNING
    assert read(ESTIMATE) is None


def test_preempted_it_is_closed_without_an_estimate() -> None:
    stage = estimating(estimate="running")
    stage.tick(2)

    stage.root.stop(Status.INVALID)

    assert read(ESTIMATE) is None and stage.skills.opened == []
