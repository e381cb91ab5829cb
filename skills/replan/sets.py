"""Many small sets at once: rows of booleans packed into words, compared bit by bit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Sets = NDArray[np.bool_]
Words = NDArray[np.uint64]

BLOCK = 128  # sets compared at a time


def words(sets: Sets) -> Words:
    """Pack each row of `sets` (S, E) into words of 64 members (S, W)."""
    packed = np.packbits(sets, axis=1)
    width = max(8, packed.shape[1] + -packed.shape[1] % 8)
    full = np.zeros((len(sets), width), dtype=np.uint8)
    full[:, : packed.shape[1]] = packed
    return full.view(np.uint64)


def distinct(sets: Sets) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First index of each distinct row of `sets` (S, E), and for each row which of them it is (S,)."""
    if not len(sets):
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    keys = words(sets)
    order = np.lexsort(keys.T)  # stable: the first of equal rows comes first
    new = np.concatenate([[True], (keys[order[1:]] != keys[order[:-1]]).any(axis=1)])
    which = np.empty(len(sets), dtype=np.int64)
    which[order] = np.cumsum(new) - 1
    return order[new], which


def contained(a: Words, b: Words) -> NDArray[np.bool_]:
    """Which rows of `a` (A, W) are subsets of which rows of `b` (B, W): (A, B)."""
    beside = np.ascontiguousarray(~b.T)
    outside = a[:, :1] & beside[0]
    for k in range(1, a.shape[1]):
        outside |= a[:, k : k + 1] & beside[k]
    return np.asarray(outside == 0)


def uncontained(sets: Sets) -> NDArray[np.int64]:
    """Indices of the rows of `sets` (S, E) that are not a subset of any row before them."""
    keys = words(sets)
    kept = np.zeros(0, dtype=np.int64)
    for start in range(0, len(sets), BLOCK):
        block = np.arange(start, min(start + BLOCK, len(sets)))
        block = block[~contained(keys[block], keys[kept]).any(axis=1)]
        inside = contained(keys[block], keys[block]) & (block[None] < block[:, None])
        kept = np.concatenate([kept, block[~inside.any(axis=1)]])
    return kept


def meeting(sets: Sets) -> NDArray[np.bool_]:
    """Which rows of `sets` (S, E) have a member in common: (S, S)."""
    keys = words(sets)
    return ~contained(keys, ~keys)  # none in common: one lies in what the other leaves out
