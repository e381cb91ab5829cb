"""The paper's first experiment: how much of the cut the camera sees, and what is judged from it, with and without the controller.

On each seed the same tissue, severed in part, is pulled by each method from the same grasp. The controller pulls twice: all steps, as
the paper's does, for the area that is seen; and with its own rule when to stop, for what is judged connected or severed. Runs are
independent, go on all cores, and are kept in a journal as they end, so that an interrupted experiment goes on where it was.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from time import monotonic
from typing import Any

from hardware.codes import InputError
from hardware.interface import Image
from hardware.stub.bench import StubBench
from hardware.stub.scene import Scene, load_scene
from skills.expose.optimal import OptimalConfig
from skills.expose.planner import Objective, PlannerConfig
from skills.expose.visibility import Expansion
from supervisor.experiments import pool
from supervisor.experiments.exposure_pictures import panel_path, side_by_side, write_panel
from supervisor.experiments.exposure_summary import summary
from supervisor.experiments.exposure_trial import run_trial
from supervisor.experiments.journal import Journal
from supervisor.skillset import ExposureKind, SkillConfig

PICTURED = 3  # the first seeds, of which pictures are made
TILT = (0.0, 65.0)  # [degrees] from the vertical, what a scene's camera may have


@dataclass(frozen=True)
class ExposureSettings:
    """One condition of the experiment; trial i runs with seed `seed` + i. `tilt` [degrees]: view from there, not as the scene says."""

    scene: str = "chicken"
    trials: int = 20
    seed: int = 0
    ablation: bool = False
    tilt: float | None = None

    def __post_init__(self) -> None:
        if self.tilt is not None and not TILT[0] <= self.tilt <= TILT[1]:
            raise InputError(f"a view of {self.tilt:g} degrees lies outside {TILT[0]:g} to {TILT[1]:g} degrees from the vertical")

    def load(self) -> Scene:
        """The scene, with the view angle asked for."""
        scene = load_scene(self.scene)
        return scene if self.tilt is None else replace(scene, camera=replace(scene.camera, tilt_deg=self.tilt))


@dataclass(frozen=True)
class Job:
    """One run: `method` on `seed`; a picture of the end of its pull goes into the folder `pictures`."""

    settings: ExposureSettings
    method: str
    seed: int
    pictures: Path | None


def variants(ablation: bool) -> dict[str, SkillConfig]:
    """Settings of the skills for each run on a seed, by name; the ablations pull all steps, like `optimal_full`."""
    optimal = _optimal(stop_early=True)
    runs = {
        "naive_normal": SkillConfig(exposure=ExposureKind.NAIVE),
        "goal_normal": SkillConfig(exposure=ExposureKind.GOAL_NORMAL),
        "optimal_full": _optimal(),
        "optimal": optimal,
    }
    if not ablation:
        return runs
    planner = optimal.optimal.planner
    mppi = planner.mppi
    paper = replace(planner.visibility, expansion=Expansion.SQUARED)
    return {
        **runs,
        "paper_losses": _optimal(replace(planner, objective=Objective.PAPER, visibility=paper)),
        "no_camera": _optimal(replace(planner, camera=0.0)),
        "no_expanding": _optimal(replace(planner, deform=0.0)),
        "no_smoothing": _optimal(replace(planner, smooth=False)),
        "half_samples": _optimal(replace(planner, mppi=replace(mppi, samples=mppi.samples // 2))),
        "horizon_1": _optimal(replace(planner, mppi=replace(mppi, horizon=1))),
    }


def run_job(job: Job) -> dict[str, Any]:
    """One run, judged by the mesh's truth; plain values."""
    newest: Image | None = None

    def look(number: int, bench: StubBench, skills: object) -> None:
        nonlocal newest
        newest = bench.endoscope.left().image

    config = variants(job.settings.ablation)[job.method]
    run = run_trial(job.settings.load(), config, job.seed, look if job.pictures else None)
    if job.pictures is not None and newest is not None:
        write_panel(panel_path(job.pictures, job.seed, job.method), newest)
    return {**run, "method": job.method}


def run_experiment(
    settings: ExposureSettings,
    journal: Path,
    workers: int | None = None,
    progress: Callable[[dict[str, Any]], None] = lambda run: None,
    pictures: Path | None = None,
) -> dict[str, Any]:
    """Run what the journal does not hold yet, then summarise.

    Raises:
        KeyboardInterrupt: the runs that ended are in the journal; the same call goes on after them.
        InputError: the journal or the pictures cannot be written.
    """
    started = monotonic()
    methods = list(variants(settings.ablation))
    seeds = range(settings.seed, settings.seed + settings.trials)
    pictured = {seed: pictures if seed - settings.seed < PICTURED else None for seed in seeds}
    if pictures is not None:
        _make(pictures)
    kept = Journal(journal, _condition(settings))
    done = {}
    for run in kept.read():
        seed, method = run["seed"], run["method"]
        if seed in seeds and method in methods and not _lacks_picture(run, pictured[seed]):
            done[seed, method] = run
    for run in done.values():
        progress(run)
    missing = [(seed, method) for seed in seeds for method in methods if (seed, method) not in done]
    jobs = [Job(settings, method, seed, pictured[seed]) for seed, method in missing]
    with closing(pool.results(run_job, jobs, workers)) as ended:
        for run in ended:
            done[run["seed"], run["method"]] = run
            kept.keep(run)
            progress(run)
    trials = [{method: done[seed, method] for method in methods} for seed in seeds]
    if pictures is not None:
        for trial in trials[:PICTURED]:
            side_by_side(pictures, trial)
    return {
        "experiment": "exposure",
        **{name: getattr(settings, name) for name in ("scene", "trials", "seed", "ablation", "tilt")},
        **summary(trials),
        "wall_s": monotonic() - started,
    }


def _optimal(planner: PlannerConfig | None = None, stop_early: bool = False) -> SkillConfig:
    """The controller on the CPU, so that a seed gives the same figures everywhere, with one thread: the runs themselves fill the cores."""
    config = OptimalConfig(planner=planner or PlannerConfig(), stop_early=stop_early, device="cpu", threads=1)
    return SkillConfig(exposure=ExposureKind.OPTIMAL, optimal=config)


def _condition(settings: ExposureSettings) -> dict[str, Any]:
    """What must agree for a run of the journal to be used again; a scene file may have been edited meanwhile."""
    scene = sha256(repr(settings.load()).encode()).hexdigest()[:16]
    return {"experiment": "exposure", "scene": settings.scene, "tilt": settings.tilt, "scene_hash": scene}


def _lacks_picture(run: dict[str, Any], pictures: Path | None) -> bool:
    """Whether a picture of `run` is wanted and not there; a run that never pulled has none."""
    return pictures is not None and bool(run["curve"]) and not panel_path(pictures, run["seed"], run["method"]).exists()


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"the folder {folder} cannot be made: {error.strerror}") from error
