"""The order of cutting beside all orders there are."""

from itertools import permutations, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skills.replan.order import EXACT_UP_TO, least_travel, travel
from tests.skills.goals import straight, tracked_goal

TRACKED = tracked_goal(straight())


@settings(max_examples=25, deadline=None)
@given(st.integers(1, 4), st.integers(0, 10**6))
def test_no_order_and_no_way_round_travels_less(count: int, seed: int) -> None:
    segments = np.random.default_rng(seed).uniform([160.0, 200.0], [480.0, 280.0], (count, 2, 2))
    best = min(
        travel(segments, np.array(order), np.array(turned))
        for order in permutations(range(count))
        for turned in product((False, True), repeat=count)
    )
    assert travel(segments, *least_travel(segments, TRACKED)) == pytest.approx(best)


@pytest.mark.parametrize("count", [5, EXACT_UP_TO, EXACT_UP_TO + 3])
def test_segments_in_line_are_cut_along_the_goal(count: int) -> None:
    u = np.linspace(460.0, 180.0, count)
    segments = np.stack([np.column_stack([u, np.full(count, 240.0)]), np.column_stack([u - 15.0, np.full(count, 240.0)])], axis=1)
    mixed = np.random.default_rng(count).permutation(count)
    order, turned = least_travel(segments[mixed], TRACKED)
    assert mixed[order].tolist() == list(range(count))
    assert not turned.any()
