"""A made-up but realistic session for the tests of records and views: two attempts, one refusal, one attachment recut.

Both exposures are planned, nine steps each half a second apart; the second ends instead of making its ninth.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from hardware.codes import Code
from hardware.gate import Decision
from hardware.interface import CUTTER, GRASPER, Frame, Image, Pose
from skills.estimate.graph import ConnectivityGraph, EdgeState
from skills.expose.optimal import View as ExposureView
from skills.tracking.tracks import TrackedGoal
from supervisor.record import Recorder
from supervisor.snapshot import NodeState, TickSnapshot

PERIOD = 0.1  # [s]
# path, name, kind, depth
NODES = (
    ("session", "session", "sequence", 0),
    ("session/guards", "guards", "sequence", 1),
    ("session/guards/emergency stop", "emergency stop", "guard", 2),
    ("session/guards/arms ready", "arms ready", "guard", 2),
    ("session/guards/camera fresh", "camera fresh", "guard", 2),
    ("session/guards/tension", "tension", "guard", 2),
    ("session/procedure", "procedure", "sequence", 1),
    ("session/procedure/checklist", "checklist", "skill", 2),
    ("session/procedure/approve goal", "approve goal", "leaf", 2),
    ("session/procedure/attempts", "attempts", "selector", 2),
    ("session/procedure/attempts/dissect", "dissect", "skill", 3),
    ("session/procedure/attempts/expose", "expose", "skill", 3),
    ("session/procedure/attempts/estimate", "estimate", "skill", 3),
    ("session/procedure/attempts/replan", "replan", "skill", 3),
    ("session/procedure/retreat", "retreat", "skill", 2),
)
# What runs, from when [s], in which attempt
PHASES = (
    ("checklist", 0.0, 0),
    ("approve goal", 1.0, 0),
    ("dissect", 3.0, 1),
    ("expose", 14.0, 1),
    ("estimate", 19.0, 1),
    ("replan", 19.5, 1),
    ("dissect", 20.0, 2),
    ("expose", 23.0, 2),
    ("estimate", 28.0, 2),
    ("retreat", 28.5, 2),
    ("", 30.0, 2),
)
HEADER = {
    "seed": 7,
    "scene": "silicone",
    "agent": "planning",
    "bench": "stub",
    "versions": {"python": "3.11.2", "warp-lang": "1.19.0", "py_trees": "2.6.0"},
    "exposure": "optimal",
    "device": "cpu",
    "limits": {"tension_stop": 4.0, "strain_stop": 0.5, "max_cuts_per_approval": 80, "workspace_lower": [-0.09, -0.07, 0.02]},
    "configuration": {"expose": {"step": 0.0005, "steps": 35}, "skills": {"optimal": {"separation": {"enough": 3.0}}}},
    "calibration": "stub, exact",
}
OUTCOME = {
    "outcome": "complete",
    "code": "complete",
    "message": "No tissue connection crosses the goal any more.",
    "attempts": 2,
    "attachments": 0,
    "length_deviation_m": 0.00062,
    "success": True,
}


def picture(opening: float, grasp: tuple[float, float], seed: int = 0) -> Image:
    """A tissue-like image (480, 640, 3) uint8 RGB with a cut along u = 320 that gapes by `opening` [px]."""
    rng = np.random.default_rng(seed)
    noise = cv2.GaussianBlur(rng.normal(0, 1, (480, 640, 3)).astype(np.float32), (0, 0), 5) * 120
    rows, columns = np.mgrid[0:480, 0:640]
    falloff = 1.05 - 0.55 * (((columns - 320) / 400) ** 2 + ((rows - 240) / 330) ** 2)
    image = (np.array([196, 112, 98]) + noise) * falloff[..., None]
    gap = np.abs(columns - 320) < opening * np.sqrt(np.clip(1 - ((rows - 240) / 170) ** 2, 0, None))
    image[gap] *= 0.22
    image = np.clip(image + rng.normal(0, 4, image.shape), 0, 255).astype(np.uint8)
    u, v = int(grasp[0]), int(grasp[1])
    cv2.line(image, (u, v), (0, v + 90), (150, 154, 160), 16, cv2.LINE_AA)
    cv2.line(image, (u, v), (0, v + 90), (205, 208, 212), 4, cv2.LINE_AA)
    return image


def tracked_goal(stamp: float, pull: float) -> TrackedGoal:
    """The goal along u = 320 while the grasped side is pulled by `pull` [px]."""
    v = np.linspace(80, 400, 33)
    line = np.column_stack([320 - pull / 4 * np.sin(np.pi * (v - 80) / 320), v])
    near = line - np.array([12 + pull / 2, 0])
    visible = np.ones(33, dtype=np.bool_)
    grasp = np.array([230 - pull, 240.0])
    return TrackedGoal(stamp, line, near, line + np.array([12, 0]), visible, grasp, True, False, 0.1 + pull / 400)


def estimate(attempt: int, pull: float) -> ConnectivityGraph:
    """A 7 x 17 grid of keypoints; in the first attempt three edges still hold and two are unknown."""
    columns, rows = 7, 17
    u, v = np.meshgrid(np.linspace(230, 410, columns), np.linspace(80, 400, rows))
    reference = np.column_stack([u.ravel(), v.ravel()])
    swing = np.where(reference[:, 0] < 319, pull * np.sin(np.pi * (reference[:, 1] - 80) / 320), 0)
    points = reference - np.column_stack([swing, np.zeros_like(swing)])
    index = np.arange(rows * columns).reshape(rows, columns)
    across = np.column_stack([index[:, :-1].ravel(), index[:, 1:].ravel()])
    along = np.column_stack([index[:-1].ravel(), index[1:].ravel()])
    edges = np.vstack([across, along])
    state = np.full(len(edges), int(EdgeState.CONNECTED))
    crosses = np.zeros(len(edges), dtype=bool)
    crosses[[row * (columns - 1) + 2 for row in range(rows)]] = True
    state[crosses] = EdgeState.SEVERED
    if attempt == 1:
        bridges = np.flatnonzero(crosses)
        state[bridges[[11, 12, 13]]] = EdgeState.CONNECTED
        state[bridges[[0, 16]]] = EdgeState.UNKNOWN
    length = np.linalg.norm(points[edges[:, 1]] - points[edges[:, 0]], axis=1)
    before = np.linalg.norm(reference[edges[:, 1]] - reference[edges[:, 0]], axis=1)
    elongation = np.where(state == EdgeState.UNKNOWN, np.nan, length / before)
    station = np.where(crosses, (reference[edges[:, 0], 1] - 80) / 320, np.nan)
    probability = np.where(state == EdgeState.SEVERED, 0.97, np.where(state == EdgeState.UNKNOWN, 0.5, 0.04))
    message = "3 edges still hold and 2 are hidden" if attempt == 1 else "all edges across the goal are severed"
    return ConnectivityGraph(Code.OK, message, reference, points, edges, elongation, state, probability, crosses, station)


# Two triangles for each exposure: a record tells exposures apart by their mesh.
MESHES = {attempt: np.array([[0, 1, 2], [2, 1, 3]], dtype=np.int32) for attempt in (1, 2)}
STEP_PERIOD = 0.5  # [s]


def exposure_view(attempt: int, number: int) -> ExposureView:
    """What a controller had in mind before step `number` of a pull to the left."""
    corners = np.array([[0.0, 0.0, 0.1], [0.01, 0.0, 0.1], [0.0, 0.01, 0.1], [0.01, 0.01, 0.1]])
    corners[0, 0] = -0.000501234 * number
    rng = np.random.default_rng(number)
    plan = np.cumsum(np.tile([-0.0005, 0.0, 0.0], (6, 1)), axis=0)
    paths = plan + rng.normal(0.0, 1e-4, (40, 6, 3))
    return ExposureView(
        number, corners, MESHES[attempt], paths, plan, 400.0 * number, -0.9, -1.0 - 0.1 * number, 0.1 * number, 0.3 * number
    )


def exposed(steps: int) -> dict[str, Any]:
    """What is told of a pull of `steps` steps."""
    by_step = [0.1 * k for k in range(1, steps + 1)]
    return {
        "code": "ok",
        "message": f"pulled {steps} of 35 steps: severed and connected tissue are 3.1 standard deviations apart",
        "stopped_by": "exposure_separated",
        "steps": steps,
        "path": [[-0.0005 * k, 0.0, 0.1] for k in range(1, steps + 1)],
        "tension": by_step,
        "strain": [None, *by_step[1:]],
        "stamps": [1.0 + 0.1 * k for k in range(1, steps + 1)],
        "forecast": {"edges": [7], "severed": [[1.5]] * steps, "connected": [[1.1]] * steps, "separation": by_step},
        "planned": {"opening": by_step, "agreement": by_step, "feasible": [1.0] * steps},
    }


def snapshots(images: bool = True) -> Iterator[TickSnapshot]:
    """The ticks of a session of 30 s of bench time, every 0.1 s."""
    statuses = {path: "INVALID" for path, *_ in NODES}
    graph: ConnectivityGraph | None = None
    attachments: int | None = None
    ended = PHASES[-1][1]
    for tick in range(round(ended / PERIOD) + 1):
        stamp = tick * PERIOD
        phase, began, attempt = next(p for p in reversed(PHASES) if p[1] <= stamp + 1e-9)
        running = {p[0] for p in PHASES if p[0] == phase}
        for path, name, kind, _ in NODES:
            if kind == "guard":
                statuses[path] = "SUCCESS"
            elif name in running:
                statuses[path] = "RUNNING"
            elif statuses[path] == "RUNNING":
                statuses[path] = "SUCCESS"
        for path in ("session", "session/procedure"):
            statuses[path] = "RUNNING" if phase else "SUCCESS"
        statuses["session/guards"] = "SUCCESS"
        statuses["session/procedure/attempts"] = "RUNNING" if 3 <= stamp < 28.5 else ("SUCCESS" if stamp >= 28.5 else "INVALID")
        pull = 6 * (stamp - began) if phase == "expose" else (30.0 if phase in ("estimate", "replan") else 0.0)
        log: tuple[str, ...] = (f"{phase} begins",) if phase and abs(stamp - began) < 1e-9 else ()
        if phase == "estimate" and (graph is None or abs(stamp - began) < 1e-9):
            graph, attachments = estimate(attempt, pull), 1 if attempt == 1 else 0
        decisions = tuple(_decisions(stamp, phase))
        number = (stamp - began) / STEP_PERIOD
        planned = phase == "expose" and number > 0.5 and abs(number - round(number)) < 1e-6
        tension = 0.25 + pull / 20 + 0.05 * math.sin(3 * stamp)
        position = np.array([-0.012 - pull * 1e-4, 0.0, 0.11])
        tool = Pose.looking(position, np.array([0.3, 0.0, 1.0]), np.array([0.0, 1.0, 0.0]))
        frame = (
            Frame(tick * 3, stamp, picture(pull / 3 if attempt else 0, (230 - pull, 240), tick))
            if images and tick % 10 == 0
            else None
        )
        nodes = tuple(
            NodeState(path, name, kind, depth, statuses[path], f"{name}: {stamp - began:.0f} s" if name in running else "")
            for path, name, kind, depth in NODES
        )
        yield TickSnapshot(
            tick=tick,
            stamp=stamp,
            nodes=nodes,
            attempt=attempt,
            max_attempts=3,
            progress=f"{phase}, {stamp - began:.0f} s" if phase else "done",
            attachments=attachments,
            tension=tension,
            strain=0.1 + pull / 400,
            tools={GRASPER: tool, CUTTER: tool.moved(np.array([0.03, 0.0, -0.01]))},
            jaws={GRASPER: 0.0, CUTTER: 0.6},
            decisions=decisions,
            log=log,
            frame=frame,
            tracked=tracked_goal(stamp, pull) if attempt else None,
            graph=graph,
            exposure=exposure_view(attempt, round(number)) if planned else None,
        )


def _decisions(stamp: float, phase: str) -> Iterator[Decision]:
    """One servo command a tick while something moves; a few refused near the end of the first exposure."""
    if phase in ("dissect", "expose"):
        served = Decision(
            stamp, phase, CUTTER if phase == "dissect" else GRASPER, "servo_cp", True, Code.OK, "", (0.0, 0.0, 0.1, 0, 0, 0, 1)
        )
        refused = phase == "expose" and 18.0 <= stamp < 18.35
        why = "The tissue is under 4.1 N; pulling further is refused above 4 N."
        yield replace(served, accepted=False, code=Code.TENSION, message=why) if refused else served


def truth(attempt: int) -> dict[str, float]:
    """What the simulated bench knows after an attempt."""
    return {
        "attempt": attempt,
        "attachments": 1 if attempt == 1 else 0,
        "effective_cut_ratio": 0.86 if attempt == 1 else 1.0,
        "excessive_cut_ratio": 0.03 if attempt == 1 else 0.045,
        "length_deviation_m": 0.0031 if attempt == 1 else 0.00062,
        "visible_area_px": 9200 + 2100 * attempt,
    }


def record_session(folder: Path, *, until: float = 99.0, close: bool = True, images: bool = True) -> Path:
    """Record the session into `folder` up to bench time `until` [s]; return the folder."""
    recorder = Recorder(folder, HEADER)
    for snapshot in snapshots(images):
        if snapshot.stamp > until:
            break
        recorder.snapshot(snapshot)
        if abs(snapshot.stamp - 2.0) < 1e-9:
            asked = {"kind": "goal", "goal_id": "3fa9c1", "frame_sequence": 60, "reason": "sever along the drawn goal"}
            recorder.write("approval", 2.0, {**asked, "event": "asked"})
            recorder.write("approval", 2.0, {**asked, "event": "approved", "by": "auto", "comment": ""})
        for steps, at in ((9, 18.9), (8, 28.0)):
            if abs(snapshot.stamp - at) < 1e-6:
                recorder.write("exposed", snapshot.stamp, exposed(steps))
        for attempt, at in ((1, 19.2), (2, 28.2)):
            if abs(snapshot.stamp - at) < 1e-6:
                recorder.write("/truth", snapshot.stamp, truth(attempt))
    if close:
        recorder.close(OUTCOME)
    else:
        recorder.flush()
    return folder
