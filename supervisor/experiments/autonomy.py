"""The paper's third experiment: how far a dissection agent gets by itself, with and without feedback, judged by the mesh's truth.

Each trial is a session on the stub with a seed of its own. Trials are independent, run on all cores, and are kept in a journal as they
end, so that an interrupted experiment goes on where it was.
"""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import asdict, dataclass
from functools import cache
from hashlib import sha256
from multiprocessing import get_context
from pathlib import Path
from time import monotonic
from typing import Any

from hardware.codes import Code
from hardware.stub.bench import StubBench
from hardware.stub.scene import load_scene
from supervisor.approvers import AutoApprover
from supervisor.experiments.evaluator import evaluate
from supervisor.experiments.statistics import mean_sd, wilson
from supervisor.session import Session, SessionSetup
from supervisor.stub_goal import drawn_goal

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class AutonomySettings:
    """One condition of the experiment; trial i runs with seed `seed` + i."""

    scene: str = "silicone"
    agent: str = "planning"
    feedback: bool = True
    attempts: int = 3
    trials: int = 40
    seed: int = 0


def run_trial(settings: AutonomySettings, seed: int) -> dict[str, Any]:
    """One session, judged after every attempt; plain values."""
    started = monotonic()
    bench = StubBench(load_scene(settings.scene), seed)
    setup = SessionSetup(drawn_goal(bench), seed, settings.attempts, settings.feedback)
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
    done = _read_journal(journal, settings)
    for trial in done.values():
        progress(trial)
    missing = [settings.seed + i for i in range(settings.trials) if settings.seed + i not in done]
    workers = workers or os.cpu_count() or 1
    with journal.open("a", encoding="utf-8") as file:
        for trial in _trials(settings, missing, workers):
            done[trial["seed"]] = trial
            file.write(json.dumps({"settings": _identity(settings), "trial": trial}) + "\n")
            file.flush()
            progress(trial)
    trials = [done[settings.seed + i] for i in range(settings.trials)]
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


def _trials(settings: AutonomySettings, seeds: list[int], workers: int) -> Any:
    """Results as they come; on an interrupt nothing new is begun."""
    if not seeds:
        return
    # Spawned, not forked: a forked child would share the state of Warp's and OpenCV's threads.
    pool = ProcessPoolExecutor(min(workers, len(seeds)), mp_context=get_context("spawn"), initializer=_prepare_worker)
    pending: set[Future[dict[str, Any]]] = {pool.submit(run_trial, settings, seed) for seed in seeds}
    try:
        while pending:
            ended, pending = wait(pending, return_when=FIRST_COMPLETED)
            for future in ended:
                yield future.result()
    finally:
        for process in list(getattr(pool, "_processes", {}).values()) if pending else []:
            process.terminate()
        pool.shutdown(wait=not pending, cancel_futures=True)


def _prepare_worker() -> None:
    """One core for each worker: more threads in each would only get in each other's way."""
    import signal

    import cv2

    from supervisor.warp_start import start_warp

    start_warp()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    cv2.setNumThreads(1)
    logging.disable(logging.WARNING)


def _identity(settings: AutonomySettings) -> dict[str, Any]:
    """What must agree for a trial of the journal to be used again: the condition and the program itself."""
    identity = asdict(settings)
    del identity["trials"], identity["seed"]
    return {**identity, "program": _program()}


@cache
def _program() -> str:
    """A hash over the sources and scenes: a changed program does not go on with another's trials."""
    root = Path(__file__).parents[2]
    rooms = ("hardware", "skills", "behaviours", "trees", "supervisor")
    digest = sha256()
    for path in sorted(path for room in rooms for path in (root / room).rglob("*") if path.suffix in (".py", ".toml")):
        digest.update(path.relative_to(root).as_posix().encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _read_journal(journal: Path, settings: AutonomySettings) -> dict[int, dict[str, Any]]:
    """Trials of the same condition that ended earlier, by seed; a line cut off by a kill is left out."""
    done: dict[int, dict[str, Any]] = {}
    if not journal.exists():
        return done
    for line in journal.read_text(encoding="utf-8").splitlines():
        try:
            entry = json.loads(line)
        except json.JSONDecodeError:
            continue
        if entry.get("settings") == _identity(settings):
            done[entry["trial"]["seed"]] = entry["trial"]
    return done


def _per_attempt(settings: AutonomySettings, trials: list[dict[str, Any]], key: str) -> list[float]:
    """Mean over trials after each attempt; a trial that ended earlier keeps its last value."""
    means = []
    for number in range(settings.attempts):
        values = [
            trial["per_attempt"][min(number, len(trial["per_attempt"]) - 1)][key] for trial in trials if trial["per_attempt"]
        ]
        means.append(sum(values) / len(values) if values else float("nan"))
    return means
