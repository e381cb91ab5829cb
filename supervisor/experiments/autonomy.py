"""The paper's third experiment: how far a dissection agent gets by itself, with and without feedback, judged by the mesh's truth.

Each trial is a session on the stub with a seed of its own. Trials are independent, run on all cores, and are kept in a journal as they
end, so that an interrupted experiment goes on where it was.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any

from hardware.codes import Code
from hardware.stub.bench import StubBench
from hardware.stub.scene import load_scene
from skills.expose.optimal import OptimalConfig
from supervisor.approvers import AutoApprover
from supervisor.experiments import pool
from supervisor.experiments.evaluator import evaluate
from supervisor.experiments.journal import Journal
from supervisor.experiments.statistics import mean_sd, wilson
from supervisor.session import Session, SessionSetup
from supervisor.skillset import ExposureKind, SkillConfig
from supervisor.stub_goal import drawn_goal


@dataclass(frozen=True)
class AutonomySettings:
    """One condition of the experiment; trial i runs with seed `seed` + i."""

    scene: str = "silicone"
    agent: str = "planning"
    feedback: bool = True
    attempts: int = 3
    trials: int = 40
    seed: int = 0
    expose: str = "optimal"


def run_trial(settings: AutonomySettings, seed: int) -> dict[str, Any]:
    """One session, judged after every attempt; plain values."""
    started = monotonic()
    bench = StubBench(load_scene(settings.scene), seed)
    # One thread for each trial: the trials themselves fill the cores.
    skills = SkillConfig(exposure=ExposureKind(settings.expose), optimal=OptimalConfig(threads=1))
    setup = SessionSetup(drawn_goal(bench), seed, settings.attempts, settings.feedback, skills=skills)
    per_attempt: list[dict[str, Any]] = []
    session = Session(bench, setup, AutoApprover(), after_attempt=lambda n: per_attempt.append(evaluate(bench, n).as_dict()))
    outcome = session.run()
    final = evaluate(bench, session.attempts).as_dict()
    return {
        "seed": seed,
        "outcome": outcome.code.value,
        "message": outcome.message,
        "attempts": session.attempts,
        "success": final["success"],
        "attachments": final["attachments"],
        "length_deviation_m": final["length_deviation_m"],
        "false_done": outcome.code is Code.COMPLETE and final["attachments"] > 0,
        "tears": final["tears"],
        "bed_contact_m": final["bed_contact_m"],
        "per_attempt": per_attempt,
        "bench_s": bench.now(),
        "wall_s": monotonic() - started,
    }


def run_experiment(
    settings: AutonomySettings,
    journal: Path,
    workers: int | None = None,
    progress: Callable[[dict[str, Any]], None] = lambda trial: None,
) -> dict[str, Any]:
    """Run what the journal does not hold yet, then summarise.

    Raises:
        KeyboardInterrupt: the trials that ended are in the journal; the same call goes on after them.
    """
    started = monotonic()
    seeds = range(settings.seed, settings.seed + settings.trials)
    kept = Journal(journal, _condition(settings))
    done = {trial["seed"]: trial for trial in kept.read() if trial["seed"] in seeds}
    for trial in done.values():
        progress(trial)
    with closing(_trials(settings, [seed for seed in seeds if seed not in done], workers)) as ended:
        for trial in ended:
            done[trial["seed"]] = trial
            kept.keep(trial)
            progress(trial)
    trials = [done[seed] for seed in seeds]
    return summary(settings, trials, monotonic() - started)


def summary(settings: AutonomySettings, trials: list[dict[str, Any]], wall_s: float) -> dict[str, Any]:
    """The experiment's figures from its trials."""
    successes = sum(bool(trial["success"]) for trial in trials)
    attachments = [trial["attachments"] for trial in trials]
    return {
        "experiment": "autonomy",
        **asdict(settings),
        "success_rate": successes / len(trials),
        "success_ci95": wilson(successes, len(trials)),
        "length_deviation_m": mean_sd([trial["length_deviation_m"] for trial in trials]),
        "attachments": {"total": sum(attachments), "mean": sum(attachments) / len(trials)},
        "effective_cut_ratio": _per_attempt(settings, trials, "effective_cut_ratio"),
        "excessive_cut_ratio": _per_attempt(settings, trials, "excessive_cut_ratio"),
        "attachments_per_attempt": _per_attempt(settings, trials, "attachments"),
        "false_done_rate": sum(bool(trial["false_done"]) for trial in trials) / len(trials),
        "outcomes": {code: sum(trial["outcome"] == code for trial in trials) for code in sorted({t["outcome"] for t in trials})},
        "wall_s": wall_s,
        "per_trial": trials,
    }


def _trials(settings: AutonomySettings, seeds: list[int], workers: int | None) -> Generator[dict[str, Any], None, None]:
    """Results as they come."""
    yield from pool.results(partial(run_trial, settings), seeds, workers)


def _condition(settings: AutonomySettings) -> dict[str, Any]:
    """What must agree for a trial of the journal to be used again."""
    condition = asdict(settings)
    del condition["trials"], condition["seed"]
    return condition


def _per_attempt(settings: AutonomySettings, trials: list[dict[str, Any]], key: str) -> list[float]:
    """Mean over trials after each attempt; a trial that ended earlier keeps its last value."""
    means = []
    for number in range(settings.attempts):
        values = [
            trial["per_attempt"][min(number, len(trial["per_attempt"]) - 1)][key] for trial in trials if trial["per_attempt"]
        ]
        means.append(sum(values) / len(values) if values else float("nan"))
    return means
