"""The sheet that every side of the exposure benchmark simulates, how it is pulled, and what a timed run must look like afterwards."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

SPACING = 0.002  # m between neighbouring vertices
PULL = np.array([0.0003, 0.0, 0.0004])  # m a step, 0.5 mm: along the sheet and up, so that hinges bend and work like edges
STIFFNESS = 0.3  # N/m of an edge where a vertex's inertia is 1 N/m: as much as Newton's Jacobi stands without diverging
BENDING = 0.01  # N/m of a hinge with cotangent weights, on the same scale
BOUND = 0.13  # m, no vertex of a sound run comes so far; a diverged run costs other time and is no measurement

Floats = NDArray[np.float64]
Ints = NDArray[np.int32]


class PeerError(RuntimeError):
    """A peer cannot be measured; the sentence says why."""


@dataclass(frozen=True)
class Sheet:
    """A flat square sheet, pinned at every other vertex of its left border, pulled at the corners of a patch on its right half.

    No two held vertices are neighbours, so that every constraint moves something and none can be skipped by anyone.
    """

    rest: Floats  # (V, 3) [m]
    triangles: Ints  # (F, 3)
    edges: Ints  # (E, 2)
    rest_length: Floats  # (E,) [m]
    hinges: Ints  # (H, 4), the two opposite vertices, then the two on the common edge
    hinge_weights: Floats  # (H, 4), cotangent weights of the flat sheet in the order of `hinges`, sum zero
    pinned: NDArray[np.bool_]  # (V,)
    grasped: NDArray[np.bool_]  # (V,)

    @property
    def constraints(self) -> int:
        """How many constraints one iteration projects."""
        return len(self.edges) + len(self.hinges)


@dataclass(frozen=True)
class Load:
    """The work of one timed run: `worlds` copies of the sheet, `steps` pulls, each of `substeps` times `iterations`."""

    worlds: int = 128
    steps: int = 2
    substeps: int = 2
    iterations: int = 10

    def projections(self, sheet: Sheet) -> int:
        """How many constraint projections a run does; each constraint of each world counts one in each iteration."""
        return self.worlds * self.steps * self.substeps * self.iterations * sheet.constraints


class Runner(Protocol):
    """One side of the comparison, ready to run: compiled, buffers made."""

    name: str
    scheme: str
    note: str  # what else differs from the others

    def reset(self) -> None:
        """Go back to the start; not timed."""

    def run(self) -> None:
        """Do the load; timed."""

    def positions(self) -> Floats:
        """Where the vertices are after a run, (worlds or 1, V, 3) [m]."""


def sheet(side: int = 21) -> Sheet:
    """A sheet of `side` x `side` vertices; 21 gives 1240 edges and 1160 hinges."""
    index = np.arange(side * side, dtype=np.int32).reshape(side, side)
    y, x = np.meshgrid(np.arange(side), np.arange(side), indexing="ij")
    middle = (side - 1) / 2
    rest = np.column_stack([(x.reshape(-1) - middle), (y.reshape(-1) - middle), np.zeros(side * side)]) * SPACING
    a, b, c, d = (part.reshape(-1) for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])
    edges, hinges = _adjacent(triangles)
    column, row = x.reshape(-1), y.reshape(-1)
    return Sheet(
        rest=rest,
        triangles=triangles,
        edges=edges,
        rest_length=np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=1),
        hinges=hinges,
        hinge_weights=_cotangents(rest[hinges]),
        pinned=(column == 0) & (row % 2 == 0),
        grasped=(np.abs(column - (3 * (side - 1)) // 4) == 1) & (np.abs(row - (side - 1) // 2) == 1),
    )


def _adjacent(triangles: Ints) -> tuple[Ints, Ints]:
    """The edges (E, 2), and for each edge between two triangles the hinge (H, 4): opposite vertices, then the edge."""
    found: dict[tuple[int, int], list[tuple[int, int, int]]] = {}
    for p, q, r in triangles.tolist():
        for u, v, opposite in ((p, q, r), (q, r, p), (r, p, q)):
            found.setdefault((min(u, v), max(u, v)), []).append((opposite, u, v))
    hinges = [(first[0], second[0], first[1], first[2]) for first, second in (s for s in found.values() if len(s) == 2)]
    return np.array(list(found), np.int32), np.array(hinges, np.int32)


def _cotangents(corners: Floats) -> Floats:
    """Weights (H, 4) of the isometric bending of hinges whose corners are (H, 4, 3)."""
    i, j, k, m = np.moveaxis(corners, 1, 0)

    def cot(at: Floats, one: Floats, two: Floats) -> Floats:
        u, v = one - at, two - at
        return np.asarray((u * v).sum(axis=1) / np.linalg.norm(np.cross(u, v), axis=1))

    ik, jk, im, jm = cot(k, m, i), cot(k, m, j), cot(m, k, i), cot(m, k, j)
    return np.stack([-(ik + im), -(jk + jm), im + jm, ik + jk], axis=1)


def check(sheet: Sheet, load: Load, positions: Floats, name: str) -> None:
    """Refuse a run that diverged, did not pull, or did not solve anything: its time is that of something else."""
    if not np.isfinite(positions).all() or np.abs(positions).max() > BOUND:
        raise PeerError(f"{name} diverged: a vertex is at {np.abs(positions).max():.3g} m.")
    moved = np.linalg.norm(positions - sheet.rest, axis=-1)
    pulled, free = moved[:, sheet.grasped], moved[:, ~(sheet.grasped | sheet.pinned)]
    if pulled.min() < 0.1 * load.steps * np.linalg.norm(PULL):
        raise PeerError(f"{name} did not pull: a grasped vertex moved by {pulled.min():.3g} m only.")
    if free.max() > 1.2 * pulled.max():
        raise PeerError(f"{name} diverged: a free vertex moved by {free.max():.3g} m, the grasp by {pulled.max():.3g} m.")
    if free.max() < 0.1 * pulled.max():
        raise PeerError(f"{name} solved nothing: no free vertex followed the grasp.")
