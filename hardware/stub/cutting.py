"""Cuts the sheet's mesh along arbitrary lines: the mesh is made to conform to the line, then opened along it.

In rest coordinates: the line is walked from triangle to triangle; the nearer end of each edge it crosses is moved onto it, or the edge
is divided where that would squash a triangle; the edges on the line are marked; finally every vertex on the line is divided by connected
fans of triangles. Fans handle tips, borders, crossing and joining cuts with one rule. Tissue severed only in part of its thickness is
opened too, and its lips are joined by seams with damage between 0 and 1.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array
from hardware.stub.sheetmesh import distance_to_line

SNAP = 0.45  # of the local edge length: a line that ends this near to a vertex ends at it
BLUNT = 0.12  # of an edge: crossings nearer than this to an immovable vertex go through it
QUALITY = 0.30  # least shape quality (1 equilateral, 0 flat) that moving a vertex may leave
SHORTEST = 5e-6  # [m]: an edge is not divided into parts shorter than this; the line goes through its nearer end
SEAM_REACH = 0.5e-3  # [m]: a later cut that passes this near to a seam damages it too


@dataclass
class CutEdge:
    """One edge of the cut network in rest coordinates [m]: ends `a`, `b`, severed fraction `damage`, and whether it tore."""

    a: tuple[float, float]
    b: tuple[float, float]
    damage: float
    torn: bool

    @property
    def length(self) -> float:
        """[m]."""
        return float(np.hypot(self.b[0] - self.a[0], self.b[1] - self.a[1]))


@dataclass
class Seam:
    """What joins vertices `a` and `b` of a partly severed edge: `width` [m] of tissue of which the fraction `damage` is gone."""

    a: int
    b: int
    width: float
    damage: float
    edge: CutEdge


class SheetMesh:
    """A triangle mesh in rest coordinates that can be cut. Vertices and triangles are only ever added."""

    def __init__(self, rest: Array, triangles: NDArray[np.int32]) -> None:
        self.rest = np.array(rest, dtype=np.float64)
        self.triangles = np.array(triangles, dtype=np.int32)
        self.cut_edges: list[CutEdge] = []
        self.seams: list[Seam] = []
        self.revision = 0
        self._fans: list[set[int]] = [set() for _ in range(len(self.rest))]
        for t, corners in enumerate(self.triangles.tolist()):
            for v in corners:
                self._fans[v].add(t)
        self._carried = np.zeros((len(self.rest), 0))
        self._source = list(range(len(self.rest)))
        self._lips: set[int] = set()

    def cut(self, line: Array, damage: float, carried: Array, torn: bool = False) -> Array:
        """Cut along the polyline `line` (M, 2) [m]; `carried` (V, k) are values per vertex, returned for the new vertices too.

        `damage` in (0, 1] is the fraction of the thickness that is severed.
        """
        self._carried = carried
        self._worsen_seams(np.asarray(line), damage)
        path: list[tuple[int, int]] = []
        fixed: set[int] = set()
        for p, q in itertools.pairwise(line):
            path += self._walk(np.asarray(p, float), np.asarray(q, float), fixed)
        path = self._openable(path)
        if path:
            self._open(path, damage, torn)
        self.revision += 1
        return self._carried

    def take_sources(self, count: int) -> NDArray[np.int64]:
        """For every vertex, the older vertex (of the first `count`) that it came from; asked once after each group of cuts."""
        source = np.array(self._source)
        while (source >= count).any():
            source = np.where(source >= count, source[source], source)
        self._source = list(range(len(self.rest)))
        return source

    def lip_vertices(self) -> NDArray[np.int64]:
        """Vertices on fully severed lips made since the last call."""
        lips, self._lips = sorted(self._lips), set()
        return np.array(lips, dtype=np.int64)

    def locate(self, point: Array) -> int:
        """The triangle that holds `point` (2,), or -1."""
        a, b, c = (self.rest[self.triangles[:, i]] for i in range(3))
        inside = (
            (_cross(b - a, point - a) >= -1e-13) & (_cross(c - b, point - b) >= -1e-13) & (_cross(a - c, point - c) >= -1e-13)
        )
        hits = np.flatnonzero(inside)
        return int(hits[0]) if len(hits) else -1

    # ------------------------------------------------------------ walking

    def _walk(self, p: Array, q: Array, fixed: set[int]) -> list[tuple[int, int]]:
        """Make the mesh conform to the segment p-q; the vertex pairs along it, in order."""
        path: list[tuple[int, int]] = []
        length = float(np.linalg.norm(q - p))
        if length < 1e-6:
            return path
        direction = (q - p) / length
        skipped = 0.0
        at = self._enter(p, q, fixed)
        while at is not None:
            fixed.add(at)
            if (q - self.rest[at]) @ direction < 1e-6:
                return path
            step = self._next(at, q, fixed)
            if step is None or (step[0] != at and step[0] in fixed):
                # The line leaves the sheet here, or meets the lips of an older cut: go on behind them. Each such jump lands
                # farther along the line than the last, so the walk ends.
                skipped = max(skipped * 1.5, float((self.rest[at] - p) @ direction)) + 2e-5
                at = self._enter(p + skipped * direction, q, fixed) if skipped < length else None
                continue
            to, ends = step
            if to != at:
                path.append((at, to))
                fixed.add(to)
            if ends:
                return path
            at = to
        return path

    def _enter(self, p: Array, q: Array, fixed: set[int]) -> int | None:
        """The vertex where the walk from p towards q begins; None when the segment misses the sheet."""
        length = float(np.linalg.norm(q - p))
        triangle = self.locate(p)
        travelled = 0.0
        while triangle < 0:
            travelled += 1e-4
            if travelled >= length:
                return None
            triangle = self.locate(p + (q - p) * (travelled / length))
        return self._vertex_at(p + (q - p) * (travelled / max(length, 1e-12)), triangle, fixed)

    def _vertex_at(self, p: Array, triangle: int, fixed: set[int]) -> int:
        """A vertex at `p` inside `triangle`: an existing one nearby, one moved there, or a new one."""
        corners = self.triangles[triangle].tolist()
        local = self._local_size(triangle)
        order = sorted(corners, key=lambda v: float(np.linalg.norm(self.rest[v] - p)))
        for v in order:
            if np.linalg.norm(self.rest[v] - p) < SNAP * local:
                if self._immovable(v, fixed):
                    return v
                if self._move(v, p):
                    return v
        for i in range(3):
            a, b = corners[i], corners[(i + 1) % 3]
            u = self.rest[b] - self.rest[a]
            t = float((p - self.rest[a]) @ u / (u @ u))
            if abs(float(_cross(u, p - self.rest[a]))) / np.linalg.norm(u) < 0.2 * local:
                t = float(np.clip(t, 0.0, 1.0))
                return a if t < BLUNT else b if t > 1 - BLUNT else self._divide_edge(a, b, t)
        return self._divide_triangle(triangle, p)

    def _next(self, at: int, q: Array, fixed: set[int]) -> tuple[int, bool] | None:
        """From vertex `at` towards q: the next vertex on the line and whether the walk ends there; None at the sheet's border."""
        here = self.rest[at]
        d = q - here
        for t in sorted(self._fans[at]):
            corners = self.triangles[t].tolist()
            i = corners.index(at)
            b, c = corners[(i + 1) % 3], corners[(i + 2) % 3]
            rb, rc = self.rest[b] - here, self.rest[c] - here
            cb, cc = float(_cross(rb, d)), float(_cross(d, rc))
            tolerance = 1e-9 * float(np.linalg.norm(d))
            if cb < -tolerance or cc < -tolerance or d @ (rb + rc) <= 0:
                continue
            along = rc - rb
            reach = float(_cross(rb, along)) / max(float(_cross(d, along)), 1e-18)
            if reach > 1.0:
                return self._finish(at, q, t, fixed)
            share = float(np.clip(cb / max(cb + cc, 1e-18), 0.0, 1.0))
            return self._cross_edge(b, c, share, here + reach * d, fixed), False
        return None

    def _finish(self, at: int, q: Array, triangle: int, fixed: set[int]) -> tuple[int, bool]:
        """The last stretch ends inside `triangle`."""
        if np.linalg.norm(q - self.rest[at]) < 0.35 * self._local_size(triangle):
            return at, True
        end = self._vertex_at(q, triangle, fixed)
        return end, True

    def _cross_edge(self, b: int, c: int, share: float, point: Array, fixed: set[int]) -> int:
        """A vertex where the line crosses the edge b-c at `point`, the fraction `share` from b."""
        for v, nearness in sorted(((b, share), (c, 1.0 - share)), key=lambda pair: pair[1]):
            immovable = self._immovable(v, fixed)
            if nearness < BLUNT and immovable:
                return v
            if nearness <= 0.5 and not immovable and self._move(v, point):
                return v
        share = float(np.clip(share, 0.05, 0.95))
        if min(share, 1.0 - share) * np.linalg.norm(self.rest[c] - self.rest[b]) < SHORTEST:
            return b if share < 0.5 else c
        return self._divide_edge(b, c, share)

    def _immovable(self, v: int, fixed: set[int]) -> bool:
        """Vertices on the line so far, on the border and on lips stay where they are."""
        return v in fixed or self._on_border(v)

    def _on_border(self, v: int) -> bool:
        seen: dict[int, int] = {}
        for t in self._fans[v]:
            for u in self.triangles[t].tolist():
                if u != v:
                    seen[u] = seen.get(u, 0) + 1
        return any(n == 1 for n in seen.values())

    def _local_size(self, triangle: int) -> float:
        r = self.rest[self.triangles[triangle]]
        return float(np.linalg.norm(r - np.roll(r, 1, axis=0), axis=1).mean())

    # ------------------------------------------------------------ editing

    def _move(self, v: int, p: Array) -> bool:
        """Move vertex v to p, carrying its values by interpolation, unless a triangle would be squashed."""
        fan = sorted(self._fans[v])
        corners = self.triangles[fan]
        moved = self.rest[corners]
        moved[corners == v] = p
        if _quality(moved).min() < QUALITY:
            return False
        # The value at p is read from the triangle of the fan that holds p, before the move.
        for t in fan:
            weights = _barycentric(self.rest[self.triangles[t]], p)
            if weights.min() >= -1e-9:
                self._carried[v] = weights @ self._carried[self.triangles[t]]
                self.rest[v] = p
                return True
        return False

    def _add_vertex(self, p: Array, values: Array, source: int) -> int:
        self.rest = np.vstack([self.rest, p])
        self._carried = np.vstack([self._carried, values])
        self._source.append(source)
        self._fans.append(set())
        return len(self.rest) - 1

    def _add_triangle(self, corners: list[int]) -> int:
        self.triangles = np.vstack([self.triangles, np.array(corners, np.int32)])
        t = len(self.triangles) - 1
        for v in corners:
            self._fans[v].add(t)
        return t

    def _set_triangle(self, t: int, corners: list[int]) -> None:
        for v in self.triangles[t].tolist():
            self._fans[v].discard(t)
        self.triangles[t] = corners
        for v in corners:
            self._fans[v].add(t)

    def _divide_edge(self, a: int, b: int, share: float) -> int:
        values = (1 - share) * self._carried[a] + share * self._carried[b]
        m = self._add_vertex((1 - share) * self.rest[a] + share * self.rest[b], values, a if share < 0.5 else b)
        for t in sorted(self._fans[a] & self._fans[b]):
            corners = self.triangles[t].tolist()
            self._set_triangle(t, [m if v == b else v for v in corners])
            self._add_triangle([m if v == a else v for v in corners])
        return m

    def _divide_triangle(self, t: int, p: Array) -> int:
        a, b, c = self.triangles[t].tolist()
        weights = _barycentric(self.rest[[a, b, c]], p)
        m = self._add_vertex(p, weights @ self._carried[[a, b, c]], [a, b, c][int(np.argmax(weights))])
        self._set_triangle(t, [a, b, m])
        self._add_triangle([b, c, m])
        self._add_triangle([c, a, m])
        return m

    # ------------------------------------------------------------ opening

    def _openable(self, path: list[tuple[int, int]]) -> list[tuple[int, int]]:
        """Edges of the path that still join two triangles; a slit of one inner edge gets a vertex in its middle, or it could not open."""
        inner = [(a, b) for a, b in dict.fromkeys(path) if len(self._fans[a] & self._fans[b]) == 2]
        if len(inner) == 1 and not self._on_border(inner[0][0]) and not self._on_border(inner[0][1]):
            a, b = inner[0]
            m = self._divide_edge(a, b, 0.5)
            return [(a, m), (m, b)]
        return inner

    def _open(self, path: list[tuple[int, int]], damage: float, torn: bool) -> None:
        cut = {frozenset(pair) for pair in path}
        edges = []
        for a, b in path:
            edge = CutEdge(_point(self.rest[a]), _point(self.rest[b]), damage, torn)
            left, right = sorted(self._fans[a] & self._fans[b])
            edges.append((edge, a, b, left, right))
        corners_before = {t: self.triangles[t].tolist() for _, _, _, left, right in edges for t in (left, right)}
        for v in dict.fromkeys(v for pair in path for v in pair):
            self._divide_vertex(v, cut)
        for edge, a, b, left, right in edges:
            self.cut_edges.append(edge)
            for v in (a, b):
                sides = [int(self.triangles[t][corners_before[t].index(v)]) for t in (left, right)]
                if damage >= 1.0:
                    self._lips.update(sides)
                elif sides[0] != sides[1]:
                    self.seams.append(Seam(sides[0], sides[1], edge.length / 2, damage, edge))

    def _divide_vertex(self, v: int, cut: set[frozenset[int]]) -> None:
        """Give every connected fan of triangles around v a copy of its own."""
        fan = sorted(self._fans[v])
        across: dict[int, list[int]] = {}
        for t in fan:
            for u in self.triangles[t].tolist():
                if u != v:
                    across.setdefault(u, []).append(t)
        group = {t: t for t in fan}

        def root(t: int) -> int:
            while group[t] != t:
                t = group[t]
            return t

        for u, pair in across.items():
            if len(pair) == 2 and frozenset((v, u)) not in cut:
                r0, r1 = root(pair[0]), root(pair[1])
                group[max(r0, r1)] = min(r0, r1)
        roots = sorted({root(t) for t in fan})
        for r in roots[1:]:
            copy = self._add_vertex(self.rest[v].copy(), self._carried[v].copy(), v)
            for t in fan:
                if root(t) == r:
                    self._set_triangle(t, [copy if u == v else u for u in self.triangles[t].tolist()])

    def _worsen_seams(self, line: Array, damage: float) -> None:
        """A cut that runs along seams severs more of what they still hold."""
        if not self.seams:
            return
        at = np.array([self.rest[s.a] for s in self.seams])
        for i in np.flatnonzero(distance_to_line(at, line) < SEAM_REACH).tolist():
            left = (1.0 - self.seams[i].damage) * (1.0 - damage)
            self._damage_seam(i, 1.0 - left if left > 0.02 else 1.0)

    def tear_seam(self, index: int) -> None:
        """What seam `index` still held has torn."""
        self._damage_seam(index, 1.0)
        self.seams[index].edge.torn = True

    def _damage_seam(self, index: int, damage: float) -> None:
        """An edge is as damaged as the better held of its ends."""
        seam = self.seams[index]
        seam.damage = damage
        seam.edge.damage = min(s.damage for s in self.seams if s.edge is seam.edge)
        if damage >= 1.0:
            self._lips.update((seam.a, seam.b))


def _cross(a: Array, b: Array) -> Array:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _point(p: Array) -> tuple[float, float]:
    return (float(p[0]), float(p[1]))


def _barycentric(corners: Array, p: Array) -> Array:
    a, b, c = corners
    area = float(_cross(b - a, c - a))
    wb = float(_cross(p - a, c - a)) / area
    wc = float(_cross(b - a, p - a)) / area
    return np.array([1.0 - wb - wc, wb, wc])


def _quality(corners: Array) -> Array:
    """Shape (T,) of triangles (T, 3, 2): 1 equilateral, 0 flat, negative turned over."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    squares = ((b - a) ** 2).sum(-1) + ((c - b) ** 2).sum(-1) + ((a - c) ** 2).sum(-1)
    return np.asarray(2.0 * np.sqrt(3.0) * _cross(b - a, c - a) / squares)
