"""Set cover by branch and bound, for problems small enough that an integer programme's overhead is the greater part of its time."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array


def cheapest_by_branching(covers: NDArray[np.bool_], costs: Array, nodes: int, gap: float) -> tuple[NDArray[np.int64], bool]:
    """Choose rows of `covers` (S, E) that cover every column at a small sum of `costs` (S,).

    Also says whether none do so at a sum that is less by more than `gap`, or that was not settled within `nodes` branches. The first
    descent is always finished, so that there is a cover.
    """
    search = _Search.of(covers, costs, nodes, gap)
    search.branch((1 << covers.shape[1]) - 1, (1 << len(covers)) - 1, 0.0, [])
    return np.array(sorted(search.best), dtype=np.int64), search.nodes >= 0


@dataclass
class _Search:
    """Sets are bits of integers: `rows[s]` the columns that s covers, `able[e]` the rows that cover e.

    `rivals[e]` are the columns that share a row with e. Columns come in the order of how few rows cover them.
    """

    rows: list[int]
    able: list[int]
    rivals: list[int]
    members: list[list[int]]  # of each column, the rows that cover it, cheapest and then greatest first
    costs: list[float]
    nodes: int
    gap: float
    best: list[int] = field(default_factory=list)
    best_cost: float = np.inf

    @staticmethod
    def of(covers: NDArray[np.bool_], costs: Array, nodes: int, gap: float) -> _Search:
        by_rarity = np.argsort(covers.sum(axis=0), kind="stable")
        covers = covers[:, by_rarity]
        liked = np.lexsort([-covers.sum(axis=1), costs])
        rows, able = _bits(covers), _bits(covers.T)
        shared = covers.T.astype(np.int64) @ covers.astype(np.int64) > 0
        members = [liked[covers[liked, e]].tolist() for e in range(covers.shape[1])]
        return _Search(rows, able, _bits(shared), members, costs.tolist(), nodes, gap)

    def branch(self, left: int, allowed: int, cost: float, chosen: list[int]) -> None:
        """Complete `chosen`, of `cost`, by `allowed` rows so that the columns `left` are covered; keep the best in `best`."""
        if not left:
            if cost < self.best_cost - self.gap:
                self.best, self.best_cost = list(chosen), cost
            return
        self.nodes -= 1
        if (self.nodes < 0 and self.best) or cost + self._least(left, allowed) >= self.best_cost - self.gap:
            return
        column = min(_members(left), key=lambda e: (self.able[e] & allowed).bit_count())
        for row in sorted(self.members[column], key=lambda s: -(self.rows[s] & left).bit_count() if allowed >> s & 1 else 1):
            if allowed >> row & 1:
                # All covers with this row are looked at here, so its later siblings do without it.
                allowed &= ~(1 << row)
                self.branch(left & ~self.rows[row], allowed, cost + self.costs[row], [*chosen, row])

    def _least(self, left: int, allowed: int) -> float:
        """What covering the columns `left` costs at least: columns without a common row each need a row of their own."""
        least = 0.0
        while left:
            column = (left & -left).bit_length() - 1
            first = next((s for s in self.members[column] if allowed >> s & 1), None)
            if first is None:
                return float(np.inf)
            least += self.costs[first]
            left &= ~self.rivals[column]
        return least


def _bits(sets: NDArray[np.bool_]) -> list[int]:
    """Each row of `sets` (S, E) as an integer, member e as bit e."""
    return [int.from_bytes(row.tobytes(), "little") for row in np.packbits(sets, axis=1, bitorder="little")]


def _members(bits: int) -> list[int]:
    found = []
    while bits:
        low = bits & -bits
        found.append(low.bit_length() - 1)
        bits ^= low
    return found
