"""One trial of the exposure experiment: a goal severed in part, a grasp off its normal, one method that pulls, judged by the mesh.

The paper's protocol (Evaluation of Exposure Maximization Control): the tissue is dissected beforehand, the controller only exposes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import monotonic
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hardware.codes import Code
from hardware.gate import Limits, SafetyGate
from hardware.interface import GRASPER, Array
from hardware.stub.bench import StubBench
from hardware.stub.renderer import Label
from hardware.stub.scene import Scene
from hardware.stub.truth import severed_between
from skills.estimate.graph import ConnectivityGraph, EdgeState
from skills.motion import pause, servo_line
from skills.scene.goal import Goal
from skills.skill import ImmediateExecutor, Steps
from skills.tracking.model_based import raycast
from supervisor.experiments.evaluator import visible_area
from supervisor.session import TICK
from supervisor.skillset import SessionSkills, SkillConfig
from supervisor.stub_goal import drawn_goal

T = TypeVar("T")

SEVERED = (0.5, 1.0)  # share of the goal that is severed, uniform
GRASP_AWAY = (2e-3, 10e-3)  # [m] of the grasp from the goal, uniform
GRASP_ALONG = 12e-3  # [m] of the grasp along the goal to either side of its middle, uniform
TEST_PULL = 3e-3  # [m]: a flap that is severed resists less than whole tissue
RELAXED = 0.5e-3  # [m]: every pull starts where the jaws closed, not where the test of the grasp ended
BACK_SPEED = 5e-3  # [m/s], there
SETTLE = 0.3  # [s], there
BESIDE = 0.8e-3  # [m] from the goal's line to the tissue on either side that says where the line is now
LONGEST = 120.0  # [s] of bench time for one trial


@dataclass(frozen=True)
class Setting:
    """What a trial's seed draws: severed stretches of the goal, 0..1 along it, and the grasp [m] in rest coordinates."""

    severed: tuple[tuple[float, float], ...]
    grasp: tuple[float, float]
    away: float  # [m] from the goal
    along: float  # [m] from its middle

    @property
    def share(self) -> float:
        """Severed share of the goal."""
        return sum(b - a for a, b in self.severed)

    @property
    def angle(self) -> float:
        """Angle [rad] between the line from the goal's middle to the grasp and the goal's normal."""
        return float(np.arctan2(abs(self.along), self.away))


def draw(scene: Scene, seed: int) -> Setting:
    """Draw a trial's setting: one stretch of the goal stays attached, anywhere along it."""
    rng = np.random.default_rng([seed, 17])
    share = rng.uniform(*SEVERED)
    start = rng.uniform(0.0, share)
    away, along = rng.uniform(*GRASP_AWAY), rng.uniform(-GRASP_ALONG, GRASP_ALONG)
    severed = tuple((a, b) for a, b in ((0.0, start), (start + 1.0 - share, 1.0)) if b - a > 1e-3)
    line = scene.line
    middle, chord = (line[0] + line[-1]) / 2, line[-1] - line[0]
    tangent = chord / np.linalg.norm(chord)
    normal = np.array([-tangent[1], tangent[0]])
    grasp = middle + along * tangent + away * normal
    return Setting(severed, (float(grasp[0]), float(grasp[1])), float(away), float(along))


def prepared_bench(scene: Scene, setting: Setting, seed: int) -> StubBench:
    """A bench whose tissue was dissected before: cut through along the setting's stretches of the goal.

    The expert draws the goal along the cut that is seen; over the bed's bump that is a curve in the image.
    """
    line = tuple((float(x), float(y)) for x, y in _stretch(scene.line, 0.0, 1.0))
    bench = StubBench(replace(scene, goal=replace(scene.goal, line=line, grasp=setting.grasp)), seed)
    for a, b in setting.severed:
        bench.phantom.cut([(_stretch(scene.line, a, b), 1.0)])
    bench.advance(0.5)
    return bench


def goal_on_the_cut(bench: StubBench) -> Goal:
    """What an expert would draw now, on tissue that has moved: along the cut, midway between the tissue on its two sides."""
    scene, phantom, camera = bench.scene, bench.phantom, bench.endoscope.camera
    line = scene.line
    chord = line[-1] - line[0]
    normal = np.array([-chord[1], chord[0]]) / np.linalg.norm(chord)
    off = (phantom.mesh.rest - line.mean(axis=0)) @ normal
    sides = []
    for sign in (1.0, -1.0):
        here = np.flatnonzero(sign * off > 0.25 * BESIDE)
        distance, nearest = cKDTree(phantom.mesh.rest[here]).query(line + sign * BESIDE * normal, k=3)
        weights = 1.0 / np.maximum(distance, 1e-6)
        weights = weights / weights.sum(axis=1, keepdims=True)
        sides.append((weights[:, :, None] * phantom.positions[here[nearest]]).sum(axis=1))
    middle = (sides[0] + sides[1]) / 2.0 + np.array([0.0, 0.0, scene.tissue.thickness / 2])
    grasp = bench.arms[GRASPER].true_pose().position
    return Goal(camera.project(bench.to_camera(middle)), camera.project(grasp[None])[0], (camera.width, camera.height))


@dataclass(frozen=True)
class Sample:
    """One step of a pull: visible area [px], true tension [N] at the jaws, 99th percentile of the true strain, judgement of the edges."""

    step: int
    area: int
    tension: float
    strain: float
    judged: dict[str, float]


def run_trial(
    scene: Scene,
    config: SkillConfig,
    seed: int,
    look: Callable[[int, StubBench, SessionSkills], None] | None = None,
    every: int = 1,
) -> dict[str, Any]:
    """One method on one seed; `look` is called after each step of the pull. Plain values.

    Raises:
        RuntimeError: the trial did not come to an end.
    """
    started = monotonic()
    setting = draw(scene, seed)
    bench = prepared_bench(scene, setting, seed)
    config = replace(
        config,
        grasp=replace(config.grasp, test_pull=TEST_PULL),
        pull=replace(config.pull, relaxed=RELAXED),
        # Nothing is cut halfway here, and truth is that of the edge's own line: an opening along it tells that it is severed.
        tracker=replace(config.tracker, between=()),
        elongation=replace(config.elongation, min_lengthening=config.elongation.end_lengthening),
    )
    refusals: list[str] = []
    gate = SafetyGate(bench, Limits(), lambda decision: None if decision.accepted else refusals.append(decision.code.value))
    skills = SessionSkills(gate, config, ImmediateExecutor(), seed, "no calibration needed", None)
    watch = _Watch(bench, skills, every, look)
    _run(bench, skills.checklist(), skills, watch, tracking=False)
    tracked = _run(bench, skills.start_tracking(drawn_goal(bench)), skills, watch, tracking=False)
    held, outcome, graph = None, None, None
    if tracked.code is Code.OK:
        lease = gate.grant("grasp")
        held = _run(bench, skills.take_hold(lease), skills, watch)
        if skills.grasped is not None:
            start = skills.grasped.origin.moved(RELAXED * skills.grasped.normal)
            _run(bench, servo_line(lease, GRASPER, start, BACK_SPEED, "going back"), skills, watch)
            _run(bench, pause(lease, SETTLE, "letting the tissue settle"), skills, watch)
            # The protocol begins here: the expert draws the goal on the picture of the grasped, dissected tissue.
            tracked = _run(bench, skills.start_tracking(goal_on_the_cut(bench)), skills, watch, tracking=False)
        gate.revoke(lease)
        lease = gate.grant("expose")
        outcome = _run(bench, skills.expose(lease), skills, watch)
        gate.revoke(lease)
        if outcome.code is Code.OK:
            graph = _run(bench, skills.estimate(), skills, watch, tracking=False)
    bench.close()
    return {
        "seed": seed,
        "method": config.exposure.value,
        "severed_share": setting.share,
        "grasp_away_m": setting.away,
        "grasp_along_m": setting.along,
        "angle_rad": setting.angle,
        "code": (tracked if outcome is None else outcome).code.value,
        "message": held.message if outcome is None and held is not None else (outcome or tracked).message,
        "stopped_by": "" if outcome is None else outcome.stopped_by.value,
        "steps": 0 if outcome is None else len(outcome.path),
        "visible_area_px": visible_area(bench),
        "peak_tension_n": max((s.tension for s in watch.samples), default=0.0),
        "peak_strain": max((s.strain for s in watch.samples), default=0.0),
        "reported_strain": [] if outcome is None else [round(float(v), 4) for v in outcome.strain],
        "torn": bench.phantom.tears,
        "refused": sorted(set(refusals)),
        "tripped": "" if gate.tripped is None else gate.tripped.code.value,
        "judged": {} if graph is None else watch.judge(graph),
        "curve": [
            {"step": s.step, "area_px": s.area, "tension_n": s.tension, "strain": s.strain, **s.judged} for s in watch.samples
        ],
        "bench_s": bench.now(),
        "wall_s": monotonic() - started,
    }


class _Watch:
    """Reads the truth after each step of the pull; the skills never see it."""

    def __init__(
        self, bench: StubBench, skills: SessionSkills, every: int, look: Callable[[int, StubBench, SessionSkills], None] | None
    ) -> None:
        self._bench = bench
        self._skills = skills
        self._every = every
        self._look = look
        self._rest: Array | None = None
        self._last = 0
        self.samples: list[Sample] = []

    def after_tick(self) -> None:
        """Notice a new reference and a new step."""
        grid = self._skills.grid()
        if grid is not None and self._rest is None:
            self._rest = rest_coordinates(self._bench, grid.points)
        number = self._skills.exposure_step
        if number > self._last:
            self._last = number
            if number % self._every == 0:
                self._sample(number)
            if self._look is not None:
                self._look(number, self._bench, self._skills)

    def judge(self, graph: ConnectivityGraph) -> dict[str, float]:
        """Count the edges across the goal against the truth (severed: the material between its ends crosses a cut)."""
        assert self._rest is not None, "edges are judged only after a reference"
        return judge(graph, severed_between(self._bench.phantom, self._rest[graph.edges[:, 0]], self._rest[graph.edges[:, 1]]))

    def _sample(self, number: int) -> None:
        phantom = self._bench.phantom
        tension = float(np.linalg.norm(phantom.grip_force()))
        strain = float(np.percentile(phantom.edge_strain(), 99))
        judged = self.judge(self._skills.judge_now())
        self.samples.append(Sample(number, visible_area(self._bench), tension, strain, judged))


def judge(graph: ConnectivityGraph, truth: NDArray[np.bool_]) -> dict[str, float]:
    """Counts over the edges that cross the goal: severed and connected in truth, and how many of each were called severed or unknown."""
    crossing = graph.crosses_goal
    called, unknown = graph.state[crossing] == EdgeState.SEVERED, graph.state[crossing] == EdgeState.UNKNOWN
    severed = truth[crossing]
    return {
        "severed": int(severed.sum()),
        "connected": int((~severed).sum()),
        "severed_called_severed": int((severed & called).sum()),
        "connected_called_severed": int((~severed & called).sum()),
        "severed_unknown": int((severed & unknown).sum()),
        "connected_unknown": int((~severed & unknown).sum()),
    }


def rest_coordinates(bench: StubBench, pixels: Array) -> Array:
    """Rest coordinates (N, 2) [m] of the tissue at `pixels` (N, 2) now: what is seen there, or what a tool hides; beside a gap its lip.

    A keypoint under a tool is a point of the tissue all the same, and on its own side of the goal.
    """
    surface, camera = bench.surface(), bench.endoscope.camera
    positions, triangles = surface.positions.astype(np.float64), surface.triangles
    rendering = bench.endoscope.rendering()
    nearest = np.clip(np.rint(pixels).astype(np.int64), 0, [camera.width - 1, camera.height - 1])
    # Without the tools: rays onto the tissue's upper face, half a thickness above the mesh.
    beneath = raycast(pixels, positions + surface.thickness / 2 * _normals(positions, triangles), triangles, camera)
    rest = np.full((len(pixels), 2), np.nan)
    hidden = (rendering.label[nearest[:, 1], nearest[:, 0]] == Label.TOOL) & beneath.on_mesh
    corners = triangles[beneath.triangle[hidden]]
    rest[hidden] = (beneath.barycentric[hidden][:, :, None] * surface.rest[corners]).sum(axis=1)
    v, u = np.nonzero(rendering.triangle >= 0)
    _, closest = cKDTree(np.column_stack([u, v])).query(pixels[~hidden])
    at = np.column_stack([u, v])[closest]
    corners = triangles[rendering.triangle[at[:, 1], at[:, 0]]]
    points = camera.unproject(at.astype(float), rendering.depth[at[:, 1], at[:, 0]].astype(np.float64))
    weights = _barycentric(points, positions[corners])
    rest[~hidden] = (weights[:, :, None] * surface.rest[corners]).sum(axis=1)
    return rest


def _normals(positions: Array, triangles: NDArray[np.int32]) -> Array:
    """Unit normals (V, 3) of the sheet towards the camera."""
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    face = np.cross(b - a, c - a)
    normals = np.zeros_like(positions)
    for k in range(3):
        np.add.at(normals, triangles[:, k], face)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return np.asarray(np.where((normals * positions).sum(axis=1, keepdims=True) > 0, -normals, normals))


def _barycentric(points: Array, corners: Array) -> Array:
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    u, v, w = b - a, c - a, points - a
    uu, vv, uv, uw, vw = ((p * q).sum(1) for p, q in ((u, u), (v, v), (u, v), (u, w), (v, w)))
    determinant = np.maximum(uu * vv - uv * uv, 1e-30)
    s, t = (vv * uw - uv * vw) / determinant, (uu * vw - uv * uw) / determinant
    weights = np.clip(np.column_stack([1.0 - s - t, s, t]), 0.0, 1.0)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))


def _stretch(line: Array, a: float, b: float) -> Array:
    """The part of the polyline `line` (M, 2) from share `a` to `b` of its length."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    at = np.unique(np.concatenate([np.linspace(a, b, 12), (arc / arc[-1])[(arc / arc[-1] > a) & (arc / arc[-1] < b)]])) * arc[-1]
    return np.column_stack([np.interp(at, arc, line[:, k]) for k in (0, 1)])


def _run(bench: StubBench, steps: Steps[T], skills: SessionSkills, watch: _Watch, tracking: bool = True) -> T:
    """Run a skill to its end, a tick at a time, tracking beside it."""
    beside = skills.track() if tracking else None
    until = bench.now() + LONGEST
    while bench.now() < until:
        try:
            next(steps)
        except StopIteration as end:
            outcome: T = end.value
            return outcome
        if beside is not None:
            next(beside)
        watch.after_tick()
        bench.advance(TICK)
    raise RuntimeError(f"a skill took longer than {LONGEST:.0f} s of bench time")
