"""Plane segments: touching, spans and distances."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from skills.scene.segments import distances, span, touch

GRID = st.integers(-4, 4).map(float)
SEGMENT = st.tuples(st.tuples(GRID, GRID), st.tuples(GRID, GRID))


def seg(*points: tuple[float, float]) -> np.ndarray:
    return np.array(points, dtype=float)


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        (((0, 0), (4, 4)), ((0, 4), (4, 0)), True),
        (((0, 0), (4, 0)), ((2, 0), (2, 3)), True),  # an end on the other
        (((0, 0), (4, 0)), ((4, 0), (6, 2)), True),  # a shared end
        (((0, 0), (4, 0)), ((2, 0), (9, 0)), True),  # overlap on one line
        (((0, 0), (4, 0)), ((5, 0), (9, 0)), False),  # one line, apart
        (((0, 0), (4, 0)), ((0, 1), (4, 1)), False),  # parallel
        (((0, 0), (4, 0)), ((5, -1), (5, 1)), False),
        (((2, 0), (2, 0)), ((0, 0), (4, 0)), True),  # a point on a segment
    ],
)
def test_touching_counts_and_apart_does_not(a: tuple, b: tuple, expected: bool) -> None:
    assert touch(seg(*a)[None], seg(*b)[None])[0, 0] == expected


@given(SEGMENT, SEGMENT)
def test_touching_is_symmetric_and_means_zero_distance(a: tuple, b: tuple) -> None:
    one, other = seg(*a), seg(*b)
    forward = touch(one[None], other[None])[0, 0]
    assert forward == touch(other[None], one[None])[0, 0] == touch(one[::-1][None], other[None])[0, 0]
    t = np.linspace(0, 1, 2521)[:, None]  # divisible by all denominators that coordinates this small give, nearly
    nearest = distances(one[0] + t * (one[1] - one[0]), other[None]).min()
    assert nearest < 5e-3 if forward else nearest > 1e-3


def test_a_span_holds_every_meeting() -> None:
    low, high = span(seg((0, 0), (10, 0)), np.stack([seg((2, -1), (2, 1)), seg((7, -1), (7, 1)), seg((5, 0), (6, 0))]))
    assert (low, high) == pytest.approx((0.2, 0.7))


def test_a_span_along_an_overlap_covers_it() -> None:
    low, high = span(seg((0, 0), (10, 0)), seg((4, 0), (14, 0))[None])
    assert (low, high) == pytest.approx((0.4, 1.0))


def test_distance_beyond_an_end_is_to_that_end() -> None:
    assert distances(np.array([[7.0, 4.0]]), seg((0, 0), (4, 0))[None])[0, 0] == pytest.approx(5.0)
