"""The next goal: fewest segments that sever every uncut edge, by greedy set cover (paper, Algorithm 1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hardware.codes import Code
from hardware.interface import Array
from skills.estimate.elongation import attachments
from skills.estimate.graph import ConnectivityGraph, EdgeState
from skills.replan.candidates import Candidates, ReplanConfig, candidates_around, order_along
from skills.replan.next_goal import NextGoal
from skills.scene.segments import span, touch
from skills.tracking.tracks import TrackedGoal


def next_goal(
    graph: ConnectivityGraph,
    tracked: TrackedGoal,
    config: ReplanConfig | None = None,
    rng: np.random.Generator | None = None,
    outline: NDArray[np.bool_] | None = None,
) -> NextGoal:
    """Plan the segments that sever every uncut edge of `graph`, unknown ones too, on the image at the end of exposure.

    Args:
        graph: what is uncut; its `points` are those of the image that `tracked` belongs to.
        tracked: the goal and the grasp on that image.
        config: the paper's parameters.
        rng: draws the candidates' centres; a generator of seed 0 if None.
        outline: (H, W) bool, the tissue with its openings filled; segments stay inside it.

    Returns:
        `Code.OK` with the segments in cutting order (none if nothing is uncut), or `Code.NO_CANDIDATE` with none if an edge
        cannot be reached by any allowed segment.
    """
    config = config or ReplanConfig()
    rng = rng or np.random.default_rng(0)
    uncut = np.flatnonzero(graph.uncut)
    nothing = np.zeros((0, 2, 2))
    if not len(uncut):
        return NextGoal(Code.OK, "Nothing is left to sever.", nothing, ())
    edges = graph.points[graph.edges[uncut]]
    if not np.isfinite(edges).all():
        return NextGoal(Code.NO_CANDIDATE, "The place of an uncut edge is not known, so no segment can be planned.", nothing, ())
    candidates = candidates_around(edges, tracked, config, rng, outline)
    covers = touch(candidates.segments, edges)
    missing = ~covers.any(axis=0)
    if missing.any():
        message = f"{int(missing.sum())} of {len(uncut)} uncut edges cannot be reached by a segment that stays on the tissue."
        return NextGoal(Code.NO_CANDIDATE, message, nothing, ())
    # Clear of the grasp if that still covers everything.
    clear = candidates.clear_of_grasp
    near_grasp = not covers[clear].any(axis=0).all()
    allowed = np.ones_like(clear) if near_grasp else clear
    chosen = greedy_cover(covers[allowed], _only(candidates, allowed))
    segments = candidates.segments[allowed][[k for k, _ in chosen]]
    if config.trim:
        segments = np.stack([_trimmed(s, edges[first], config) for s, (_, first) in zip(segments, chosen, strict=True)])
    order, turned = order_along(segments, tracked)
    ordered = segments[order]
    ordered[turned] = ordered[turned, ::-1]
    severs = tuple(tuple(int(e) for e in uncut[chosen[k][1]]) for k in order)
    return NextGoal(Code.OK, _message(graph, len(ordered), near_grasp), ordered, severs)


def greedy_cover(covers: NDArray[np.bool_], candidates: Candidates) -> list[tuple[int, NDArray[np.int64]]]:
    """Choose candidates until every column of `covers` (S, E) that any of them covers is covered (Algorithm 1).

    Each choice is a candidate's index and the edges that it is first to cover. The most newly covered edges win; then the
    smaller angle to the goal; then the nearer to the goal; then the lower index.
    """
    left: NDArray[np.bool_] = np.array(covers.any(axis=0))
    chosen: list[tuple[int, NDArray[np.int64]]] = []
    # Ranked once; the first best of equals is then the tie-break's choice.
    rank = np.lexsort([np.round(candidates.distance, 6), np.round(candidates.angle, 6)])
    while left.any():
        gain = (covers & left).sum(axis=1)
        best = int(rank[np.argmax(gain[rank])])
        first = np.flatnonzero(covers[best] & left)
        chosen.append((best, first))
        left[first] = False
    return chosen


def _only(candidates: Candidates, keep: NDArray[np.bool_]) -> Candidates:
    return Candidates(
        candidates.segments[keep], candidates.angle[keep], candidates.distance[keep], candidates.clear_of_grasp[keep]
    )


def _trimmed(segment: Array, edges: Array, config: ReplanConfig) -> Array:
    """Shorten `segment` (2, 2) to the stretch that meets `edges` (K, 2, 2) plus the margin at either end."""
    low, high = span(segment, edges)
    margin = config.margin / float(np.linalg.norm(segment[1] - segment[0]))
    ends = np.clip([low - margin, high + margin], 0.0, 1.0)
    return np.asarray(segment[0] + ends[:, None] * (segment[1] - segment[0]))


def _message(graph: ConnectivityGraph, cuts: int, near_grasp: bool) -> str:
    """Say what the segments will sever."""
    connected = int((graph.uncut & (graph.state == EdgeState.CONNECTED)).sum())
    unknown = int((graph.uncut & (graph.state == EdgeState.UNKNOWN)).sum())
    found = len(attachments(graph))
    parts = []
    if connected:
        parts.append(f"{found} attachment{'s' if found != 1 else ''} ({connected} connected edge{'s' if connected != 1 else ''})")
    if unknown:
        parts.append(f"{unknown} edge{'s' if unknown != 1 else ''} not seen well enough")
    near = " A segment passes close to the grasp." if near_grasp else ""
    return f"{cuts} segment{'s' if cuts != 1 else ''} to sever {' and '.join(parts)}.{near}"
