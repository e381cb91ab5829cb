"""The next goal: the fewest segments that sever every uncut edge, what each will sever, and in which order (paper, Algorithm 1)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.codes import Code
from hardware.interface import Array
from skills.estimate.graph import ConnectivityGraph, EdgeState
from skills.replan.candidates import ReplanConfig
from skills.replan.explain import cannot_reach, left_unseen, nothing_seen, reason, what_is_cut
from skills.replan.greedy import greedy_cuts
from skills.replan.near_goal import drawn_to_goal
from skills.replan.next_goal import NextGoal
from skills.replan.optimal import FewestCuts, fewest_cuts
from skills.replan.order import least_travel
from skills.replan.room import Room
from skills.scene.segments import meetings, span, touch
from skills.tracking.tracks import TrackedGoal

NOTHING = np.zeros((0, 2, 2))
NEAR_GRASP = " A segment passes close to the grasp."
PROVEN = " Fewer segments cannot do it."
UNPROVEN = " Fewer segments might do: the search ended without a proof."


def next_goal(
    graph: ConnectivityGraph,
    tracked: TrackedGoal,
    config: ReplanConfig | None = None,
    rng: np.random.Generator | None = None,
    outline: NDArray[np.bool_] | None = None,
    seen: NDArray[np.bool_] | None = None,
    goal_length: float | None = None,
) -> NextGoal:
    """Plan the segments that sever the uncut edges of `graph` on the image at the end of exposure.

    Args:
        graph: what is uncut; its `points` are those of the image that `tracked` belongs to.
        tracked: the goal and the grasp on that image.
        config: which cover, the paper's parameters, limits of the search.
        rng: draws the greedy cover's candidates; a generator of seed 0 if None.
        outline: (H, W) bool, the tissue with its openings filled; segments stay inside it.
        seen: (N,) bool, keypoints that are seen on that image; those with finite points if None. An unknown edge is planned for only
            where both its ends are seen; where they are not, segments keep off the place that the graph gives it, if any.
        goal_length: [m], of the goal, to say where segments lie; in percent of the goal if None.

    Returns:
        `Code.OK` with the segments in cutting order (none if nothing is uncut), or `Code.NO_CANDIDATE` with none if an edge
        cannot be reached by any allowed segment, or if only unknown edges that are not seen are left.
    """
    config = config or ReplanConfig()
    rng = rng or np.random.default_rng(0)
    placed: NDArray[np.bool_] = np.asarray(np.isfinite(graph.points).all(axis=1))
    ends_seen = (placed if seen is None else placed & seen)[graph.edges].all(axis=1)
    unseen = graph.uncut & (graph.state == EdgeState.UNKNOWN) & ~ends_seen
    uncut, left_out = np.flatnonzero(graph.uncut & ~unseen), int(unseen.sum())
    if not len(uncut):
        if left_out:
            return NextGoal(Code.NO_CANDIDATE, nothing_seen(left_out), NOTHING, (), left_out=left_out)
        return NextGoal(Code.OK, "Nothing is left to sever.", NOTHING, ())
    edges = graph.points[graph.edges[uncut]]
    if not np.isfinite(edges).all():
        message = "The place of an uncut edge is not known, so no segment can be planned."
        return NextGoal(Code.NO_CANDIDATE, message, NOTHING, (), left_out=left_out)
    hidden = graph.points[graph.edges[unseen]]
    barred = hidden[np.isfinite(hidden).all(axis=(1, 2))]
    cover = _greedy if config.cover == "greedy" else _optimal
    plan = cover(edges, tracked, config, rng, outline, barred)
    if not len(plan.segments):
        return NextGoal(Code.NO_CANDIDATE, plan.note + left_unseen(left_out), NOTHING, (), left_out=left_out)
    order, turned = least_travel(plan.segments, tracked)
    segments = np.where(turned[:, None, None], plan.segments[order][:, ::-1], plan.segments[order])
    severs = [uncut[plan.severs[k]] for k in order]
    return NextGoal(
        code=Code.OK,
        message=what_is_cut(graph, uncut, len(segments)) + plan.note + left_unseen(left_out),
        segments=segments,
        severs=tuple(tuple(int(e) for e in cut) for cut in severs),
        reasons=tuple(reason(graph, cut, goal_length) for cut in severs),
        proven=plan.proven,
        greedy_segments=plan.greedy_segments,
        left_out=left_out,
    )


@dataclass(frozen=True)
class Planned:
    """`segments` (S, 2, 2) pixels in no order, the edges (indices) that each is there for, and what is to be said about them."""

    segments: Array
    severs: tuple[NDArray[np.int64], ...]
    note: str
    proven: bool = False
    greedy_segments: int | None = None


def _greedy(
    edges: Array,
    tracked: TrackedGoal,
    config: ReplanConfig,
    rng: np.random.Generator,
    outline: NDArray[np.bool_] | None,
    barred: Array,
) -> Planned:
    """Algorithm 1, trimmed."""
    greedy = greedy_cuts(edges, tracked, config, rng, outline, barred)
    if greedy.missing:
        return Planned(NOTHING, (), cannot_reach(greedy.missing, len(edges)))
    segments = greedy.segments
    if config.trim:
        cuts = zip(segments, greedy.first, strict=True)
        segments = np.stack([_trimmed(segment, edges[first], config.margin) for segment, first in cuts])
    return Planned(segments, greedy.first, NEAR_GRASP * greedy.near_grasp, greedy_segments=len(segments))


def _optimal(
    edges: Array,
    tracked: TrackedGoal,
    config: ReplanConfig,
    rng: np.random.Generator,
    outline: NDArray[np.bool_] | None,
    barred: Array,
) -> Planned:
    """The fewest segments, each drawn to the goal and trimmed; clear of the grasp if that reaches every edge."""
    room = Room(outline, tracked.grasp, config.grasp_clearance, barred)
    fewest = fewest_cuts(edges, tracked, config, room)
    near_grasp = bool(fewest.missing)
    if near_grasp:
        room = replace(room, clearance=0.0)
        fewest = fewest_cuts(edges, tracked, config, room)
    if fewest.missing:
        return Planned(NOTHING, (), cannot_reach(fewest.missing, len(edges)))
    greedy = None
    if config.compare or not fewest.proven:
        greedy = greedy_cuts(edges, tracked, config, rng, outline, barred)
        if not greedy.missing and len(greedy.segments) < len(fewest.segments) and greedy.near_grasp <= near_grasp:
            fewest = replace(fewest, segments=greedy.segments, covers=touch(greedy.segments, edges))
    severs = _shared_out(fewest, edges)
    segments, severs = fewest.segments[[len(cut) > 0 for cut in severs]], [cut for cut in severs if len(cut)]
    if config.trim:
        drawn = drawn_to_goal(segments, severs, edges, tracked.polyline, room)
        segments = np.stack([_fitted(s, edges[cut], config, room) for s, cut in zip(drawn, severs, strict=True)])
    note = NEAR_GRASP * near_grasp + (PROVEN if fewest.proven else UNPROVEN)
    taken = None if greedy is None or greedy.missing else len(greedy.segments)
    return Planned(segments, tuple(severs), note, fewest.proven, taken)


def _shared_out(fewest: FewestCuts, edges: Array) -> list[NDArray[np.int64]]:
    """Give each edge to one segment that cuts it: to the only one, or to the one whose cut gets least longer by it."""
    steps = fewest.segments[:, 1] - fewest.segments[:, 0]
    directions = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    where, _ = meetings(fewest.segments[:, 0], directions, edges)
    owner = np.where(fewest.covers.sum(axis=0) == 1, np.argmax(fewest.covers, axis=0), -1)
    low, high = (
        np.array([reduce(where[k, owner == k], initial=far) for k in range(len(steps))])
        for reduce, far in ((np.min, np.inf), (np.max, -np.inf))
    )
    for edge in np.flatnonzero(owner < 0):
        cutters = np.flatnonzero(fewest.covers[:, edge])
        at = where[cutters, edge]
        longer = np.where(np.isfinite(low[cutters]), np.maximum(np.maximum(low[cutters] - at, at - high[cutters]), 0.0), np.inf)
        best = int(np.argmin(longer))
        k = cutters[best]
        owner[edge], low[k], high[k] = k, min(low[k], at[best]), max(high[k], at[best])
    return [np.flatnonzero(owner == k) for k in range(len(steps))]


def _fitted(segment: Array, edges: Array, config: ReplanConfig, room: Room) -> Array:
    """Shorten `segment` (2, 2) to the stretch that meets `edges` (K, 2, 2), and as much of the margin as there is room for."""
    core = _trimmed(segment, edges, 0.0)
    step = segment[1] - segment[0]
    direction = step / float(np.linalg.norm(step))
    spare = max(0.0, min(config.margin, (config.segment_length - float(np.linalg.norm(core[1] - core[0]))) / 2))
    before, after = room.reach(core[0], -direction, spare), room.reach(core[1], direction, spare)
    return np.stack([core[0] - before * direction, core[1] + after * direction])


def _trimmed(segment: Array, edges: Array, margin: float) -> Array:
    """Shorten `segment` (2, 2) to the stretch that meets `edges` (K, 2, 2) plus the `margin` [px] at either end."""
    low, high = span(segment, edges)
    share = margin / float(np.linalg.norm(segment[1] - segment[0]))
    ends = np.clip([low - share, high + share], 0.0, 1.0)
    return np.asarray(segment[0] + ends[:, None] * (segment[1] - segment[0]))
