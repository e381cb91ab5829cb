"""How few segments the optimal cover needs, how sure it is, and how long it takes, beside the paper's greedy cover.

Random cases: goals of 150 to 600 px (20 to 80 mm), straight, bent and S-shaped; up to 400 edges across them that are uncut in some
stretches or everywhere; lips that opened by a random profile, sheared and jittered as keypoints are; a few edges off the line, as folds and
slipped tracks make them; half of the cases with the tissue's outline. Both covers plan the same case in turns. Run:
`python -m benchmarks.replan --json p.json`.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hardware.codes import Code
from hardware.interface import Array
from skills.estimate.graph import ConnectivityGraph, EdgeState
from skills.replan.candidates import ReplanConfig
from skills.replan.next_goal import NextGoal
from skills.replan.plan import next_goal
from skills.scene.polyline import arc_lengths, at_length, left_normals
from skills.scene.segments import touch
from skills.tracking.tracks import TrackedGoal

SIZE = (480, 640)
MOST_EDGES = 400
HARDEST = 1 / 100  # share of the cases with the most edges


@dataclass(frozen=True)
class Case:
    """One thing to plan for."""

    graph: ConnectivityGraph
    tracked: TrackedGoal
    outline: NDArray[np.bool_] | None


def goal(rng: np.random.Generator, shortest: float) -> Array:
    """A polyline (M, 2) [px] of `shortest` to 600 px inside the picture."""
    while True:
        length = rng.uniform(shortest, 600.0)
        s = np.linspace(0.0, 1.0, max(12, int(length / 8)))
        turn = rng.choice([0.0, rng.uniform(-1.6, 1.6)])
        heading = rng.uniform(-np.pi, np.pi) + turn * (s - 0.5) + rng.choice([0.0, 0.5]) * np.sin(2 * np.pi * s)
        step = length / (len(s) - 1) * np.column_stack([np.cos(heading), np.sin(heading)])
        line = np.cumsum(step, axis=0)
        low, high = line.min(axis=0), line.max(axis=0)
        room = np.array([SIZE[1] - 1, SIZE[0] - 1]) - 15.0 - (high - low)
        if (room >= 15.0).all():
            return np.asarray(line - low + 15.0 + rng.uniform(0.0, 1.0, 2) * (room - 15.0))


def uncut_stretches(stations: Array, rng: np.random.Generator) -> NDArray[np.bool_]:
    """Which stations (N,) are still attached: one to six stretches, anywhere."""
    uncut = np.zeros(len(stations), dtype=bool)
    for _ in range(rng.integers(1, 7)):
        middle, width = rng.uniform(0.0, 1.0), rng.uniform(0.02, 0.3)
        uncut |= np.abs(stations - middle) <= width / 2
    uncut[rng.integers(len(uncut))] = True
    return uncut


def aside(places: Array, rng: np.random.Generator) -> Array:
    """How far (N,) [px] edges at `places` [px] along the goal lie off it: up to three folds, and in half of the cases slipped tracks."""
    off = np.zeros(len(places))
    for _ in range(rng.integers(0, 4)):
        from_middle = (places - rng.uniform(0.0, places[-1])) / rng.uniform(15.0, 40.0)
        off += (
            rng.choice([-1.0, 1.0])
            * rng.uniform(8.0, 30.0)
            * np.where(np.abs(from_middle) < 1.0, 1 + np.cos(np.pi * from_middle), 0.0)
            / 2
        )
    slipped = rng.random(len(places)) < rng.choice([0.0, 0.02])
    return off + slipped * rng.choice([-1.0, 1.0], len(places)) * rng.uniform(8.0, 30.0, len(places))


def case(rng: np.random.Generator) -> Case:
    """Draw a case. In one of a hundred all of 400 edges are uncut, in one of five all of fewer."""
    kind = rng.random()
    line = goal(rng, 400.0 if kind < HARDEST else 150.0)
    length = float(arc_lengths(line)[-1])
    count = MOST_EDGES if kind < HARDEST else min(MOST_EDGES, max(8, int(length / rng.uniform(1.5, 9.0))))
    stations = np.linspace(0.02, 0.98, count)
    middle = at_length(line, stations * length)
    normal = np.column_stack([np.interp(stations * length, arc_lengths(line), left_normals(line)[:, i]) for i in range(2)])
    along = np.column_stack([-normal[:, 1], normal[:, 0]])
    opening = rng.uniform(0.0, 25.0) * np.sin(np.pi * stations) ** rng.uniform(0.5, 2.0)
    shear = rng.normal(0.0, 4.0)
    lips = []
    for side in (1.0, -1.0):
        jitter = rng.normal(0.0, 1.0, (count, 2))
        lips.append(middle + side * (7.0 + opening[:, None] / 2) * normal + side * shear / 2 * along + jitter)
    shift = aside(stations * length, rng)[:, None] * normal
    points = np.clip(np.concatenate([lips[0] + shift, lips[1] + shift]), 2.0, [SIZE[1] - 3.0, SIZE[0] - 3.0])
    uncut = np.ones(count, dtype=bool) if kind < HARDEST + 0.2 else uncut_stretches(stations, rng)
    left = np.where(rng.random(count) < 0.1, EdgeState.UNKNOWN, EdgeState.CONNECTED)
    graph = ConnectivityGraph(
        code=Code.OK,
        message="",
        reference=points,
        points=points,
        edges=np.column_stack([np.arange(count), np.arange(count) + count]),
        elongation=np.ones(count),
        state=np.where(uncut, left, EdgeState.SEVERED).astype(np.int64),
        probability=np.full(count, 0.5),
        crosses_goal=np.ones(count, dtype=bool),
        station=stations,
    )
    side = left_normals(line)
    tracked = TrackedGoal(
        stamp=0.0,
        polyline=line,
        near=line + 8.0 * side,
        far=line - 8.0 * side,
        visible=np.ones(len(line), dtype=bool),
        grasp=line[len(line) // 2] + rng.uniform(70.0, 120.0) * side[len(line) // 2],
        grasp_visible=True,
        lost=False,
        strain=float("nan"),
    )
    return Case(graph, tracked, tissue(line, points, rng) if rng.random() < 0.5 else None)


def tissue(line: Array, points: Array, rng: np.random.Generator) -> NDArray[np.bool_]:
    """A sheet (H, W) around the goal, its border bitten at up to three places; what lies between the lips is filled."""
    mask = np.zeros(SIZE, dtype=np.uint8)
    half = rng.uniform(30.0, 90.0)
    cv2.polylines(mask, [np.rint(line).astype(np.int32)], False, 1, thickness=int(2 * half))
    normals = left_normals(line)
    for _ in range(rng.integers(0, 4)):
        k = rng.integers(len(line))
        bite = line[k] + rng.choice([-1.0, 1.0]) * half * normals[k]
        cv2.circle(mask, np.rint(bite).astype(np.int32).tolist(), int(rng.uniform(0.2, 0.7) * half), 0, thickness=-1)
    one, other = points.reshape(2, -1, 2)
    for k in range(len(one) - 1):
        between = np.rint([one[k], one[k + 1], other[k + 1], other[k]]).astype(np.int32)
        cv2.fillConvexPoly(mask, cv2.convexHull(between), 1)
        cv2.polylines(mask, [between], True, 1, thickness=3)
    return mask.astype(bool)


def timed(each: Case, config: ReplanConfig, seed: int) -> tuple[NextGoal, float, float]:
    """Plan; the time it took [ms], and the processor's share of it, which a busy machine stretches less."""
    start, busy = time.perf_counter(), time.process_time()
    plan = next_goal(each.graph, each.tracked, config, np.random.default_rng(seed), each.outline)
    return plan, (time.perf_counter() - start) * 1e3, (time.process_time() - busy) * 1e3


def covered(each: Case, plan: NextGoal) -> float:
    """Share of the uncut edges that the segments cut."""
    edges = each.graph.points[each.graph.edges[each.graph.uncut]]
    return float(touch(plan.segments, edges).any(axis=0).mean()) if len(plan.segments) else 0.0


def quantiles(times: list[float]) -> dict[str, float]:
    """Median and 99th percentile."""
    return {"median": float(np.median(times)), "p99": float(np.percentile(times, 99))}


def measure(cases: int, seed: int) -> dict[str, Any]:
    """All figures over `cases` random cases."""
    optimal, greedy = ReplanConfig(compare=False), ReplanConfig(cover="greedy")
    rows = []
    timed(case(np.random.default_rng([seed, cases])), optimal, 0)  # libraries are loaded at the first call
    for number in range(cases):
        each = case(np.random.default_rng([seed, number]))
        order = (optimal, greedy) if number % 2 else (greedy, optimal)
        plans = {config.cover: timed(each, config, number) for config in order}
        rows.append((each, *plans["optimal"], *plans["greedy"]))
    counts = [(len(best.segments), len(paper.segments)) for _, best, _, _, paper, *_ in rows if paper.code is Code.OK]
    edges = np.array([each.graph.uncut.sum() for each, *_ in rows])
    ours, theirs = [row[2] for row in rows], [row[5] for row in rows]
    return {
        "cases": cases,
        "edges": {"median": float(np.median(edges)), "most": int(edges.max())},
        "covered": float(np.mean([covered(each, best) for each, best, *_ in rows])),
        "never_more_than_greedy": all(best <= paper for best, paper in counts),
        "optimal_proven_rate": float(np.mean([row[1].proven for row in rows])),
        "saved_segments_mean": float(np.mean([paper - best for best, paper in counts])),
        "segments_mean": {"optimal": float(np.mean([c[0] for c in counts])), "greedy": float(np.mean([c[1] for c in counts]))},
        "fewer_than_greedy_rate": float(np.mean([best < paper for best, paper in counts])),
        "greedy_failed": sum(row[4].code is not Code.OK for row in rows),
        "ms": quantiles(ours),
        "cpu_ms": quantiles([row[3] for row in rows]),
        "greedy_ms": quantiles(theirs),
        "ratio_greedy": {key: quantiles(ours)[key] / quantiles(theirs)[key] for key in ("median", "p99")},
    }


def main() -> None:
    """Measure, print, and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--cases", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    figures = measure(arguments.cases, arguments.seed)
    for key, value in figures.items():
        print(f"{key:24s}{value}")
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
