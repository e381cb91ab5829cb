"""Candidate segments s(c, theta) around the uncut edges (paper, Recovery Feedback Planning, the set S)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array
from skills.scene.polyline import arc_lengths
from skills.scene.segments import distances, touch
from skills.tracking.tracks import TrackedGoal


@dataclass(frozen=True)
class ReplanConfig:
    """The paper's parameters, and what keeps segments sensible. Lengths in pixels."""

    segment_length: float = 60.0  # ell, the longest cut that one command makes reliably
    reach: float = 12.0  # d_hat, of a candidate's centre from some uncut edge
    orientations: int = 6  # bins over [0, pi), the first along the goal
    centres_per_edge: int = 12  # accepted by rejection sampling
    max_draws: int = 40  # per edge, accepted or not
    trim: bool = True  # cut no further than the edges covered plus the margin; False keeps the paper's fixed length
    margin: float = 10.0  # past the outermost edges of a trimmed segment
    grasp_clearance: float = 20.0  # of a segment from the grasp, if it can be kept

    def __post_init__(self) -> None:
        if not (self.segment_length > 0 and self.reach > 0 and self.margin >= 0):
            raise ValueError("segment length and reach must be positive, the margin not negative")
        if min(self.orientations, self.centres_per_edge) < 1 or self.max_draws < self.centres_per_edge:
            raise ValueError("at least one orientation and one centre are needed, and as many draws as centres")


@dataclass(frozen=True)
class Candidates:
    """`segments` (S, 2, 2) pixels; `angle` (S,) [rad] to the goal, 0..pi/2; `distance` (S,) [px] of the centre to its line."""

    segments: Array
    angle: Array
    distance: Array
    clear_of_grasp: NDArray[np.bool_]


def candidates_around(
    edges: Array,
    tracked: TrackedGoal,
    config: ReplanConfig,
    rng: np.random.Generator,
    outline: NDArray[np.bool_] | None = None,
) -> Candidates:
    """Sample candidates of full length around uncut `edges` (E, 2, 2) pixels, wholly inside the tissue `outline` (H, W) if given.

    Centres come by rejection: drawn in the box around each edge in turn, so that far-apart edges are served alike, and kept if
    nearer than d_hat to that edge. Orientation bins are counted from the goal's direction at its point nearest to the centre.
    """
    centres = _centres(edges, config, rng)
    line = np.stack([tracked.polyline[:-1], tracked.polyline[1:]], axis=1)
    away = distances(centres, line)
    steps = (line[:, 1] - line[:, 0])[np.argmin(away, axis=1)]
    goal_angle = np.arctan2(steps[:, 1], steps[:, 0])
    bins = np.pi * np.arange(config.orientations) / config.orientations
    theta = goal_angle[:, None] + bins[None]
    half = config.segment_length / 2 * np.stack([np.cos(theta), np.sin(theta)], axis=-1)
    segments = np.stack([centres[:, None] - half, centres[:, None] + half], axis=2).reshape(-1, 2, 2)
    angle = np.tile(np.minimum(bins, np.pi - bins), len(centres))
    distance = np.repeat(away.min(axis=1), config.orientations)
    keep = touch(segments, edges).any(axis=1)
    if outline is not None:
        keep &= _inside(segments, outline)
    clear = distances(tracked.grasp[None], segments)[0] >= config.grasp_clearance
    return Candidates(segments[keep], angle[keep], distance[keep], clear[keep])


def order_along(segments: Array, tracked: TrackedGoal) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Order `segments` (S, 2, 2) along the goal; also say which (S,) of the ordered ones to turn round for the least travel."""
    lengths = arc_lengths(tracked.polyline)
    line = np.stack([tracked.polyline[:-1], tracked.polyline[1:]], axis=1)
    middles = segments.mean(axis=1)
    piece = np.argmin(distances(middles, line), axis=1)
    start, along = line[piece, 0], line[piece, 1] - line[piece, 0]
    t = np.clip(((middles - start) * along).sum(1) / np.maximum((along**2).sum(1), 1e-12), 0.0, 1.0)
    order = np.argsort(lengths[piece] + t * np.linalg.norm(along, axis=1), kind="stable")
    ordered = segments[order]
    # Dynamic programming over the two ways to cut each segment; ties fall to the goal's own direction.
    forwards = ((ordered[:, 1] - ordered[:, 0]) * along[order]).sum(1) >= 0
    ways = np.stack([ordered, ordered[:, ::-1]], axis=1)
    cost = np.where(np.column_stack([forwards, ~forwards]), 0.0, 1e-6)
    came: list[NDArray[np.int64]] = []
    total = cost[0]
    for k in range(1, len(ordered)):
        travel = np.linalg.norm(ways[k][None, :, 0] - ways[k - 1][:, None, 1], axis=-1)
        sums = total[:, None] + travel
        came.append(np.argmin(sums, axis=0))
        total = sums.min(axis=0) + cost[k]
    turned = [int(np.argmin(total))]
    for back in reversed(came):
        turned.append(int(back[turned[-1]]))
    return order, np.array(turned[::-1], dtype=bool)


def _centres(edges: Array, config: ReplanConfig, rng: np.random.Generator) -> Array:
    """Centres (C, 2) within d_hat of the edges, and each edge's own middle, so that a short edge is never without one."""
    low, high = edges.min(axis=1) - config.reach, edges.max(axis=1) + config.reach
    kept = [edges.mean(axis=1)]
    for k, edge in enumerate(edges):
        draws = rng.uniform(low[k], high[k], size=(config.max_draws, 2))
        near = distances(draws, edge[None])[:, 0] < config.reach
        kept.append(draws[near][: config.centres_per_edge])
    return np.concatenate(kept)


def _inside(segments: Array, outline: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which segments (S,) lie on the outline (H, W) at every sampled point."""
    longest = float(np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).max(initial=1.0))
    t = np.linspace(0.0, 1.0, int(np.ceil(longest / 2)) + 1)
    at = np.rint(segments[:, None, 0] + t[None, :, None] * (segments[:, None, 1] - segments[:, None, 0])).astype(np.int64)
    height, width = outline.shape
    within = (at >= 0).all(axis=-1) & (at[..., 0] < width) & (at[..., 1] < height)
    on = outline[np.clip(at[..., 1], 0, height - 1), np.clip(at[..., 0], 0, width - 1)]
    return np.asarray((within & on).all(axis=1))
