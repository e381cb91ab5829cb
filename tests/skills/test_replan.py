"""The greedy cover: it covers, it is short, it stays where it may, and it says when it cannot."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware.codes import Code
from skills.estimate.graph import ConnectivityGraph, EdgeState
from skills.estimate.grid import GridConfig, grid_around
from skills.replan.candidates import Candidates, ReplanConfig, order_along
from skills.replan.greedy import greedy_cover, next_goal
from skills.replan.next_goal import NextGoal
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


def assert_covers(graph: ConnectivityGraph, plan: NextGoal) -> None:
    uncut = np.flatnonzero(graph.uncut)
    severed = sorted(e for edges in plan.severs for e in edges)
    assert severed == uncut.tolist()  # each is first cut by one segment
    for segment, edges in zip(plan.segments, plan.severs, strict=True):
        assert touch(segment[None], graph.points[graph.edges[list(edges)]]).all()


@settings(max_examples=30, deadline=None)
@given(st.sets(st.integers(0, len(CROSSING) - 1), min_size=1), st.integers(0, 1000), st.booleans())
def test_the_cover_really_covers_and_keeps_the_length(uncut: set[int], seed: int, trim: bool) -> None:
    graph, config = graph_with(sorted(uncut)), ReplanConfig(trim=trim)
    plan = next_goal(graph, TRACKED, config, np.random.default_rng(seed))
    assert plan.code is Code.OK
    assert_covers(graph, plan)
    length = np.linalg.norm(plan.segments[:, 1] - plan.segments[:, 0], axis=1)
    assert (length <= config.segment_length + 1e-9).all()
    if not trim:
        assert length == pytest.approx(config.segment_length)
    assert len(plan.segments) <= len(uncut)


def test_a_short_attachment_takes_one_segment_along_the_goal_trimmed_to_it() -> None:
    plan = next_goal(graph_with([10, 11, 12]), TRACKED)
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


def test_nothing_uncut_needs_no_segment() -> None:
    plan = next_goal(graph_with([]), TRACKED)
    assert (plan.code, plan.segments.shape, plan.severs) == (Code.OK, (0, 2, 2), ())


def test_segments_stay_inside_the_tissue() -> None:
    outline = np.zeros((480, 640), dtype=bool)
    outline[150:330, 100:540] = True
    outline[:, 330:] = False
    plan = next_goal(graph_with([20, 21, 22]), TRACKED, outline=outline)
    assert plan.code is Code.OK
    assert plan.segments[..., 0].max() < 330.5


def test_an_edge_that_no_allowed_segment_reaches_is_reported() -> None:
    plan = next_goal(graph_with([3, 20]), TRACKED, outline=np.zeros((480, 640), dtype=bool))
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


@pytest.mark.parametrize("bad", [{"segment_length": 0.0}, {"orientations": 0}, {"max_draws": 3}])
def test_a_senseless_configuration_is_refused(bad: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r"needed|positive"):
        ReplanConfig(**bad)  # type: ignore[arg-type]
