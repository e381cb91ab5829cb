"""One trial of the exposure experiment: a goal severed in part, a grasp off its normal, one method that pulls, judged by the mesh.

The paper's protocol (Evaluation of Exposure Maximization Control): the tissue is dissected beforehand, the controller only exposes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import monotonic
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hardware.gate import Limits, SafetyGate
from hardware.interface import Array
from hardware.stub.bench import StubBench
from hardware.stub.scene import Scene
from hardware.stub.truth import severed_between
from skills.estimate.graph import ConnectivityGraph, EdgeState
from skills.skill import ImmediateExecutor
from supervisor.experiments.dissected import dissected_bench, rest_coordinates
from supervisor.experiments.evaluator import visible_area
from supervisor.experiments.pulling import pull, starting_at
from supervisor.skillset import SessionSkills, SkillConfig

SEVERED = (0.5, 1.0)  # share of the goal that is severed, uniform
GRASP_AWAY = (2e-3, 10e-3)  # [m] of the grasp from the goal, uniform
GRASP_ALONG = 12e-3  # [m] of the grasp along the goal to either side of its middle, uniform
RELAXED = 0.5e-3  # [m]: every pull starts where the jaws closed, not where the test of the grasp ended


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
    """A bench whose tissue was dissected before: cut through along the setting's stretches of the goal."""
    return dissected_bench(scene, [(a, b, 1.0) for a, b in setting.severed], setting.grasp, seed)


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
    # Nothing is cut halfway here, and truth is that of the edge's own line: an opening along it tells that it is severed.
    config = replace(starting_at(config, RELAXED), tracker=replace(config.tracker, between=()))
    refusals: list[str] = []
    gate = SafetyGate(bench, Limits(), lambda decision: None if decision.accepted else refusals.append(decision.code.value))
    skills = SessionSkills(gate, config, ImmediateExecutor(), seed, "no calibration needed", None)
    watch = _Watch(bench, skills, every, look)
    pulled = pull(bench, gate, skills, RELAXED, watch.after_tick)
    outcome = pulled.exposed
    bench.close()
    return {
        "seed": seed,
        "method": config.exposure.value,
        "severed_share": setting.share,
        "grasp_away_m": setting.away,
        "grasp_along_m": setting.along,
        "angle_rad": setting.angle,
        "code": pulled.code.value,
        "message": pulled.message,
        "stopped_by": "" if outcome is None else outcome.stopped_by.value,
        "steps": 0 if outcome is None else len(outcome.path),
        "visible_area_px": visible_area(bench),
        "peak_tension_n": max((s.tension for s in watch.samples), default=0.0),
        "peak_strain": max((s.strain for s in watch.samples), default=0.0),
        "reported_strain": [] if outcome is None else [round(float(v), 4) for v in outcome.strain],
        "torn": bench.phantom.tears,
        "refused": sorted(set(refusals)),
        "tripped": "" if gate.tripped is None else gate.tripped.code.value,
        "judged": {} if pulled.graph is None else watch.judge(pulled.graph),
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
