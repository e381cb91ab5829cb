"""The paper's second experiment: which edges are severed, judged from what the camera saw while an expert pulled, against the mesh.

Each seed is a case: a material, a cut, an expert's pull, a disturbance. Variants (trackers, rules) judge the same cases. Runs are
independent, go on all cores, and are kept in a journal as they end, so that an interrupted experiment goes on where it was.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from time import monotonic
from typing import Any

from hardware.codes import InputError
from hardware.stub.scene import load_scene
from skills.estimate.rule import Rule
from skills.expose.optimal import OptimalConfig
from skills.tracking.choose import TrackerChoice
from supervisor.experiments import pool
from supervisor.experiments.detection_cases import MATERIALS, draw
from supervisor.experiments.detection_summary import rows, summary
from supervisor.experiments.detection_trial import run_case
from supervisor.experiments.journal import Journal
from supervisor.skillset import SkillConfig


@dataclass(frozen=True)
class DetectionSettings:
    """One condition of the experiment; case i has seed `seed` + i. `tracker`, its `weights` and `device` as `--tracker` takes them."""

    cases: int = 50
    seed: int = 0
    tracker: str = "dis"
    weights: Path | None = None
    device: str = "cpu"
    compare: bool = False

    @property
    def main(self) -> str:
        """Name of the variant that the experiment is about; of a file its name alone."""
        return Path(self.tracker).name


@dataclass(frozen=True)
class Job:
    """One run: `variant` on `seed`."""

    settings: DetectionSettings
    variant: str
    seed: int


def variants(settings: DetectionSettings) -> dict[str, SkillConfig]:
    """Settings of the skills for each variant, by name: the experiment's own first, and what it is compared with."""
    runs = {settings.main: configured(settings.tracker, weights=settings.weights, device=settings.device)}
    if settings.compare:
        others = {
            "lk": configured("lk"),
            "dis-chained": configured("dis-chained"),
            "elongation": configured("dis", Rule.ELONGATION),
        }
        runs.update({name: config for name, config in others.items() if name not in runs})
    return runs


def configured(tracker: str, rule: Rule = Rule.LIKELIHOOD, weights: Path | None = None, device: str = "cpu") -> SkillConfig:
    """The session's settings with this tracker and rule; computed with one thread, as the runs themselves fill the cores."""
    choice = TrackerChoice(tracker, None if weights is None else str(weights), device)
    return SkillConfig(rule=rule, choice=choice, optimal=OptimalConfig(device="cpu", threads=1))


def run_job(job: Job) -> dict[str, Any]:
    """One run, judged by the mesh's truth; plain values."""
    return {"variant": job.variant, **run_case(draw(job.seed), variants(job.settings)[job.variant])}


def run_experiment(
    settings: DetectionSettings,
    journal: Path,
    workers: int | None = None,
    progress: Callable[[dict[str, Any]], None] = lambda run: None,
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Run what the journal does not hold yet, then summarise: the figures, and a row for each edge across the goal.

    Raises:
        KeyboardInterrupt: the runs that ended are in the journal; the same call goes on after them.
        InputError: the journal cannot be written, or the weights cannot be read.
    """
    started = monotonic()
    names = list(variants(settings))
    seeds = range(settings.seed, settings.seed + settings.cases)
    kept = Journal(journal, _condition(settings))
    done = {(run["seed"], run["variant"]): run for run in kept.read() if run["seed"] in seeds and run["variant"] in names}
    for run in done.values():
        progress(run)
    jobs = [Job(settings, name, seed) for seed in seeds for name in names if (seed, name) not in done]
    with closing(pool.results(run_job, jobs, workers)) as ended:
        for run in ended:
            done[run["seed"], run["variant"]] = run
            kept.keep(run)
            progress(run)
    figures = {name: summary([done[seed, name] for seed in seeds]) for name in names}
    compared = {name: {key: value for key, value in part.items() if key != "per_case"} for name, part in figures.items()}
    whole = {
        "experiment": "detection",
        "cases": settings.cases,
        "seed": settings.seed,
        "tracker": settings.main,
        **figures[settings.main],
        "variants": compared,
        "wall_s": monotonic() - started,
    }
    return whole, rows([done[seed, name] for name in names for seed in seeds])


def write_rows(path: Path, edges: list[dict[str, Any]]) -> None:
    """Write the rows of edges, one line of JSON each.

    Raises:
        InputError: the file cannot be written.
    """
    try:
        path.write_text("".join(json.dumps(row) + "\n" for row in edges), encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from error


def _condition(settings: DetectionSettings) -> dict[str, Any]:
    """What must agree for a run of the journal to be used again: files of scenes and weights may have been edited meanwhile."""
    scenes = sha256(repr([load_scene(name) for name in (*MATERIALS, "curved")]).encode()).hexdigest()[:16]
    return {"experiment": "detection", "scenes": scenes, "device": settings.device, "weights": _digest(settings)}


def _digest(settings: DetectionSettings) -> str:
    """A hash over the tracker's files, if it has any."""
    digest = sha256()
    for path in (settings.weights, Path(settings.tracker)):
        if path is None or not (path == settings.weights or path.suffix):
            continue
        try:
            digest.update(path.read_bytes())
        except OSError as error:
            raise InputError(f"the tracker's file {path} cannot be read: {error.strerror}") from error
    return digest.hexdigest()[:16]
