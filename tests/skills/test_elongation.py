"""The elongation rule: analytic cases, unknowns, probability, attachments."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hardware.codes import Code
from skills.estimate.elongation import ElongationConfig, attachments, estimate_connectivity
from skills.estimate.graph import ConnectivityGraph, EdgeState
from skills.estimate.grid import Grid, GridConfig, grid_around
from skills.tracking.tracks import Tracks
from tests.skills.goals import straight, tracked_goal

GRID = grid_around(tracked_goal(straight()), 8.0, GridConfig(station_spacing=16.0))
CROSSING = np.flatnonzero(GRID.crosses_goal)
COUNT = len(CROSSING)


def tracks_with_gap(gap: np.ndarray | float, hidden: list[int] | None = None) -> Tracks:
    """Open the goal by `gap` [px] at each of its stations and hide some keypoints."""
    columns = np.tile(np.broadcast_to(np.asarray(gap, dtype=float), (COUNT,)), len(GRID.points) // COUNT)
    points = GRID.points.copy()
    points[:, 1] += np.where(GRID.near_side, -columns / 2, columns / 2)
    visible = np.ones(len(points), dtype=bool)
    visible[hidden or []] = False
    return Tracks(1.0, points, visible, visible.astype(float))


def graph_for(gap: np.ndarray | float, hidden: list[int] | None = None, grid: Grid = GRID) -> ConnectivityGraph:
    return estimate_connectivity(grid, grid.points, tracks_with_gap(gap, hidden))


def test_rho_is_the_ratio_of_lengths_and_tau_itself_severs() -> None:
    graph = graph_for(14.0)  # 14 px become 28 px: rho = 2 = tau
    assert graph.elongation[CROSSING] == pytest.approx(2.0)
    assert (graph.state[CROSSING] == EdgeState.SEVERED).all()
    assert graph.probability[CROSSING] == pytest.approx(0.5)
    assert graph.complete
    assert graph.message == f"All {COUNT} edges across the goal are severed."


def test_a_goal_that_opens_less_stays_connected() -> None:
    graph = graph_for(13.9)
    assert graph.uncut.sum() == COUNT
    assert not graph.complete
    assert attachments(graph) == [
        pytest.approx((GRID.station[CROSSING].min() - GRID.spacing / 2, 1 - (12 / 320 - GRID.spacing / 2)), abs=1e-6)
    ]


def test_edges_with_a_hidden_end_are_unknown_and_never_severed() -> None:
    end = int(GRID.edges[CROSSING[3], 0])
    graph = graph_for(30.0, hidden=[end])
    touched = (GRID.edges == end).any(axis=1)
    assert (graph.state[touched] == EdgeState.UNKNOWN).all()
    assert np.isnan(graph.elongation[touched]).all()
    assert (graph.probability[touched] == 0.5).all()
    assert graph.uncut[CROSSING[3]]
    assert not graph.complete
    assert attachments(graph) == []
    assert graph.code is Code.OK


def test_doubtful_and_non_finite_tracks_are_unknown() -> None:
    tracks = tracks_with_gap(30.0)
    a, b = GRID.edges[CROSSING[0], 0], GRID.edges[CROSSING[1], 1]
    tracks.confidence[a] = 0.05
    tracks.points[b] = np.nan
    graph = estimate_connectivity(GRID, GRID.points, tracks)
    assert (graph.state[CROSSING[:2]] == EdgeState.UNKNOWN).all()
    assert (graph.state[CROSSING[2:]] == EdgeState.SEVERED).all()


def test_too_many_unknown_edges_say_so() -> None:
    ends = GRID.edges[CROSSING, 0]
    few, many = int(0.25 * COUNT), int(0.25 * COUNT) + 1
    assert graph_for(30.0, ends[:few].tolist()).code is Code.OK
    graph = graph_for(30.0, ends[:many].tolist())
    assert graph.code is Code.TOO_MANY_UNKNOWN
    assert not graph.complete
    assert f"{many} of {COUNT} edges" in graph.message


def test_attachments_are_runs_and_an_isolated_edge_counts() -> None:
    gap = np.full(COUNT, 30.0)
    gap[[0, 4, 5, 6, 10, COUNT - 1]] = 1.0
    graph = graph_for(gap)
    found = attachments(graph)
    station, half = np.sort(GRID.station[CROSSING]), GRID.spacing / 2
    runs = [(0, 0), (4, 6), (10, 10), (COUNT - 1, COUNT - 1)]
    assert np.allclose(found, [(max(station[a] - half, 0), min(station[b] + half, 1)) for a, b in runs])


def test_an_unknown_edge_joins_the_connected_ones_beside_it() -> None:
    gap = np.full(COUNT, 30.0)
    gap[[4, 6]] = 1.0
    middle = int(GRID.edges[CROSSING[5], 0])
    assert len(attachments(graph_for(gap))) == 2
    assert len(attachments(graph_for(gap, [middle]))) == 1


def test_a_stretched_strand_that_still_shows_tissue_is_connected() -> None:
    seen = np.full(len(GRID.edges), 25.0)
    seen[CROSSING[7]] = 0.0
    graph = estimate_connectivity(GRID, GRID.points, tracks_with_gap(30.0), None, seen)
    assert np.flatnonzero(graph.uncut).tolist() == [CROSSING[7]]
    assert graph.probability[CROSSING[7]] < 0.5


def test_a_slit_is_severed_at_the_goals_end_and_a_half_cut_in_its_middle_is_not() -> None:
    seen = np.zeros(len(GRID.edges))
    seen[CROSSING[[0, COUNT // 2]]] = 3.0
    graph = estimate_connectivity(GRID, GRID.points, tracks_with_gap(3.0), ElongationConfig(end_zone=0.1), seen)
    assert GRID.station[CROSSING[0]] < 0.1
    assert (graph.elongation[CROSSING] < ElongationConfig().tau).all()
    assert np.flatnonzero(graph.state[CROSSING] == EdgeState.SEVERED).tolist() == [0]


def test_a_dark_fold_between_points_that_came_nearer_is_no_opening() -> None:
    seen = np.full(len(GRID.edges), 5.0)
    graph = estimate_connectivity(GRID, GRID.points, tracks_with_gap(-4.0), None, seen)
    assert (graph.state[CROSSING] == EdgeState.CONNECTED).all()


def test_an_edge_seen_to_part_stays_severed_when_its_ends_are_hidden() -> None:
    seen = np.zeros(len(GRID.edges))
    seen[CROSSING[4]] = 20.0
    tracks = tracks_with_gap(30.0)
    hidden = tracks.visible.copy()
    hidden[GRID.edges[CROSSING[[4, 5]], 0]] = False
    graph = estimate_connectivity(GRID, GRID.points, replace(tracks, visible=hidden), None, seen)
    assert graph.state[CROSSING[[4, 5]]].tolist() == [EdgeState.SEVERED, EdgeState.UNKNOWN]


def test_an_edge_along_which_nobody_could_look_is_unknown() -> None:
    seen = np.full(len(GRID.edges), 25.0)
    seen[CROSSING[4]] = np.nan
    graph = estimate_connectivity(GRID, GRID.points, tracks_with_gap(30.0), None, seen)
    assert graph.state[CROSSING[4]] == EdgeState.UNKNOWN
    assert graph.probability[CROSSING[4]] == 0.5
    assert not graph.complete


@given(st.floats(0.0, 60.0), st.floats(0.0, 60.0))
def test_probability_grows_with_elongation_and_agrees_with_the_state(a: float, b: float) -> None:
    low, high = (graph_for(g) for g in sorted((a, b)))
    assert (low.probability[CROSSING] <= high.probability[CROSSING] + 1e-12).all()
    for graph in (low, high):
        severed = graph.state[CROSSING] == EdgeState.SEVERED
        assert ((graph.probability[CROSSING] >= 0.5) == severed).all()


@given(st.randoms(use_true_random=False))
def test_the_order_of_edges_does_not_matter(random: object) -> None:
    order = np.random.default_rng(random.randint(0, 10**6)).permutation(len(GRID.edges))  # type: ignore[attr-defined]
    gap = np.linspace(0, 30, COUNT)
    shuffled = Grid(
        GRID.points,
        GRID.edges[order],
        GRID.crosses_goal[order],
        GRID.station[order],
        GRID.near_side,
        GRID.spacing,
        GRID.closed_length,
    )
    one, other = graph_for(gap), graph_for(gap, grid=shuffled)
    assert np.array_equal(one.state[order], other.state)
    assert attachments(one) == attachments(other)


def test_tau_of_one_is_refused() -> None:
    with pytest.raises(ValueError, match="tau"):
        ElongationConfig(tau=1.0)


def test_a_cut_already_open_at_the_reference_counts_from_the_closed_cut() -> None:
    open_at_reference = GRID.points.copy()
    open_at_reference[:, 1] += np.where(GRID.near_side, -10.0, 10.0)
    graph = estimate_connectivity(GRID, open_at_reference, tracks_with_gap(24.0))

    assert graph.elongation[CROSSING] == pytest.approx((24.0 + GRID.closed_length) / GRID.closed_length)
    assert graph.complete
