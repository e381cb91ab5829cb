"""Minimum-cost set cover, proven: simple reductions, then a sweep along the columns; an integer programme (HiGHS) where that is too wide.

HiGHS comes with SciPy and with CasADi; through SciPy it was the faster on most sizes of programme that were timed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import csc_matrix

from hardware.interface import Array
from skills.replan.sets import contained, distinct, uncontained, words
from skills.replan.sweep import cheapest_by_sweeping

PASSES = 2  # of the reductions
WIDTH = 200  # states that the sweep keeps for one column; it seldom needs a tenth of them
GAP = 1e-6  # of cost, within which the integer programme has to find the cheapest cover


@dataclass(frozen=True)
class Cover:
    """`chosen` rows that cover every column. No cover costs less than `bound`."""

    chosen: NDArray[np.int64]
    cost: float
    bound: float


def minimum_cover(covers: NDArray[np.bool_], costs: Array, nodes: int) -> Cover:
    """Choose rows of `covers` (S, E) that together cover every column at the least sum of `costs` (S,), all positive.

    `nodes` limits the branches that the integer programme explores, 0 does without it: a count, not a clock, so that equal problems
    have equal answers.

    Raises:
        ValueError: a column that no row covers, or a cost that is not positive.
    """
    if not covers.any(axis=0).all():
        raise ValueError(f"{int((~covers.any(axis=0)).sum())} columns are covered by no row; every column needs one")
    if not (costs > 0).all():
        raise ValueError("costs must be positive")
    rows, columns = _reduced(covers, costs)
    part, price = covers[np.ix_(rows, columns)], costs[rows]
    chosen, settled = cheapest_by_sweeping(part, price, WIDTH)
    cost = float(price[chosen].sum())
    bound = cost if settled else 0.0
    if not settled and nodes:
        better, bound = _by_programme(part, price, nodes)
        if len(better) and price[better].sum() < cost:
            chosen, cost = better, float(price[better].sum())
        bound = min(bound, cost)
    return Cover(rows[chosen], cost, bound)


def telling_columns(covers: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Columns of `covers` (S, E) that are covered only together with all others: a least cover of these is one of all.

    Rows that are part of another row are not looked at; of equal columns the first is given.
    """
    greatest = covers[_cheapest(covers, np.ones(len(covers)))]
    first = np.sort(distinct(greatest.T)[0])
    return first[~_implied(greatest[:, first])]


def _reduced(covers: NDArray[np.bool_], costs: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns that are left of the problem after the classic reductions; a cheapest cover of these is one of all.

    A row goes when another covers all that it does at no higher cost; a column goes when another is covered by none but rows that
    cover it too. Either lets more of the other go, but after `PASSES` little is gained.
    """
    rows, columns, part = np.arange(len(covers)), np.arange(covers.shape[1]), covers
    for _ in range(PASSES):
        kept = _cheapest(part, costs[rows])
        rows, part = rows[kept], part[kept]
        kept = np.sort(distinct(part.T)[0])
        columns, part = columns[kept], part[:, kept]
        told = ~_implied(part)
        columns, part = columns[told], part[:, told]
    return rows, columns


def _cheapest(covers: NDArray[np.bool_], costs: Array) -> NDArray[np.int64]:
    """Indices of rows that are not empty and not part of another row that costs no more (of equals, the first stays)."""
    # Cheapest first, greatest first among equals: then only rows before one can make it needless.
    size = covers.sum(axis=1)
    order = np.lexsort([-size, costs])
    order = order[size[order] > 0]
    return np.sort(order[uncontained(covers[order])])


def _implied(covers: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which columns (all different) are covered by every row that covers some other column."""
    members = words(covers.T)
    implies = contained(members, members)  # [j, i]: whoever covers j covers i
    np.fill_diagonal(implies, False)
    return np.asarray(implies.any(axis=0))


def _by_programme(covers: NDArray[np.bool_], costs: Array, nodes: int) -> tuple[NDArray[np.int64], float]:
    """Rows that cover every column, none if none were found within `nodes`, and a lower bound of the cost."""
    each = LinearConstraint(csc_matrix(covers.T.astype(np.float64)), 1.0, np.inf)
    options = {"node_limit": nodes, "mip_rel_gap": GAP / float(costs.sum())}
    result = milp(costs, integrality=np.ones(len(costs)), bounds=Bounds(0.0, 1.0), constraints=each, options=options)
    # A solver that stops for another reason than success or the limit proves nothing.
    proves = result.status in (0, 1) and result.mip_dual_bound is not None and np.isfinite(result.mip_dual_bound)
    bound = float(result.mip_dual_bound) if proves else 0.0
    chosen = np.zeros(0, dtype=np.int64) if result.x is None else np.flatnonzero(result.x > 0.5)
    return chosen if covers[chosen].any(axis=0).all() else chosen[:0], bound
