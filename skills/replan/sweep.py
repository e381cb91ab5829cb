"""Set cover column by column, for sets that lie along a line: dynamic programming over what is left to cover.

Segments reach a short way along the goal only. So whatever was chosen for the columns up to some place, few different things can be
left beyond it, and of two choices that leave the same the dearer can be forgotten.
"""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import reverse_cuthill_mckee

from hardware.interface import Array
from skills.replan.sets import meeting

T = TypeVar("T")

A_FEW = 10  # states that go on for each column where keeping all would take too long


class _State(NamedTuple):
    """Rows chosen so far at a `cost`: the last `row` and those of the state `before` it. Columns are bits of `left`."""

    cost: float
    left: int
    row: int
    before: _State | None


def cheapest_by_sweeping(covers: NDArray[np.bool_], costs: Array, width: int) -> tuple[NDArray[np.int64], bool]:
    """Choose rows of `covers` (S, E) that cover every column, each of which some row covers, at the least sum of `costs` (S,).

    Also says whether no cover is cheaper. Once more than `width` states would have to be kept for one column, a few of the cheapest
    go on, and nothing is claimed.
    """
    covers = covers[:, _in_line(covers)]
    count = covers.shape[1]
    rows, price = _bits(covers), costs.tolist()
    # States by the first column that is left: each row chosen next covers it, so a state only moves on.
    waiting: list[dict[int, _State]] = [{} for _ in range(count + 1)]
    waiting[0][(1 << count) - 1] = _State(0.0, (1 << count) - 1, -1, None)
    settled = True
    for column in range(count):
        kept = _undominated([(state.cost, state.left, state) for state in waiting[column].values()], width + 1)
        if len(kept) > width:
            settled, width = False, min(width, A_FEW)
        ahead = (1 << count) - (1 << column)
        able = _undominated(
            [(price[row], ahead & ~rows[row], row) for row in np.flatnonzero(covers[:, column]).tolist()], len(rows)
        )
        for before, left_before, state in kept[:width]:
            for more, beside, row in able:
                left, cost = left_before & beside, before + more
                then = waiting[(left & -left).bit_length() - 1 if left else count]
                if left not in then or cost < then[left].cost:
                    then[left] = _State(cost, left, row, state)
        waiting[column].clear()
    chosen: list[int] = []
    state = waiting[count][0]
    while state.before is not None:
        chosen.append(state.row)
        state = state.before
    return np.array(sorted(chosen), dtype=np.int64), settled


def _undominated(choices: list[tuple[float, int, T]], most: int) -> list[tuple[float, int, T]]:
    """The cheapest, up to `most`, of `choices` (cost, columns left, what) beside which no other leaves as few for no more."""
    kept: list[tuple[float, int, T]] = []
    for choice in sorted(choices, key=lambda c: (c[0], c[1].bit_count())):
        taken = ~choice[1]
        for other in kept:
            if not other[1] & taken:
                break
        else:
            kept.append(choice)
            if len(kept) == most:
                break
    return kept


def _in_line(covers: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Order of the columns of `covers` (S, E) in which those that share rows come near each other."""
    if covers.shape[1] < 2:
        return np.arange(covers.shape[1])
    return np.asarray(reverse_cuthill_mckee(csr_matrix(meeting(covers.T)), symmetric_mode=True), dtype=np.int64)


def _bits(sets: NDArray[np.bool_]) -> list[int]:
    """Each row of `sets` (S, E) as an integer, member e as bit e."""
    return [int.from_bytes(row.tobytes(), "little") for row in np.packbits(sets, axis=1, bitorder="little")]
