"""The elongation rule: analytic cases, unknowns, probability, attachments."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hardware.codes import Code
from skills.estimate.elongation import ElongationConfig, estimate_connectivity
from skills.estimate.graph import ConnectivityGraph, EdgeState
from skills.estimate.grid import Grid, GridConfig, grid_around
from skills.estimate.stretches import attachments
from skills.tracking.tracks import Tracks
from tests.skills.goals import straight, tracked_goal

GRID = grid_around(tracked_goal(straight()), 8.0, GridConfig(station_spacing=16.0, end_inset=6.0))
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
    # Half an edge's spacing to either side of the outermost edges reaches past the goal's ends.
    assert attachments(graph) == [(0.0, 1.0)]


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
