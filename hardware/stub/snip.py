"""What one closing of the scissors severs: the tissue that the blades really pass through.

The open blades span a wedge in the jaw plane. Where the deformed sheet passes through that wedge, the closing blades meet it. How much of
its thickness they sever there follows from how far the blades reach below it, less the dent that the sheet gives way by before it is
pierced: tough, slack, unsupported tissue dents most. While closing, the blades push slack tissue before them until it bunches up, so that
the ends of the stretch between them escape. Nothing is left to chance beyond the tissue's own toughness, which varies over the sheet.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array, Pose
from hardware.stub.phantom import Phantom
from hardware.stub.sheet_solver import bed_height

BLADE = 10e-3  # [m]
LEAST_DAMAGE = 0.05  # scratches shallower than this leave no mark
SAMPLE = 0.25e-3  # [m], between the points at which depth is evaluated along the sheet
DENT_STIFFNESS = 60.0  # [N/m], of an untensioned sheet under a blade tip: the bending and the air of the undermined plane
DENT_PER_TENSION = 4.0  # [N/m per N/m], of a membrane under tension (2 pi / ln(R/a), R/a about 5)
ESCAPE = 0.95e-3  # [m], that fully slack tissue of mean toughness escapes at either end of a closing jaw
ESCAPE_TENSION = 12.0  # [N/m], line tension at which half of that is left


@dataclass(frozen=True)
class BladeSweep:
    """The jaw closing from `opened` to `closed` (full angles [rad]) at `pose` (true tip pose, table frame)."""

    pose: Pose
    opened: float
    closed: float


def severed(phantom: Phantom, sweep: BladeSweep) -> list[tuple[Array, float]]:
    """Polylines (M, 2) in rest coordinates that `sweep` severs, each with its severed fraction of the thickness (0..1]."""
    stretches: list[tuple[Array, float]] = []
    for rest, local, x in _sections(phantom, sweep.pose):
        rest, local, x = _resampled(rest, local, x)
        damage = _damage(phantom, sweep, rest, local, x)
        stretches += _runs(rest, damage)
    return stretches


def bed_depth(phantom: Phantom, sweep: BladeSweep) -> float:
    """How far [m] the blade tips reach into the bed (0 if they do not): harm."""
    R = sweep.pose.rotation()
    half = sweep.opened / 2
    tips = np.array([[s * BLADE * np.sin(half), 0.0, BLADE * (np.cos(half) - 1.0)] for s in (-1, 1)]) @ R.T + sweep.pose.position
    return float(max(0.0, (bed_height(tips[:, :2], phantom.scene.bump) - tips[:, 2]).max()))


def _sections(phantom: Phantom, pose: Pose) -> list[tuple[Array, Array, Array]]:
    """Where the jaw plane cuts the deformed sheet: chains of points as (rest (M, 2), tool x-z (M, 2), position (M, 3))."""
    x, rest, triangles = phantom.positions, phantom.mesh.rest, phantom.mesh.triangles
    local = (x - pose.position) @ pose.rotation()
    near = np.linalg.norm(local + np.array([0.0, 0.0, BLADE / 2]), axis=1) < 1.5 * BLADE
    # A vertex exactly in the plane would give triangles three crossings; a nanometre to one side changes nothing else.
    side = np.where(np.abs(local[:, 1]) < 1e-9, 1e-9, local[:, 1])
    candidates = triangles[near[triangles].any(axis=1)]
    crossing = candidates[np.abs(np.sign(side[candidates]).sum(axis=1)) < 3]
    points: dict[tuple[int, int], int] = {}
    rows: list[Array] = []
    links: list[tuple[int, int]] = []
    values = np.column_stack([rest, local[:, [0, 2]], x])
    for corners in crossing.tolist():
        ends = []
        for i in range(3):
            a, b = sorted((corners[i], corners[(i + 1) % 3]))
            if side[a] * side[b] < 0:
                if (a, b) not in points:
                    t = side[a] / (side[a] - side[b])
                    points[(a, b)] = len(rows)
                    rows.append((1 - t) * values[a] + t * values[b])
                ends.append(points[(a, b)])
        links.append((ends[0], ends[1]))
    table = np.array(rows).reshape(-1, 7)
    return [(table[chain, :2], table[chain, 2:4], table[chain, 4:]) for chain in _chains(len(rows), links)]


def _chains(count: int, links: list[tuple[int, int]]) -> list[list[int]]:
    """Order linked points into chains; each point has one or two neighbours."""
    neighbours: list[list[int]] = [[] for _ in range(count)]
    for a, b in links:
        neighbours[a].append(b)
        neighbours[b].append(a)
    unseen = set(range(count))
    chains = []
    for start in [i for i in range(count) if len(neighbours[i]) == 1] + list(range(count)):
        if start not in unseen:
            continue
        chain, at = [start], start
        unseen.discard(start)
        while True:
            ahead = [n for n in neighbours[at] if n in unseen]
            if not ahead:
                break
            at = ahead[0]
            unseen.discard(at)
            chain.append(at)
        if len(chain) > 1:
            chains.append(chain)
    return chains


def _resampled(rest: Array, local: Array, x: Array) -> tuple[Array, Array, Array]:
    s = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(x, axis=0), axis=1))])
    at = np.linspace(0.0, s[-1], max(2, int(s[-1] / SAMPLE) + 1))

    def read(values: Array) -> Array:
        return np.column_stack([np.interp(at, s, values[:, i]) for i in range(values.shape[1])])

    return read(rest), read(local), read(x)


def _damage(phantom: Phantom, sweep: BladeSweep, rest: Array, local: Array, x: Array) -> Array:
    """Severed fraction (M,) of the thickness at points of one chain."""
    thickness = phantom.scene.tissue.thickness
    tension = phantom.line_tension(rest)
    along, reach = local[:, 0], local[:, 1] + BLADE
    radius = np.hypot(along, reach)
    angle = np.abs(np.arctan2(along, reach))
    toughness = phantom.toughness(rest)
    escape = ESCAPE * toughness / max(phantom.scene.tissue.puncture_force, 1e-9) / (1.0 + tension / ESCAPE_TENSION)
    met = (reach > 0) & (angle <= sweep.opened / 2 - escape / np.maximum(radius, 1e-6)) & (angle >= sweep.closed / 2)
    if sweep.closed < np.deg2rad(2.0):
        met |= (reach > 0) & (np.abs(along) < 1e-4)
    gap = np.maximum(x[:, 2] - thickness / 2 - bed_height(x[:, :2], phantom.scene.bump), 0.0)
    dent = toughness / (DENT_STIFFNESS + DENT_PER_TENSION * tension)
    depth = BLADE - radius - np.minimum(dent, gap)
    return np.where(met, np.clip(depth / thickness + 0.5, 0.0, 1.0), 0.0)


def _runs(rest: Array, damage: Array) -> list[tuple[Array, float]]:
    """Split a chain into stretches that are cut through and stretches that are only damaged."""
    level: NDArray[np.int64] = np.where(damage >= 0.98, 2, np.where(damage >= LEAST_DAMAGE, 1, 0))
    borders = np.flatnonzero(np.diff(level)) + 1
    runs = []
    for start, end in zip(np.concatenate([[0], borders]), np.concatenate([borders, [len(level)]]), strict=True):
        kind = level[start]
        if kind == 0 or end - start < 2:
            continue
        line = rest[start:end]
        runs.append((_simplified(line), 1.0 if kind == 2 else float(damage[start:end].mean())))
    return runs


def _simplified(line: Array) -> Array:
    """The polyline without points that lie within 0.1 mm of the straight line between its neighbours kept (Douglas-Peucker)."""
    first, last = line[0], line[-1]
    chord = last - first
    length = np.linalg.norm(chord)
    if len(line) < 3 or length < 1e-9:
        return np.stack([first, last])
    off = np.abs(chord[0] * (line[:, 1] - first[1]) - chord[1] * (line[:, 0] - first[0])) / length
    worst = int(np.argmax(off))
    if off[worst] < 1e-4:
        return np.stack([first, last])
    return np.vstack([_simplified(line[: worst + 1])[:-1], _simplified(line[worst:])])
