"""`dissect run`: one recorded, shown and judged session on the stub bench, from a goal to a report."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from behaviours.proposal import Approver
from behaviours.session_outcome import SessionOutcome
from hardware.codes import Code
from hardware.stub.bench import StubBench
from hardware.stub.scene import Scene
from skills.scene.goal import Goal, load_goal, validate_goal
from skills.scene.tissue import tissue_mask, tissue_outline
from skills.tracking.choose import make_tracker
from supervisor import topics
from supervisor.choices import Choices
from supervisor.doctor import versions
from supervisor.experiments.evaluator import evaluate
from supervisor.record import Recorder
from supervisor.report import write_report
from supervisor.session import Session, SessionSetup
from supervisor.skillset import SkillConfig
from supervisor.stub_goal import drawn_goal
from supervisor.view_rerun import RerunView
from supervisor.views import View

MESH_PERIOD = 0.5  # [s] between meshes for Rerun


@dataclass(frozen=True)
class RunResult:
    """What `dissect run` gives back; lengths [m], `record` the session's folder."""

    outcome: str
    code: str
    message: str
    attempts: int
    attachments: int
    length_deviation_m: float
    success: bool
    seed: int
    scene: str
    agent: str
    exposure: str
    device: str
    limits: dict[str, Any]
    record: str
    wall_s: float


@dataclass(frozen=True)
class RunOptions:
    """The choices of one run."""

    scene: Scene
    goal_file: Path | None
    agent: str
    attempts: int
    feedback: bool
    seed: int
    record: Path
    in_real_time: bool  # an operator is asked: bench time must not run away while they think
    choices: Choices = field(default_factory=Choices)


def prepare(options: RunOptions) -> tuple[StubBench, Goal]:
    """The bench and the checked goal; nothing has moved and nothing is recorded yet.

    Raises:
        InputError: the goal cannot be used on this scene, or something chosen cannot be had here.
    """
    make_tracker(options.choices.skills().choice)
    bench = StubBench(options.scene, options.seed)
    goal = drawn_goal(bench) if options.goal_file is None else load_goal(options.goal_file)
    camera = bench.endoscope.camera
    tissue = tissue_outline(tissue_mask(bench.endoscope.left().image))
    validate_goal(goal, (camera.width, camera.height), tissue)
    return bench, goal


def run(
    options: RunOptions,
    bench: StubBench,
    goal: Goal,
    approver: Approver,
    views: Sequence[View] = (),
    rerun: RerunView | None = None,
) -> RunResult:
    """Run the session to its end, close the record, write the report.

    Raises:
        InputError: the record cannot be made.
        KeyboardInterrupt: after the arms hold, and the record and the report are written.
    """
    started = time.monotonic()
    setup = SessionSetup(goal, options.seed, options.attempts, options.feedback, skills=options.choices.skills())
    recorder = Recorder(options.record, header(options, setup))
    if rerun is not None:
        bench.observe(_mesh_feed(bench, rerun))

    def judge(attempt: int) -> None:
        recorder.write(topics.TRUTH, bench.now(), evaluate(bench, attempt).as_dict())

    pace = time.sleep if options.in_real_time else (lambda duration: None)
    session = Session(bench, setup, approver, recorder, (*views, *([] if rerun is None else [rerun])), judge, pace)
    outcome = SessionOutcome(Code.INTERNAL_ERROR, "the session ended with an error")
    try:
        outcome = session.run()
    except KeyboardInterrupt:
        outcome = SessionOutcome(Code.ABORTED, "the session was interrupted by the user")
        raise
    finally:
        result = _result(options, setup, bench, session, outcome, time.monotonic() - started)
        recorder.image(topics.ENDOSCOPE, bench.now(), bench.endoscope.left().image)
        recorder.close(dataclasses.asdict(result) | {"record": ""})
        write_report(options.record)
        for view in views:
            view.close()
        if rerun is not None:
            rerun.close()
    return result


def header(options: RunOptions, setup: SessionSetup) -> dict[str, Any]:
    """What `session.json` says about the session before it begins; no personal path, no host name."""
    return {
        "bench": "stub",
        "scene": options.scene.name,
        "agent": options.agent,
        "exposure": setup.skills.exposure.value,
        "rule": setup.skills.rule.value,
        "cover": setup.skills.replan.cover,
        "tracker": Path(setup.skills.choice.kind).name,
        "device": setup.skills.optimal.device,
        "seed": options.seed,
        "feedback": options.feedback,
        "attempts": options.attempts,
        "goal": {"polyline": setup.goal.polyline.tolist(), "grasp": setup.goal.grasp.tolist()},
        "limits": dataclasses.asdict(setup.limits),
        "configuration": {"skills": _without_paths(setup.skills), "scene": dataclasses.asdict(options.scene)},
        "calibration": setup.calibration,
        "versions": versions(),
    }


def _without_paths(skills: SkillConfig) -> dict[str, Any]:
    """The settings of the skills; of the user's files only the names."""
    weights = skills.choice.weights
    told = dataclasses.replace(
        skills.choice, kind=Path(skills.choice.kind).name, weights=None if weights is None else Path(weights).name
    )
    return dataclasses.asdict(dataclasses.replace(skills, choice=told))


def exit_status(outcome: str) -> int:
    """0 complete, 1 incomplete or failed, 3 tripped or aborted."""
    if outcome == Code.COMPLETE:
        return 0
    latched = (Code.EMERGENCY_STOP, Code.ARM_FAULT, Code.TENSION_ABORT, Code.RECORDER_FAILED, Code.TRIPPED, Code.ABORTED)
    return 3 if outcome in latched else 1


def _result(
    options: RunOptions, setup: SessionSetup, bench: StubBench, session: Session, outcome: SessionOutcome, wall_s: float
) -> RunResult:
    truth = evaluate(bench, session.attempts).truth
    return RunResult(
        outcome=_verdict(outcome),
        code=outcome.code.value,
        message=outcome.message,
        attempts=session.attempts,
        attachments=truth.attachments,
        length_deviation_m=truth.length_deviation,
        success=truth.success,
        seed=options.seed,
        scene=options.scene.name,
        agent=options.agent,
        exposure=setup.skills.exposure.value,
        device=setup.skills.optimal.device,
        limits=dataclasses.asdict(setup.limits),
        record=str(options.record),
        wall_s=wall_s,
    )


def _verdict(outcome: SessionOutcome) -> str:
    """One word for the outcome: complete, incomplete, unverified or stopped."""
    if outcome.code is Code.UNVERIFIED:
        return "unverified"
    return {0: "complete", 1: "incomplete", 3: "stopped"}[exit_status(outcome.code)]


def _mesh_feed(bench: StubBench, rerun: RerunView) -> Callable[[], None]:
    """Gives Rerun the tissue's surface now and then."""
    due = [0.0]

    def feed() -> None:
        if bench.now() >= due[0]:
            due[0] = bench.now() + MESH_PERIOD
            surface = bench.surface()
            rerun.mesh(np.asarray(surface.positions), np.asarray(surface.triangles))

    return feed
