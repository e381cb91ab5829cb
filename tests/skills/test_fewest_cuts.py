"""The fewest segments beside a brute force over all sets of candidates, and beside the greedy cover."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware.interface import Array
from skills.replan import optimal
from skills.replan.candidates import ReplanConfig
from skills.replan.greedy import greedy_cuts
from skills.replan.maximal import maximal_cuts
from skills.replan.optimal import FewestCuts, fewest_cuts
from skills.replan.room import Room
from skills.scene.segments import touch
from tests.skills.goals import straight, tracked_goal
from tests.skills.uncut import across

TRACKED = tracked_goal(straight(), half=20.0, grasp=(320.0, 60.0))
CONFIG = ReplanConfig()
ROOM = Room(None, TRACKED.grasp, CONFIG.grasp_clearance)


def fewest_by_force(edges: Array) -> int:
    """The least number over all subsets of all maximal sets."""
    cuts = maximal_cuts(edges, CONFIG.segment_length, 10**6)
    assert cuts is not None
    sets = np.unique(cuts.covers, axis=0)
    return next(
        size for size in range(1, len(edges) + 1) if any(np.logical_or.reduce(some).all() for some in combinations(sets, size))
    )


def assert_severs(fewest: FewestCuts, edges: Array) -> None:
    assert (touch(fewest.segments, edges) == fewest.covers).all()
    assert fewest.covers.any(axis=0).all()
    length = np.linalg.norm(fewest.segments[:, 1] - fewest.segments[:, 0], axis=1)
    assert (length <= CONFIG.segment_length + 1e-9).all()


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 9), st.integers(0, 10**6))
def test_no_cover_there_is_has_fewer_segments(count: int, seed: int) -> None:
    edges = across(np.random.default_rng(seed), count)
    fewest = fewest_cuts(edges, TRACKED, CONFIG, ROOM)
    assert_severs(fewest, edges)
    assert len(fewest.segments) == fewest.bound == fewest_by_force(edges)


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 60), st.integers(0, 10**6))
def test_the_cover_is_never_larger_than_the_greedy_one(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    edges = across(rng, count)
    greedy = greedy_cuts(edges, TRACKED, CONFIG, rng, None, edges[:0])
    fewest = fewest_cuts(edges, TRACKED, CONFIG, ROOM)
    assert_severs(fewest, edges)
    assert fewest.bound <= len(fewest.segments) <= len(greedy.segments)


def test_jagged_edges_take_fewer_segments_than_the_greedy_cover() -> None:
    saved = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        edges = across(rng, 40)
        greedy = greedy_cuts(edges, TRACKED, CONFIG, rng, None, edges[:0])
        saved.append(len(greedy.segments) - len(fewest_cuts(edges, TRACKED, CONFIG, ROOM).segments))
    assert np.mean(saved) > 0.5


def test_of_as_few_segments_those_that_stay_at_the_goal_are_taken() -> None:
    u = np.linspace(200.0, 240.0, 6)
    edges = np.stack([np.column_stack([u, np.full(6, v)]) for v in (200.0, 280.0)], axis=1)
    (segment,) = fewest_cuts(edges, TRACKED, CONFIG, ROOM).segments
    assert np.abs(segment[:, 1] - 240.0).max() < CONFIG.corridor


def test_segments_stay_in_their_room_and_the_proof_holds_there() -> None:
    outline = np.zeros((480, 640), dtype=bool)
    outline[200:280, 195:250] = True
    u = np.linspace(200.0, 240.0, 6)
    edges = np.stack([np.column_stack([u, np.full(6, v)]) for v in (226.0, 254.0)], axis=1)
    fewest = fewest_cuts(edges, TRACKED, CONFIG, Room(outline, TRACKED.grasp, 0.0))
    assert_severs(fewest, edges)
    assert fewest.proven and len(fewest.segments) == 1
    assert ((fewest.segments[..., 0] > 194.4) & (fewest.segments[..., 0] < 249.6)).all()


def test_where_there_is_no_room_nothing_is_claimed() -> None:
    edges = across(np.random.default_rng(1), 5)
    fewest = fewest_cuts(edges, TRACKED, CONFIG, Room(np.zeros((480, 640), dtype=bool), TRACKED.grasp, 0.0))
    assert (fewest.missing, len(fewest.segments), fewest.proven) == (5, 0, False)


def test_a_search_that_is_cut_short_still_covers_and_claims_no_proof(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(optimal, "maximal_cuts", lambda *_: None)
    edges = across(np.random.default_rng(2), 40)
    fewest = fewest_cuts(edges, TRACKED, CONFIG, ROOM)
    assert_severs(fewest, edges)
    assert not fewest.proven


def test_one_case_has_one_answer() -> None:
    edges = across(np.random.default_rng(4), 50)
    one, other = (fewest_cuts(edges, TRACKED, CONFIG, ROOM) for _ in range(2))
    assert np.array_equal(one.segments, other.segments)
