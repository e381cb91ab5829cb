"""Candidate segments s(c, theta) around the uncut edges (paper, Recovery Feedback Planning, the set S)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array
from skills.replan.room import on_outline
from skills.scene.segments import distances, touch
from skills.tracking.tracks import TrackedGoal


@dataclass(frozen=True)
class ReplanConfig:
    """Which cover, the paper's parameters, what keeps segments sensible, and limits of the search. Lengths in pixels."""

    cover: Literal["optimal", "greedy"] = "optimal"
    segment_length: float = 60.0  # ell, the longest cut that one command makes reliably
    reach: float = 12.0  # d_hat, of a candidate's centre from some uncut edge
    orientations: int = 6  # bins over [0, pi), the first along the goal
    centres_per_edge: int = 12  # accepted by rejection sampling
    max_draws: int = 40  # per edge, accepted or not
    trim: bool = True  # cut no further than the edges covered plus the margin; False keeps the paper's fixed length
    margin: float = 10.0  # past the outermost edges of a trimmed segment
    grasp_clearance: float = 20.0  # of a segment from the grasp, if it can be kept
    corridor: float = 8.0  # to either side of the goal: cutting there is not cutting outside the goal
    compare: bool = True  # count the greedy cover's segments too, which with many edges takes longer than the optimal cover
    # Limits of the optimal cover's search, counts and no clock, so that one case has one answer.
    max_rounds: int = 7  # of choosing edges that prove how many segments are needed
    max_candidates: int = 100_000  # in one round
    max_nodes: int = 2000  # of branch and bound in one integer programme

    def __post_init__(self) -> None:
        if self.cover not in ("optimal", "greedy"):
            raise ValueError(f"the cover must be optimal or greedy, not {self.cover}")
        if min(self.corridor, self.grasp_clearance) < 0 or min(self.max_rounds, self.max_candidates, self.max_nodes) < 1:
            raise ValueError("corridor and clearance must not be negative, and the limits of the search must be positive")
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
    outline: NDArray[np.bool_] | None,
    barred: Array,
) -> tuple[Candidates, NDArray[np.bool_]]:
    """Sample candidates of full length around uncut `edges` (E, 2, 2) pixels, and say which edges each cuts (S, E).

    They lie wholly inside the tissue `outline` (H, W) if given, and meet no `barred` edge (B, 2, 2).

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
    covers = touch(segments, edges)
    keep = covers.any(axis=1) & ~touch(segments, barred).any(axis=1)
    if outline is not None:
        keep &= _inside(segments, outline)
    clear = distances(tracked.grasp[None], segments)[0] >= config.grasp_clearance
    return Candidates(segments[keep], angle[keep], distance[keep], clear[keep]), covers[keep]


def _centres(edges: Array, config: ReplanConfig, rng: np.random.Generator) -> Array:
    """Centres (C, 2) within d_hat of the edges, and each edge's own middle, so that a short edge is never without one."""
    low, high = edges.min(axis=1) - config.reach, edges.max(axis=1) + config.reach
    draws = rng.uniform(low[:, None], high[:, None], size=(len(edges), config.max_draws, 2))
    along, offset = edges[:, 1] - edges[:, 0], draws - edges[:, None, 0]
    t = (offset * along[:, None]).sum(-1) / np.maximum((along**2).sum(-1), 1e-300)[:, None]
    near = np.linalg.norm(offset - np.clip(t, 0.0, 1.0)[..., None] * along[:, None], axis=-1) < config.reach
    near &= np.cumsum(near, axis=1) <= config.centres_per_edge
    return np.concatenate([edges.mean(axis=1), draws[near]])


def _inside(segments: Array, outline: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which segments (S,) lie on the outline (H, W) at every sampled point."""
    longest = float(np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1).max(initial=1.0))
    t = np.linspace(0.0, 1.0, int(np.ceil(longest / 2)) + 1)
    points = segments[:, None, 0] + t[None, :, None] * (segments[:, None, 1] - segments[:, None, 0])
    return np.asarray(on_outline(points, outline).all(axis=1))
