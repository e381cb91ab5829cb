"""What a corrective goal will sever and why, in words for the operator."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skills.estimate.graph import ConnectivityGraph, EdgeState
from skills.estimate.stretches import attachments


def what_is_cut(graph: ConnectivityGraph, planned: NDArray[np.int64], cuts: int) -> str:
    """Say how many segments sever which of the `planned` (K,) edges."""
    connected = int((graph.state[planned] == EdgeState.CONNECTED).sum())
    unknown = len(planned) - connected
    parts = []
    if connected:
        parts.append(f"{_count(len(attachments(graph)), 'attachment')} ({_count(connected, 'connected edge')})")
    if unknown:
        parts.append(f"{_count(unknown, 'edge')} not seen well enough")
    return f"{_count(cuts, 'segment')} to sever {' and '.join(parts)}."


def reason(graph: ConnectivityGraph, edges: NDArray[np.int64], goal_length: float | None) -> str:
    """Say what one segment severs, `edges` (K,), and where along the goal: in millimetres of its length [m], in percent without it."""
    attached = int((graph.state[edges] == EdgeState.CONNECTED).sum())
    unknown = len(edges) - attached
    states = [f"{attached} still attached"] * (attached > 0) + [f"{unknown} not known to be severed"] * (unknown > 0)
    return f"severs {_count(len(edges), 'connection')} ({', '.join(states)}){_place(graph.station[edges], goal_length)}"


def cannot_reach(missing: int, count: int) -> str:
    """Say that `missing` of `count` edges are out of reach."""
    return f"{missing} of {count} uncut edges cannot be reached by a segment that stays on the tissue."


def nothing_seen(count: int) -> str:
    """Say that all that is left is `count` unknown edges that are not seen, and what would help."""
    return f"Only {_count(count, 'unknown edge')} that cannot be seen now are left: another exposure is needed, nothing is cut unseen."


def left_unseen(count: int) -> str:
    """Say that `count` unknown edges are left out; nothing if none is."""
    return f" {_count(count, 'unknown edge')} not seen now {'is' if count == 1 else 'are'} left out." if count else ""


def _count(count: int, thing: str) -> str:
    return f"{count} {thing}{'' if count == 1 else 's'}"


def _place(stations: NDArray[np.float64], goal_length: float | None) -> str:
    known = stations[np.isfinite(stations)]
    if not len(known):
        return ""
    ends = known.min(), known.max()
    if goal_length is None:
        (low, high), unit = (f"{100 * end:.0f}" for end in ends), "% of the goal"
    else:
        (low, high), unit = (f"{1e3 * goal_length * end:.1f}" for end in ends), "mm along the goal"
    return f" at {low} {unit}" if low == high else f" between {low} and {high} {unit}"
