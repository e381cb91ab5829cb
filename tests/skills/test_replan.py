"""The next goal: it covers, it is short, it stays where it may, it says what it will sever, and it says when it cannot."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware.codes import Code
from skills.estimate.graph import ConnectivityGraph, EdgeState
from skills.estimate.grid import GridConfig, grid_around
from skills.replan import plan as plan_module
from skills.replan.candidates import Candidates, ReplanConfig
from skills.replan.greedy import greedy_cover
from skills.replan.next_goal import NextGoal
from skills.replan.optimal import FewestCuts
from skills.replan.order import order_along
from skills.replan.plan import next_goal
from skills.scene.segments import touch
from tests.skills.goals import straight, tracked_goal

TRACKED = tracked_goal(straight(), half=20.0, grasp=(320.0, 120.0))
GRID = grid_around(TRACKED, 8.0, GridConfig(station_spacing=8.0))
CROSSING = np.flatnonzero(GRID.crosses_goal)


def graph_with(uncut: list[int], unknown: list[int] | None = None) -> ConnectivityGraph:
    """Sever every crossing edge but those of index `uncut` (connected) and `unknown`."""
    state = np.zeros(len(GRID.edges), dtype=np.int64)
    state[CROSSING] = EdgeState.SEVERED
    state[CROSSING[uncut]] = EdgeState.CONNECTED
    state[CROSSING[unknown or []]] = EdgeState.UNKNOWN
    return ConnectivityGraph(
        Code.OK,
        "",
        GRID.points,
        GRID.points,
        GRID.edges,
        np.ones(len(state)),
        state,
        np.full(len(state), 0.5),
        GRID.crosses_goal,
        GRID.station,
    )


COVERS = pytest.mark.parametrize("cover", ["optimal", "greedy"])


def assert_covers(graph: ConnectivityGraph, plan: NextGoal) -> None:
    uncut = np.flatnonzero(graph.uncut)
    severed = sorted(e for edges in plan.severs for e in edges)
    assert severed == uncut.tolist()  # each is first cut by one segment
    for segment, edges in zip(plan.segments, plan.severs, strict=True):
        assert touch(segment[None], graph.points[graph.edges[list(edges)]]).all()


@settings(max_examples=30, deadline=None)
@given(
    st.sets(st.integers(0, len(CROSSING) - 1), min_size=1),
    st.integers(0, 1000),
    st.booleans(),
    st.sampled_from(["optimal", "greedy"]),
)
def test_the_cover_really_covers_and_keeps_the_length(
    uncut: set[int], seed: int, trim: bool, cover: Literal["optimal", "greedy"]
) -> None:
    graph, config = graph_with(sorted(uncut)), ReplanConfig(trim=trim, cover=cover)
    plan = next_goal(graph, TRACKED, config, np.random.default_rng(seed))
    assert plan.code is Code.OK
    assert_covers(graph, plan)
    length = np.linalg.norm(plan.segments[:, 1] - plan.segments[:, 0], axis=1)
    assert (length <= config.segment_length + 1e-9).all()
    if not trim:
        assert length == pytest.approx(config.segment_length)
    assert len(plan.segments) <= len(uncut)


@COVERS
def test_a_short_attachment_takes_one_segment_along_the_goal_trimmed_to_it(cover: Literal["optimal", "greedy"]) -> None:
    plan = next_goal(graph_with([10, 11, 12]), TRACKED, ReplanConfig(cover=cover))
    assert len(plan.segments) == 1
    (start, end) = plan.segments[0]
    assert abs(start[1] - end[1]) < 1e-6
    assert np.linalg.norm(end - start) == pytest.approx(16 + 20, abs=1.0)
    assert abs(start[1] - 240.0) < 13.0
    assert "1 attachment (3 connected edges)" in plan.message


def test_the_fixed_length_of_the_paper_can_be_chosen() -> None:
    plan = next_goal(graph_with([10]), TRACKED, ReplanConfig(trim=False))
    assert np.linalg.norm(np.diff(plan.segments[0], axis=0)) == pytest.approx(60.0)


def test_the_whole_goal_uncut_needs_about_its_length_over_the_segments() -> None:
    plan = next_goal(graph_with(list(range(len(CROSSING)))), TRACKED)
    assert 5 <= len(plan.segments) <= 8


def test_segments_come_in_order_along_the_goal_and_are_cut_one_way() -> None:
    plan = next_goal(graph_with([2, 3, 15, 16, 30, 31]), TRACKED)
    middles = plan.segments.mean(axis=1)[:, 0]
    assert (np.diff(middles) < 0).all()  # the goal is drawn right to left
    assert (plan.segments[:, 0, 0] > plan.segments[:, 1, 0]).all()


def test_turning_segments_shortens_the_travel_between_them() -> None:
    across = np.array([[[400.0, 220.0], [400.0, 260.0]], [[300.0, 220.0], [300.0, 260.0]], [[200.0, 220.0], [200.0, 260.0]]])
    order, turned = order_along(across[::-1], TRACKED)
    assert order.tolist() == [2, 1, 0]
    assert turned[0] != turned[1] != turned[2]


def test_unknown_edges_are_severed_too_and_named() -> None:
    plan = next_goal(graph_with([5], unknown=[20]), TRACKED)
    assert_covers(graph_with([5], unknown=[20]), plan)
    assert "1 edge not seen well enough" in plan.message


def test_unknown_edges_that_are_not_seen_are_left_out_and_counted() -> None:
    graph = graph_with([5], unknown=[20, 25])
    seen = np.ones(len(graph.points), dtype=bool)
    seen[graph.edges[CROSSING[20], 0]] = False
    plan = next_goal(graph, TRACKED, seen=seen)
    assert sorted(e for edges in plan.severs for e in edges) == sorted(CROSSING[[5, 25]].tolist())
    assert plan.left_out == 1 and "1 unknown edge not seen now is left out" in plan.message
    assert not touch(plan.segments, graph.points[graph.edges[CROSSING[[20]]]]).any()


@COVERS
@pytest.mark.parametrize("trim", [True, False])
def test_no_segment_passes_over_an_unknown_edge_that_is_not_seen(cover: Literal["optimal", "greedy"], trim: bool) -> None:
    graph = graph_with([18, 19, 21, 22], unknown=[20])
    hidden = graph.edges[CROSSING[20]]
    seen = np.ones(len(graph.points), dtype=bool)
    config = ReplanConfig(cover=cover, trim=trim)
    assert len(next_goal(graph, TRACKED, config, seen=seen).segments) == 1
    seen[hidden[0]] = False
    plan = next_goal(graph, TRACKED, config, seen=seen)
    assert sorted(e for edges in plan.severs for e in edges) == sorted(CROSSING[[18, 19, 21, 22]].tolist())
    assert not touch(plan.segments, graph.points[hidden][None]).any()
    assert plan.left_out == 1 and len(plan.segments) > 1


@settings(max_examples=15, deadline=None)
@given(st.sets(st.integers(0, len(CROSSING) - 1), min_size=1), st.sets(st.integers(0, len(CROSSING) - 1)), st.integers(0, 1000))
def test_whatever_is_not_seen_is_never_cut(uncut: set[int], unknown: set[int], seed: int) -> None:
    graph = graph_with(sorted(uncut), unknown=sorted(unknown - uncut))
    jitter = np.random.default_rng(seed).normal(0.0, 3.0, graph.points.shape)
    graph = replace(graph, points=graph.points + jitter)
    plan = next_goal(graph, TRACKED, ReplanConfig(compare=False), seen=np.zeros(len(graph.points), dtype=bool))
    hidden = graph.points[graph.edges[CROSSING[sorted(unknown - uncut)]]]
    assert not touch(plan.segments, hidden).any()
    assert plan.code is Code.NO_CANDIDATE or sorted(e for edges in plan.severs for e in edges) == sorted(CROSSING[sorted(uncut)])


def test_unknown_edges_without_a_place_are_not_seen() -> None:
    graph = graph_with([5], unknown=[20])
    points = graph.points.copy()
    points[graph.edges[CROSSING[20], 1]] = np.nan
    plan = next_goal(replace(graph, points=points), TRACKED)
    assert (plan.code, plan.left_out, len(plan.segments)) == (Code.OK, 1, 1)


@COVERS
def test_when_only_unseen_unknown_edges_are_left_another_exposure_is_asked_for(cover: Literal["optimal", "greedy"]) -> None:
    graph = graph_with([], unknown=[20, 21])
    plan = next_goal(graph, TRACKED, ReplanConfig(cover=cover), seen=np.zeros(len(graph.points), dtype=bool))
    assert (plan.code, plan.left_out, len(plan.segments)) == (Code.NO_CANDIDATE, 2, 0)
    assert "another exposure" in plan.message


def test_a_connected_edge_is_cut_though_the_tracker_lost_sight_of_it() -> None:
    graph = graph_with([5])
    plan = next_goal(graph, TRACKED, seen=np.zeros(len(graph.points), dtype=bool))
    assert_covers(graph, plan)


def test_each_segment_says_what_it_severs_and_where() -> None:
    graph = graph_with([4, 5], unknown=[6])
    plan = next_goal(graph, TRACKED, goal_length=40e-3)
    ends = [f"{40 * graph.station[CROSSING[k]]:.1f}" for k in (4, 6)]
    expected = (
        f"severs 3 connections (2 still attached, 1 not known to be severed) between {ends[0]} and {ends[1]} mm along the goal"
    )
    assert plan.reasons == (expected,)
    assert plan.explanation == f"{plan.message} Segment 1 {expected}."


def test_without_a_length_places_are_told_in_percent() -> None:
    graph = graph_with([4])
    (reason,) = next_goal(graph, TRACKED).reasons
    assert reason == f"severs 1 connection (1 still attached) at {100 * graph.station[CROSSING[4]]:.0f} % of the goal"


def test_the_optimal_cover_is_proven_and_compared_with_the_greedy_one() -> None:
    graph = graph_with(list(range(len(CROSSING))))
    plan, paper = (next_goal(graph, TRACKED, ReplanConfig(cover=cover)) for cover in ("optimal", "greedy"))
    assert plan.proven and "Fewer segments cannot do it" in plan.message
    assert len(plan.segments) <= plan.greedy_segments == len(paper.segments)
    assert not paper.proven
    assert next_goal(graph, TRACKED, ReplanConfig(compare=False)).greedy_segments is None


def test_without_a_proof_the_greedy_cover_is_taken_if_it_is_shorter(monkeypatch: pytest.MonkeyPatch) -> None:
    edges = GRID.points[GRID.edges[CROSSING]]
    middles, half = edges.mean(axis=1), np.array([4.0, 0.0])
    one_each = np.stack([middles - half, middles + half], axis=1)
    monkeypatch.setattr(plan_module, "fewest_cuts", lambda *_: FewestCuts(one_each, touch(one_each, edges), 1))
    graph = graph_with(list(range(len(CROSSING))))
    plan = next_goal(graph, TRACKED)
    assert_covers(graph, plan)
    assert len(plan.segments) <= (plan.greedy_segments or 0) < len(one_each)
    assert not plan.proven and "without a proof" in plan.message


def test_nothing_uncut_needs_no_segment() -> None:
    plan = next_goal(graph_with([]), TRACKED)
    assert (plan.code, plan.segments.shape, plan.severs) == (Code.OK, (0, 2, 2), ())


@COVERS
def test_segments_stay_inside_the_tissue(cover: Literal["optimal", "greedy"]) -> None:
    outline = np.zeros((480, 640), dtype=bool)
    outline[150:330, 100:540] = True
    outline[:, 330:] = False
    plan = next_goal(graph_with([20, 21, 22]), TRACKED, ReplanConfig(cover=cover), outline=outline)
    assert plan.code is Code.OK
    assert plan.segments[..., 0].max() < 330.5


@COVERS
def test_an_edge_that_no_allowed_segment_reaches_is_reported(cover: Literal["optimal", "greedy"]) -> None:
    plan = next_goal(graph_with([3, 20]), TRACKED, ReplanConfig(cover=cover), outline=np.zeros((480, 640), dtype=bool))
    assert plan.code is Code.NO_CANDIDATE
    assert "2 of 2" in plan.message
    assert len(plan.segments) == 0


def test_an_edge_without_a_place_is_reported() -> None:
    graph = graph_with([3])
    points = graph.points.copy()
    points[graph.edges[CROSSING[3], 0]] = np.nan
    assert next_goal(replace(graph, points=points), TRACKED).code is Code.NO_CANDIDATE


def test_segments_keep_clear_of_the_grasp_where_they_can() -> None:
    close = replace(TRACKED, grasp=GRID.points[GRID.edges[CROSSING[18], 0]] + [0.0, 3.0])
    plan = next_goal(graph_with([18]), close)
    middle = plan.segments[0].mean(axis=0)
    assert np.linalg.norm(middle - close.grasp) > 15
    blocked = next_goal(graph_with([18]), replace(close, grasp=np.array([middle[0], 240.0])), ReplanConfig(grasp_clearance=100.0))
    assert blocked.code is Code.OK
    assert "close to the grasp" in blocked.message


def test_one_seed_gives_one_plan() -> None:
    plans = [next_goal(graph_with([4, 9, 25]), TRACKED, rng=np.random.default_rng(7)) for _ in range(2)]
    assert np.array_equal(plans[0].segments, plans[1].segments)


@given(st.integers(1, 12), st.integers(1, 15), st.integers(0, 10**6))
def test_greedy_covers_all_that_can_be_covered_with_no_idle_choice(candidates: int, edges: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    covers = rng.random((candidates, edges)) < 0.3
    pool = Candidates(np.zeros((candidates, 2, 2)), rng.random(candidates), rng.random(candidates), np.ones(candidates, bool))
    chosen = greedy_cover(covers, pool)
    covered = np.concatenate([first for _, first in chosen]) if chosen else np.zeros(0, int)
    assert sorted(covered.tolist()) == np.flatnonzero(covers.any(axis=0)).tolist()
    assert all(len(first) for _, first in chosen)
    gains = [len(first) for _, first in chosen]
    assert gains == sorted(gains, reverse=True)


def test_ties_fall_to_the_smaller_angle_then_to_the_nearer() -> None:
    covers = np.ones((4, 2), dtype=bool)
    pool = Candidates(np.zeros((4, 2, 2)), np.array([0.5, 0.0, 0.0, 0.0]), np.array([0.0, 9.0, 3.0, 5.0]), np.ones(4, bool))
    assert [k for k, _ in greedy_cover(covers, pool)] == [2]


@pytest.mark.parametrize(
    "bad",
    [{"segment_length": 0.0}, {"orientations": 0}, {"max_draws": 3}, {"cover": "best"}, {"corridor": -1.0}, {"max_nodes": 0}],
)
def test_a_senseless_configuration_is_refused(bad: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"needed|positive|optimal"):
        ReplanConfig(**bad)  # type: ignore[arg-type]
