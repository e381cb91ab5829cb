"""One case of the detection experiment: the expert pulls, the session's tracker and rule judge every edge, the mesh says what is true.

Truth is read when the estimate is asked for: an edge is severed when the material between its two keypoints, where they were laid at
t_d, crosses a fully severed edge of the mesh. What hangs together by a seam, or tore only later, counts as connected.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from time import monotonic, perf_counter
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from hardware.gate import Limits, SafetyGate
from hardware.interface import CUTTER, Array, MoveStatus, Pose
from hardware.stub.bench import StubBench
from hardware.stub.phantom import Phantom
from hardware.stub.sheet_solver import bed_height
from hardware.stub.truth import severed_between
from skills.estimate.graph import ConnectivityGraph, EdgeState
from skills.scene.segments import touch
from skills.skill import ImmediateExecutor
from skills.tracking.goal_tracker import GoalTracker
from supervisor.experiments.detection_cases import Case, bench_of
from supervisor.experiments.dissected import rest_coordinates, stretch
from supervisor.experiments.disturbances import DisturbedBench, Occlusion
from supervisor.experiments.pulling import pull, starting_at
from supervisor.plain import plain
from supervisor.skillset import ExposureKind, SessionSkills, SkillConfig

T = TypeVar("T")

UNWATCHED = 1e3  # strain that stops the expert, and seconds for which it may stay unknown: never
BINS = 10  # of the probability, for the reliability
OVER_GOAL = 7e-3  # [m] that the scissors reach beyond the goal, so that their wrist covers it
SHAFT = np.array([-0.35, 0.75, -0.55])  # their direction over the table: from the lower right of the image


def run_case(case: Case, config: SkillConfig, look: Callable[[int, DisturbedBench], None] | None = None) -> dict[str, Any]:
    """Pull once with the skills of `config` and judge; `look` is called after each step of the pull. Plain values.

    The pull is scripted: the session's own straight one across the goal, slightly lifted, as many steps as the seed says, less only
    where the tension is too great. Its direction is measured once, from the goal that the expert drew just before. The strain that a
    tracker reads stops nothing, so that what is seen does not depend on the tracker that is judged.

    Raises:
        RuntimeError: the case did not come to an end.
    """
    started = monotonic()
    truth = bench_of(case)
    bench = DisturbedBench(truth, case.effect)
    config = scripted(config, case)
    refusals: list[str] = []
    limits = Limits(strain_warn=UNWATCHED, strain_stop=UNWATCHED)
    gate = SafetyGate(bench, limits, lambda decision: None if decision.accepted else refusals.append(decision.code.value))
    executor = TimedExecutor()
    skills = SessionSkills(gate, config, executor, case.seed, "no calibration needed", None)
    watch = _Watch(truth, bench, gate, skills, executor, case, look)
    pulled = pull(truth, gate, skills, case.lift, watch.after_tick, follow_grasp=False)
    exposed, graph = pulled.exposed, pulled.graph
    judged = {} if graph is None or watch.rest is None else judge(graph, watch.rest, truth.phantom)
    bench.close()
    return {
        "seed": case.seed,
        "scene": case.scene,
        "cut": case.cut,
        "disturbance": case.disturbance.value,
        "drawn": plain(case),
        "code": pulled.code.value,
        "message": pulled.message,
        "stopped_by": "" if exposed is None else exposed.stopped_by.value,
        "steps": 0 if exposed is None else len(exposed.path),
        "peak_tension_n": watch.tension,
        "torn": truth.phantom.tears,
        "refused": sorted(set(refusals)),
        "tripped": "" if gate.tripped is None else gate.tripped.code.value,
        "occluded_by": watch.scissors.moved_by if watch.scissors is not None else "",
        "said": "" if graph is None else graph.message,
        **judged,
        "points": watch.points,
        "ms": [round(1e3 * seconds, 2) for seconds in executor.took],
        "bench_s": truth.now(),
        "wall_s": monotonic() - started,
    }


def scripted(config: SkillConfig, case: Case) -> SkillConfig:
    """`config` with the expert's pull of `case` instead of its own exposure."""
    config = starting_at(replace(config, exposure=ExposureKind.GOAL_NORMAL), case.lift)
    strain = replace(config.strain, patience=UNWATCHED)
    return replace(config, pull=replace(config.pull, steps=case.steps), strain=strain)


# ------------------------------------------------------------ judged by the truth


def judge(graph: ConnectivityGraph, rest: Array, phantom: Phantom) -> dict[str, Any]:
    """Tallies over all edges and over those that cross the goal, and a row for each of the latter.

    `rest` (N, 2) [m] are the rest coordinates of the keypoints at t_d.
    """
    a, b = rest[graph.edges[:, 0]], rest[graph.edges[:, 1]]
    severed, damage = severed_between(phantom, a, b), damage_between(phantom, a, b)
    rows = [
        {
            "station": round(float(graph.station[k]), 4),
            "severed": bool(severed[k]),
            "damage": round(float(damage[k]), 3),
            "state": EdgeState(int(graph.state[k])).name.lower(),
            "probability": round(float(graph.probability[k]), 4),
            "elongation": round(float(graph.elongation[k]), 3) if np.isfinite(graph.elongation[k]) else None,
        }
        for k in np.flatnonzero(graph.crosses_goal)
    ]
    everything = np.ones(len(severed), dtype=bool)
    return {
        "edges": tally(graph, severed, everything),
        "goal_edges": tally(graph, severed, graph.crosses_goal),
        "rows": rows,
    }


def tally(graph: ConnectivityGraph, severed: NDArray[np.bool_], which: NDArray[np.bool_]) -> dict[str, Any]:
    """Sums over the edges `which` (E,), given whether they are `severed` (E,) in truth: they add up over cases.

    `confusion[truth][called]` counts edges, `squared_error` is that of the probabilities, `bins` hold for each tenth of the probability
    the number of edges, the sum of their probabilities, and how many are severed.
    """
    state, probability, is_severed = graph.state[which], graph.probability[which], severed[which]
    called = {value.name.lower(): state == value for value in EdgeState}
    number = np.clip((probability * BINS).astype(np.int64), 0, BINS - 1)
    return {
        "confusion": {
            name: {word: int((here & said).sum()) for word, said in called.items()}
            for name, here in (("severed", is_severed), ("connected", ~is_severed))
        },
        "squared_error": float(((probability - is_severed) ** 2).sum()),
        "bins": [
            [int((number == k).sum()), float(probability[number == k].sum()), int(is_severed[number == k].sum())]
            for k in range(BINS)
        ],
    }


def damage_between(phantom: Phantom, a: Array, b: Array) -> Array:
    """(N,) greatest damage short of a full cut on the material segments from rest points a[i] to b[i] (N, 2); 0 where there is none."""
    partly = [edge for edge in phantom.mesh.cut_edges if 0.0 < edge.damage < 1.0]
    if not partly:
        return np.zeros(len(a))
    seams = np.array([(edge.a, edge.b) for edge in partly])
    met = touch(np.stack([a, b], axis=1), seams)
    return np.asarray(np.where(met, np.array([edge.damage for edge in partly]), 0.0).max(axis=1))


# ------------------------------------------------------------ while it runs


class TimedExecutor(ImmediateExecutor):
    """Runs each call at once, and notes how long [s] each update of the goal's tracker took on the wall's clock."""

    def __init__(self) -> None:
        self.took: list[float] = []
        self.timing = False

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:  # type: ignore[override]
        """Run `fn` now and return its finished future."""
        tracking = isinstance(getattr(fn, "__self__", None), GoalTracker) and fn.__name__ == GoalTracker.update.__name__
        begun = perf_counter()
        future = super().submit(fn, *args, **kwargs)
        if self.timing and tracking:
            self.took.append(perf_counter() - begun)
        return future


class Scissors:
    """Brings the scissors into view and out again, by the lease of whoever pulls; by the arm itself where the gate refuses."""

    def __init__(self, truth: StubBench, gate: SafetyGate, occlusion: Occlusion) -> None:
        self._truth = truth
        self._gate = gate
        self._occlusion = occlusion
        self._parked: Pose | None = None
        self._gone = False
        self.moved_by = ""  # `gate` or `arm`, once they have moved

    def after_step(self, step: int) -> None:
        """Begin to move when the time has come; called at every tick of the pull."""
        o = self._occlusion
        if self._parked is None and step >= o.from_step:
            self._parked = self._truth.arms[CUTTER].setpoint_cp()
            self._move(self._over_the_goal())
        elif self._parked is not None and not self._gone and o.until_step is not None and step >= o.until_step:
            self._gone = True
            self._move(self._parked)

    def _move(self, pose: Pose) -> None:
        lease = self._gate.lease
        refused = lease is None or lease.move_cp(CUTTER, pose).report().status is MoveStatus.FAILED
        if refused:
            self._truth.arms[CUTTER].move_cp(pose)
        self.moved_by = "arm" if refused else self.moved_by or "gate"

    def _over_the_goal(self) -> Pose:
        """Where the tip is sent: before the goal as the camera sees it, and a little beyond."""
        o, scene = self._occlusion, self._truth.scene
        spot = stretch(scene.line, 0.0, o.at)[-1]
        ground = np.append(spot, bed_height(spot[None], scene.bump)[0] + scene.tissue.thickness)
        table = np.vstack([ground, SHAFT, np.array([1.0, 0.0, 0.0]), np.zeros(3)])
        at, shaft, opening, origin = self._truth.to_camera(table)
        shaft, opening = (shaft - origin) / np.linalg.norm(SHAFT), opening - origin
        before = at - o.height * at / np.linalg.norm(at)
        return Pose.looking(before + OVER_GOAL * shaft, shaft, opening)


@dataclass
class _Watch:
    """Notes the material below the keypoints at t_d and what the pull did; moves the scissors. The skills see none of this."""

    truth: StubBench
    bench: DisturbedBench
    gate: SafetyGate
    skills: SessionSkills
    executor: TimedExecutor
    case: Case
    look: Callable[[int, DisturbedBench], None] | None

    def __post_init__(self) -> None:
        effect = self.case.effect
        self.scissors = Scissors(self.truth, self.gate, effect) if isinstance(effect, Occlusion) else None
        self.rest: Array | None = None
        self.points = 0
        self.tension = 0.0

    def after_tick(self) -> None:
        """Notice the reference and new steps."""
        grid = self.skills.grid()
        if grid is None:
            return
        if self.rest is None:
            tracked = self.skills.tracked()
            assert tracked is not None, "a grid is laid around a tracked goal"
            self.rest = rest_coordinates(self.truth, grid.points)
            self.points = len(grid.points) + 2 * len(tracked.polyline) + 1
            self.executor.timing = True
        step = self.skills.exposure_step
        self.tension = max(self.tension, float(np.linalg.norm(self.truth.phantom.grip_force())))
        if self.scissors is not None:
            self.scissors.after_step(step)
        if self.look is not None and step > self.bench.endoscope.step:
            self.look(step, self.bench)
        self.bench.endoscope.step = step
