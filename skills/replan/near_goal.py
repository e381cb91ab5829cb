"""Segments that stay near the goal, how far others leave it, and how to draw them back to it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hardware.interface import Array
from skills.replan.candidates import ReplanConfig
from skills.replan.order import along_goal
from skills.replan.room import Room
from skills.scene.polyline import arc_lengths, at_length, resample
from skills.scene.segments import distances, span, touch
from skills.tracking.tracks import TrackedGoal

# What decides between covers of equally many segments: cutting outside the goal, angle to it, nearness to the grasp and to the base.
TIE_WEIGHTS = np.array([1.0, 0.1, 0.01, 0.01])
LOOKS = 9  # points of a segment or an edge that are compared with the goal
APART = 3.0  # [px] along the goal between edges that begin a chord
SHARES = np.linspace(1.0, 0.0, 11)  # of the way back to the goal


def goal_chords(edges: Array, polyline: Array, length: float) -> Array:
    """Segments (S, 2, 2) of full `length` along chords of the goal from `edges` (E, 2, 2), both ways, and one about each edge.

    Where edges lie close, not each of them begins a chord.
    """
    at = _nearest_to(polyline, edges)
    place, direction = along_goal(at, polyline)
    order = np.argsort(place, kind="stable")
    at, direction = at[order], direction[order]
    centred = np.stack([at - length / 2 * direction, at + length / 2 * direction], axis=1)
    apart = np.unique(np.floor(place[order] / APART), return_index=True)[1]
    start, along = at[apart], direction[apart]
    within = np.hypot(start[:, :1] - at[:, 0], start[:, 1:] - at[:, 1]) <= length
    last = len(at) - 1 - np.argmax(within[:, ::-1], axis=1)
    first = np.argmax(within, axis=1)
    ways = ((at[last], along), (at[first], -along))
    return np.concatenate([*(_from(start, end, otherwise, length) for end, otherwise in ways), centred])


def tie_costs(segments: Array, covers: NDArray[np.bool_], edges: Array, tracked: TrackedGoal, config: ReplanConfig) -> Array:
    """What speaks against each of `segments` (S, 2, 2), 0..1 (S,): `TIE_WEIGHTS` of it, between the first and the last edge it cuts."""
    steps = segments[:, 1] - segments[:, 0]
    directions = steps / np.maximum(_norm(steps)[:, None], 1e-12)
    begin, end = _stretch(segments, directions, covers, edges)
    where = begin[:, None] + (end - begin)[:, None] * np.linspace(0.0, 1.0, LOOKS)
    points = segments[:, None, 0] + where[..., None] * directions[:, None]
    line, tangents = _fine(tracked.polyline)
    away, nearest = cKDTree(line).query(points.reshape(-1, 2))
    off = (away.reshape(len(segments), LOOKS) > config.corridor).mean(axis=1) * (end - begin) / config.segment_length
    middle = points[:, LOOKS // 2]
    cosine = np.abs((directions * tangents[nearest.reshape(len(segments), LOOKS)[:, LOOKS // 2]]).sum(axis=1))
    angle = np.arccos(np.clip(cosine, 0.0, 1.0)) / (np.pi / 2)
    base = np.stack([tracked.far[:-1], tracked.far[1:]], axis=1)
    near = [1.0 / (1.0 + d / config.segment_length) for d in (_norm(middle - tracked.grasp), distances(middle, base).min(axis=1))]
    return np.asarray(np.nan_to_num(np.column_stack([off, angle, *near]), nan=1.0) @ (TIE_WEIGHTS / TIE_WEIGHTS.sum()))


def drawn_to_goal(segments: Array, severs: list[NDArray[np.int64]], edges: Array, polyline: Array, room: Room) -> Array:
    """Bring each of `segments` (S, 2, 2) as near to the goal's own chord as it still cuts its own of `edges` (E, 2, 2) inside `room`.

    Both ends move on straight lines towards the goal, so a segment gets no longer than the longer of the two.
    """
    place, _ = along_goal(segments.reshape(-1, 2), polyline)
    step = at_length(polyline, place).reshape(segments.shape) - segments
    tries = segments[:, None] + SHARES[:, None, None] * step[:, None]
    cut = touch(tries.reshape(-1, 2, 2), edges).reshape(len(segments), len(SHARES), len(edges))
    drawn = segments.copy()
    for k, own in enumerate(severs):
        for near in tries[k, cut[k][:, own].all(axis=1)]:
            low, high = span(near, edges[own])
            if room.whole((near[0] + np.array([[low], [high]]) * (near[1] - near[0]))[None])[0]:
                drawn[k] = near
                break
    return drawn


def _stretch(segments: Array, directions: Array, covers: NDArray[np.bool_], edges: Array) -> tuple[Array, Array]:
    """Where (S,) [px] along `segments` the first and the last edge that each covers is met; zero where it covers none."""
    i, j = np.nonzero(covers)
    (u0, u1), (v0, v1) = (edges[j, :, axis].T - segments[i, 0, axis] for axis in (0, 1))
    du, dv = directions[i].T
    aside0, aside1, ahead0, ahead1 = du * v0 - dv * u0, du * v1 - dv * u1, du * u0 + dv * v0, du * u1 + dv * v1
    across = aside0 - aside1
    along = np.abs(across) < 1e-9
    where = ahead0 + np.clip(aside0 / np.where(along, 1.0, across), 0.0, 1.0) * (ahead1 - ahead0)
    low, high = np.where(along, np.minimum(ahead0, ahead1), where), np.where(along, np.maximum(ahead0, ahead1), where)
    begin, end = np.full(len(segments), np.inf), np.full(len(segments), -np.inf)
    np.minimum.at(begin, i, low)
    np.maximum.at(end, i, high)
    begin = np.clip(np.where(np.isfinite(begin), begin, 0.0), 0.0, None)
    return begin, np.minimum(np.maximum(end, begin), np.maximum(_norm(segments[:, 1] - segments[:, 0]), begin))


def _from(start: Array, end: Array, otherwise: Array, length: float) -> Array:
    """Segments of `length` from `start` (K, 2) towards `end` (K, 2), or along `otherwise` (K, 2) where these are one."""
    step = end - start
    norm = _norm(step)[:, None]
    direction = np.where(norm > 1e-6, step / np.maximum(norm, 1e-12), otherwise)
    return np.stack([start, start + length * direction], axis=1)


def _nearest_to(polyline: Array, edges: Array) -> Array:
    """Of some points along each of `edges` (E, 2, 2), the one nearest to the goal (E, 2)."""
    t = np.linspace(0.0, 1.0, LOOKS)
    points = edges[:, None, 0] + t[None, :, None] * (edges[:, None, 1] - edges[:, None, 0])
    away, _ = cKDTree(_fine(polyline)[0]).query(points.reshape(-1, 2))
    return np.asarray(points[np.arange(len(edges)), np.argmin(away.reshape(len(edges), LOOKS), axis=1)])


def _fine(polyline: Array) -> tuple[Array, Array]:
    """Points (N, 2) about a pixel apart along the goal, and the direction of the goal there (N, 2)."""
    points = resample(polyline, max(2, int(np.ceil(arc_lengths(polyline)[-1])) + 1))
    steps = np.gradient(points, axis=0)
    return points, steps / np.maximum(_norm(steps)[:, None], 1e-12)


def _norm(vectors: Array) -> Array:
    return np.asarray(np.linalg.norm(vectors, axis=-1))
