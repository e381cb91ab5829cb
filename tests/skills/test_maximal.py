"""The candidate set loses nothing: what any segment cuts together, one of its segments cuts together too."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware.interface import Array
from skills.replan.maximal import Cuts, maximal_cuts, maximal_rows
from skills.scene.segments import touch
from tests.skills.uncut import across, anywhere, segments_among

LENGTH = 60.0
MANY = 10**6


def cuts_of(edges: Array, known: np.ndarray | None = None) -> Cuts:
    cuts = maximal_cuts(edges, LENGTH, MANY, known)
    assert cuts is not None
    return cuts


def lost(edges: Array, cuts: Cuts, segments: Array) -> int:
    sets = np.unique(touch(segments, edges), axis=0).astype(int)
    within = sets @ cuts.covers.T.astype(int) == sets.sum(axis=1)[:, None]
    return int((~within.any(axis=1)).sum())


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 9), st.integers(0, 10**6), st.booleans())
def test_no_segment_cuts_a_set_that_no_candidate_cuts(count: int, seed: int, jumbled: bool) -> None:
    rng = np.random.default_rng(seed)
    edges = anywhere(rng, count) if jumbled else across(rng, count, length=120.0)
    assert lost(edges, cuts_of(edges), segments_among(rng, edges, LENGTH, 4000)) == 0


@settings(max_examples=30, deadline=None)
@given(st.integers(2, 9), st.integers(0, 10**6))
def test_what_is_known_already_shortens_the_search_without_losing_anything(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    edges = across(rng, count, length=120.0)
    segments = segments_among(rng, edges, LENGTH, 50)
    known = touch(segments, edges)
    new = cuts_of(edges, known)
    together = Cuts(np.concatenate([segments, new.segments]), np.concatenate([known, new.covers]))
    assert lost(edges, together, segments_among(rng, edges, LENGTH, 4000)) == 0
    every = {row.tobytes() for row in cuts_of(edges).covers}
    assert {row.tobytes() for row in new.covers} <= every
    assert {row.tobytes() for row in together.covers[maximal_rows(together.covers)]} == every


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 12), st.integers(0, 10**6))
def test_candidates_keep_the_length_and_cut_what_they_say(count: int, seed: int) -> None:
    edges = anywhere(np.random.default_rng(seed), count)
    cuts = cuts_of(edges)
    assert (np.linalg.norm(cuts.segments[:, 1] - cuts.segments[:, 0], axis=1) <= LENGTH + 1e-9).all()
    assert (touch(cuts.segments, edges) == cuts.covers).all()
    assert cuts.covers.any(axis=0).all()


def test_two_edges_at_just_the_length_are_cut_squarely() -> None:
    edges = np.array([[[0.0, -30.0], [0.0, 5.0]], [[59.99, -5.0], [59.99, 30.0]]])
    assert cuts_of(edges).covers.all(axis=1).any()
    assert not cuts_of(edges + np.array([[[0.0, 0.0]], [[0.02, 0.0]]])).covers.all(axis=1).any()


def test_a_point_between_two_slanted_edges_is_passed_on_the_shortest_way() -> None:
    # The way through the middle point from edge to edge is shortest at no end of either.
    edges = np.array([[[-30.0, -40.0], [-29.0, 40.0]], [[0.0, 0.0], [0.0, 50.0]], [[29.0, -40.0], [30.0, 40.0]]])
    apart = 59.0 * np.cos(np.arctan2(1.0, 80.0))
    cuts = maximal_cuts(edges, apart + 1e-3, MANY)
    assert cuts is not None and cuts.covers.all(axis=1).any()


def test_too_many_candidates_are_refused() -> None:
    assert maximal_cuts(across(np.random.default_rng(0), 20), LENGTH, 10) is None


@pytest.mark.parametrize("length", [5.0, 200.0])
def test_an_edge_longer_than_the_segment_is_still_cut(length: float) -> None:
    edges = np.array([[[0.0, 0.0], [100.0, 0.0]]])
    cuts = maximal_cuts(edges, length, MANY)
    assert cuts is not None and cuts.covers.all()
