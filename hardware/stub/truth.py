"""What really happened to the tissue, read from the mesh: only experiments and tests may ask.

The cut network is a graph in rest coordinates; union-find over its fully severed edges gives its connected cuts. Tissue bridges the goal
wherever one connected cut ends and the next begins: these gaps are the attachments.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hardware.interface import Array
from hardware.stub.cutting import CutEdge
from hardware.stub.phantom import Phantom
from hardware.stub.scene import Scene
from hardware.stub.topology import components

CORRIDOR = 3e-3  # [m]: a cut farther than this from the goal does not count as executing it
JOINED = 0.3e-3  # [m]: a third of the finest mesh edge; a sliver thinner than this between two cuts holds nothing


@dataclass(frozen=True)
class Truth:
    """Lengths [m]. `attachments` counts strands that bridge the goal between its severed stretches (1 if nothing is severed).

    `severed_length` is the part of the goal's line, ends extended, along which a connected cut runs within the corridor;
    `length_deviation` its difference from the goal's length; `effective_cut_ratio` the severed share of the goal;
    `excessive_cut_ratio` the length cut elsewhere (or over again) over the goal's. `pieces` are the connected pieces of the sheet.
    """

    attachments: int
    attachment_stretches: tuple[tuple[float, float], ...]
    severed_length: float
    length_deviation: float
    effective_cut_ratio: float
    excessive_cut_ratio: float
    pieces: int
    tears: int
    bed_contact: float

    @property
    def success(self) -> bool:
        """The paper's criterion: length deviation under 2 mm and no attachment."""
        return self.length_deviation < 2e-3 and self.attachments == 0


def measure(phantom: Phantom) -> Truth:
    """The truth about the tissue as it is now."""
    goal = GoalLine(phantom.scene)
    full = [edge for edge in phantom.mesh.cut_edges if edge.damage >= 1.0]
    cuts = [cut for cut in (_interval(goal, group) for group in _neighbouring(_connected(full))) if cut is not None]
    bridges = _bridges(cuts, goal.length)
    covered = _union(cuts)
    inside = sum(max(0.0, min(b, goal.length) - max(a, 0.0)) for a, b in covered)
    severed = sum(b - a for a, b in covered)
    cut_by_blades = sum(edge.length for edge in full if not edge.torn)
    return Truth(
        attachments=len(bridges),
        attachment_stretches=tuple(bridges),
        severed_length=severed,
        length_deviation=abs(goal.length - severed),
        effective_cut_ratio=min(1.0, inside / goal.length),
        excessive_cut_ratio=max(0.0, cut_by_blades - inside) / goal.length,
        pieces=pieces(phantom),
        tears=phantom.tears,
        bed_contact=phantom.bed_contact,
    )


def pieces(phantom: Phantom) -> int:
    """Connected pieces of the sheet: union-find over triangles that share an edge or hang together by a seam."""
    triangles = phantom.mesh.triangles
    pairs = phantom.topology.edge_triangles
    links = pairs[(pairs >= 0).all(axis=1)]
    owner = {int(v): t for t, corners in enumerate(triangles.tolist()) for v in corners}
    seams = [(owner[s.a], owner[s.b]) for s in phantom.mesh.seams if s.damage < 1.0]
    joined = np.vstack([links, np.array(seams, dtype=np.int32).reshape(-1, 2)])
    return len(set(components(len(triangles), joined).tolist()))


def severed_between(phantom: Phantom, a: Array, b: Array) -> NDArray[np.bool_]:
    """(N,) whether the material segment from rest point a[i] to b[i] (N, 2) crosses a fully severed edge."""
    full = [edge for edge in phantom.mesh.cut_edges if edge.damage >= 1.0]
    if not full:
        return np.zeros(len(a), dtype=bool)
    p = np.array([edge.a for edge in full])
    q = np.array([edge.b for edge in full])

    def side(u: Array, v: Array, w: Array) -> Array:
        return np.asarray((v[..., 0] - u[..., 0]) * (w[..., 1] - u[..., 1]) - (v[..., 1] - u[..., 1]) * (w[..., 0] - u[..., 0]))

    a1, b1 = np.asarray(a)[:, None], np.asarray(b)[:, None]
    crosses = (side(a1, b1, p) * side(a1, b1, q) <= 0) & (side(p, q, a1) * side(p, q, b1) <= 0)
    return np.asarray(crosses.any(axis=1))


class GoalLine:
    """The goal's line in rest coordinates, its ends extended straight, as a coordinate along and a distance across."""

    def __init__(self, scene: Scene) -> None:
        line = scene.line
        self.length = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
        reach = 10e-3
        first = line[0] + (line[0] - line[1]) / np.linalg.norm(line[0] - line[1]) * reach
        last = line[-1] + (line[-1] - line[-2]) / np.linalg.norm(line[-1] - line[-2]) * reach
        self._points = np.vstack([first, line, last])
        self._start = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self._points, axis=0), axis=1))]) - reach

    def along_across(self, points: Array) -> tuple[Array, Array]:
        """Arc length (N,) [m] from the goal's start, and distance (N,) [m] from the line, of rest points (N, 2)."""
        a, b = self._points[:-1], self._points[1:]
        u = b - a
        relative = points[:, None] - a[None]
        t = np.clip((relative * u).sum(-1) / (u * u).sum(-1), 0.0, 1.0)
        gap = np.linalg.norm(relative - t[..., None] * u, axis=-1)
        best = gap.argmin(axis=1)
        rows = np.arange(len(points))
        return self._start[best] + t[rows, best] * np.linalg.norm(u[best], axis=1), gap[rows, best]


def _connected(edges: list[CutEdge]) -> list[list[CutEdge]]:
    """Groups of edges that hang together: union-find over shared ends."""
    ends: dict[tuple[float, float], int] = {}
    pairs = [(ends.setdefault(edge.a, len(ends)), ends.setdefault(edge.b, len(ends))) for edge in edges]
    group = components(len(ends), np.array(pairs, dtype=np.int32).reshape(-1, 2))
    gathered: dict[int, list[CutEdge]] = {}
    for edge, (a, _) in zip(edges, pairs, strict=True):
        gathered.setdefault(int(group[a]), []).append(edge)
    return list(gathered.values())


def _neighbouring(groups: list[list[CutEdge]]) -> list[list[CutEdge]]:
    """Connected cuts that come within `JOINED` of each other count as one."""
    spots = [np.array([_spot(edge, t) for edge in group for t in (0.0, 0.25, 0.5, 0.75, 1.0)]) for group in groups]
    trees = [cKDTree(spot) for spot in spots]
    pairs = [
        (i, j)
        for i in range(len(groups))
        for j in range(i)
        if trees[j].query(spots[i], distance_upper_bound=JOINED)[0].min() < JOINED
    ]
    merged: dict[int, list[CutEdge]] = {}
    for label, group in zip(components(len(groups), np.array(pairs, dtype=np.int32).reshape(-1, 2)), groups, strict=True):
        merged.setdefault(int(label), []).extend(group)
    return list(merged.values())


def _spot(edge: CutEdge, t: float) -> tuple[float, float]:
    return (edge.a[0] + t * (edge.b[0] - edge.a[0]), edge.a[1] + t * (edge.b[1] - edge.a[1]))


def _interval(goal: GoalLine, edges: list[CutEdge]) -> tuple[float, float] | None:
    """The stretch of the goal along which these joined edges run within the corridor."""
    points = np.array([p for edge in edges for p in (edge.a, edge.b)])
    along, across = goal.along_across(points)
    inside = across <= CORRIDOR
    if not inside.any():
        return None
    low, high = float(along[inside].min()), float(along[inside].max())
    return (low, high) if high - low > JOINED else None


def _union(intervals: list[tuple[float, float]]) -> list[tuple[float, float]]:
    merged: list[tuple[float, float]] = []
    for low, high in sorted(intervals):
        if merged and low <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(merged[-1][1], high))
        else:
            merged.append((low, high))
    return merged


def _bridges(cuts: list[tuple[float, float]], length: float) -> list[tuple[float, float]]:
    """Where tissue bridges the goal: going along it on connected cuts, each change from one cut to the next crosses a strand.

    Cuts that overlap side by side without meeting leave a strand between them too, and count. At the goal's own ends the tissue is whole
    by design: a cut too short there is a length deviation, not an attachment.
    """
    reachable = [cut for cut in cuts if cut[1] > 0.0 and cut[0] < length]
    if not reachable:
        return [(0.0, length)]
    bridges: list[tuple[float, float]] = []
    here = min(reachable)
    # The fewest changes: from each cut, go on to the one that begins before this one ends and reaches farthest.
    here = max((cut for cut in reachable if cut[0] <= max(here[0], 0.0)), key=lambda cut: cut[1])
    while True:
        overlapping = [cut for cut in reachable if cut[0] <= here[1] and cut[1] > here[1]]
        ahead = overlapping or [cut for cut in reachable if cut[0] > here[1]]
        if not ahead or here[1] >= length:
            return bridges
        onward = max(overlapping, key=lambda cut: cut[1]) if overlapping else min(ahead)
        bridges.append((min(here[1], onward[0]), max(here[1], onward[0])))
        here = onward
