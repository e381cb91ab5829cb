"""Which stretches of the goal are still attached, as shares of its length and in millimetres for people."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skills.estimate.graph import ConnectivityGraph, EdgeState

MOST_TOLD = 4  # stretches in one sentence


def attachments(graph: ConnectivityGraph) -> list[tuple[float, float]]:
    """Stretches (start, end) of the goal, 0..1, over which tissue still bridges it: runs of connected edges that cross the goal.

    Each reaches half an edge's spacing to either side. An unknown edge between connected ones belongs to their run; unknown edges
    alone are no attachment, though they keep the goal from being complete.
    """
    crossing = np.flatnonzero(graph.crosses_goal)
    if not len(crossing):
        return []
    order = crossing[np.argsort(graph.station[crossing], kind="stable")]
    station, state = graph.station[order], graph.state[order]
    half = float(np.median(np.diff(station))) / 2 if len(station) > 1 else 0.0
    severed = state == EdgeState.SEVERED
    run_of = np.cumsum(severed)
    runs = []
    for run in np.unique(run_of[~severed]):
        connected = station[(run_of == run) & (state == EdgeState.CONNECTED)]
        if len(connected):
            runs.append((float(max(connected[0] - half, 0.0)), float(min(connected[-1] + half, 1.0))))
    return runs


def located(graph: ConnectivityGraph, goal_length: float | None) -> ConnectivityGraph:
    """The `graph` of a goal that was `goal_length` [m] long at t_d (None: not known), its message saying where it is attached."""
    runs = attachments(graph)
    if not runs:
        return replace(graph, goal_length=goal_length)
    scale, digits, unit = (100.0, 0, "% of the goal") if goal_length is None else (1e3 * goal_length, 1, "mm along the goal")
    told = [f"{scale * start:.{digits}f} to {scale * end:.{digits}f}" for start, end in runs]
    more = f" and {len(told) - MOST_TOLD} more" if len(told) > MOST_TOLD else ""
    where = f" Attached at {', '.join(told[:MOST_TOLD])} {unit}{more}."
    return replace(graph, goal_length=goal_length, message=graph.message + where)
