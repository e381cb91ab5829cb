"""The minimum cover beside all covers there are."""

from itertools import combinations
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skills.replan import cover as module
from skills.replan.cover import minimum_cover, telling_columns
from skills.replan.sweep import cheapest_by_sweeping


def instance(sets: int, members: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A cover problem that can be solved, with costs of 1 to 2."""
    rng = np.random.default_rng(seed)
    covers = rng.random((sets, members)) < 0.35
    covers[rng.integers(sets, size=members), np.arange(members)] = True
    return covers, 1.0 + rng.random(sets)


def cheapest(covers: np.ndarray, costs: np.ndarray) -> float:
    """The least cost over all subsets of the rows."""
    return min(
        costs[list(some)].sum()
        for size in range(1, len(covers) + 1)
        for some in combinations(range(len(covers)), size)
        if covers[list(some)].any(axis=0).all()
    )


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 10**6), st.booleans())
def test_no_subset_is_a_cheaper_cover(sets: int, members: int, seed: int, unit: bool) -> None:
    covers, costs = instance(sets, members, seed)
    costs = np.ones(sets) if unit else costs
    cover = minimum_cover(covers, costs, 1000)
    assert covers[cover.chosen].any(axis=0).all()
    assert cover.cost == pytest.approx(cheapest(covers, costs), abs=1e-5)
    assert cover.bound <= cover.cost <= cover.bound + 1e-5


@settings(max_examples=15, deadline=None)
@given(st.integers(8, 30), st.integers(8, 30), st.integers(0, 10**6))
def test_the_integer_programme_agrees_with_the_sweep(sets: int, members: int, seed: int) -> None:
    covers, costs = instance(sets, members, seed)
    by_programme, bound = module._by_programme(covers, costs, 10**4)
    swept, settled = cheapest_by_sweeping(covers, costs, 10**6)
    assert settled and covers[swept].any(axis=0).all()
    assert costs[by_programme].sum() == pytest.approx(costs[swept].sum(), abs=1e-5)
    assert bound == pytest.approx(costs[by_programme].sum(), abs=1e-4)


def test_sets_along_a_line_in_any_order_are_swept_with_few_states() -> None:
    rng = np.random.default_rng(5)
    place, first, reach = np.arange(100), rng.integers(0, 95, 300), rng.integers(2, 9, 300)
    covers = (place >= first[:, None]) & (place < (first + reach)[:, None]) & (rng.random((300, 100)) < 0.95)
    covers = np.concatenate([covers, np.eye(100, dtype=bool)])[:, rng.permutation(100)]
    costs = 1.0 + 0.1 * rng.random(400)
    swept, settled = cheapest_by_sweeping(covers, costs, module.WIDTH)
    by_programme, _ = module._by_programme(covers, costs, 10**4)
    assert settled and covers[swept].any(axis=0).all()
    assert costs[swept].sum() == pytest.approx(costs[by_programme].sum(), abs=1e-4)


def test_a_sweep_that_is_too_wide_covers_and_claims_nothing() -> None:
    covers, costs = instance(25, 25, 3)
    swept, settled = cheapest_by_sweeping(covers, costs, 1)
    assert covers[swept].any(axis=0).all() and not settled


def test_a_problem_too_wide_for_the_sweep_goes_to_the_programme(monkeypatch: pytest.MonkeyPatch) -> None:
    covers, costs = instance(25, 25, 3)
    settled = minimum_cover(covers, costs, 1000)
    monkeypatch.setattr(module, "WIDTH", 1)
    cover = minimum_cover(covers, costs, 1000)
    assert cover.cost == pytest.approx(settled.cost, abs=1e-5)
    assert cover.bound == pytest.approx(settled.bound, abs=1e-4)


def test_without_a_settled_search_there_is_a_cover_but_no_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    covers, costs = instance(25, 25, 3)
    monkeypatch.setattr(module, "WIDTH", 1)
    cover = minimum_cover(covers, costs, 0)
    assert covers[cover.chosen].any(axis=0).all()
    assert cover.bound < minimum_cover(covers, costs, 1000).bound


def test_a_programme_that_fails_proves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    covers, costs = instance(25, 25, 3)
    failed = SimpleNamespace(status=4, mip_dual_bound=1e3, x=None)
    monkeypatch.setattr(module, "WIDTH", 1)
    monkeypatch.setattr(module, "milp", lambda *_, **__: failed)
    cover = minimum_cover(covers, costs, 1000)
    assert covers[cover.chosen].any(axis=0).all() and cover.bound == 0.0


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 9), st.integers(1, 9), st.integers(0, 10**6))
def test_the_telling_columns_need_as_many_rows_as_all(sets: int, members: int, seed: int) -> None:
    covers, _ = instance(sets, members, seed)
    some = telling_columns(covers)
    assert cheapest(covers[:, some], np.ones(sets)) == cheapest(covers, np.ones(sets))


def test_what_cannot_be_covered_is_refused() -> None:
    with pytest.raises(ValueError, match="1 columns"):
        minimum_cover(np.array([[True, False]]), np.ones(1), 10)
    with pytest.raises(ValueError, match="positive"):
        minimum_cover(np.array([[True]]), np.zeros(1), 10)
