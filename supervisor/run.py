"""`dissect run`: one recorded and shown session, from a goal to a report; on the stub bench, which knows the truth, judged by it.

A session is the same on every bench. What differs stands apart: how a bench is prepared (`prepare` for the stub,
`supervisor.robot` for a dVRK), and who judges the result (`Truth`, on the stub alone).
"""

from __future__ import annotations

import dataclasses
import gc
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from behaviours.proposal import Approver
from behaviours.session_outcome import SessionOutcome
from hardware.codes import LATCHED, Code, InputError
from hardware.dvrk.bench import BenchDVRK
from hardware.interface import Bench
from hardware.stub.bench import StubBench
from hardware.stub.scene import Scene
from skills.scene.goal import Goal, load_goal, validate_goal
from skills.scene.tissue import tissue_mask, tissue_outline
from skills.tracking.choose import make_tracker
from supervisor import topics
from supervisor.choices import Choices
from supervisor.doctor import versions
from supervisor.experiments.evaluator import evaluate
from supervisor.plain import plain
from supervisor.record import Recorder
from supervisor.report import write_report
from supervisor.robot import fitted
from supervisor.session import Session, SessionSetup
from supervisor.skillset import SkillConfig
from supervisor.stub_goal import drawn_goal
from supervisor.view_rerun import RerunView
from supervisor.views import View

MESH_PERIOD = 0.5  # [s] between meshes for Rerun


@dataclass(frozen=True)
class RunResult:
    """What `dissect run` gives back; lengths [m], `record` the session's folder.

    What only the simulated tissue knows (attachments, length deviation, success) is None on a robot; `bench` tells how the robot's
    data came in, and is None on the stub.
    """

    outcome: str
    code: str
    message: str
    attempts: int
    attachments: int | None
    length_deviation_m: float | None
    success: bool | None
    seed: int
    scene: str | None
    agent: str
    exposure: str
    device: str
    limits: dict[str, Any]
    record: str
    wall_s: float
    bench: dict[str, Any] | None = None


@dataclass(frozen=True)
class RunOptions:
    """The choices of one run; `scene` is None on a robot."""

    scene: Scene | None
    goal_file: Path | None
    agent: str
    attempts: int
    feedback: bool
    seed: int
    record: Path
    in_real_time: bool  # an operator is asked: bench time must not run away while they think
    choices: Choices = field(default_factory=Choices)


def prepare(options: RunOptions) -> tuple[StubBench, Goal]:
    """The stub bench and the checked goal; nothing has moved and nothing is recorded yet.

    Raises:
        InputError: the goal cannot be used on this scene, or something chosen cannot be had here.
    """
    make_tracker(options.choices.skills().choice)
    if options.scene is None:
        raise InputError("the stub bench needs a scene")
    bench = StubBench(options.scene, options.seed)
    goal = drawn_goal(bench) if options.goal_file is None else load_goal(options.goal_file)
    check_goal(goal, bench)
    return bench, goal


def prepare_robot(options: RunOptions, bench: BenchDVRK) -> tuple[BenchDVRK, Goal]:
    """The robot's bench, opened, and the goal, checked against what the camera sees; nothing has moved and nothing is recorded yet.

    Raises:
        InputError: the robot is not ready for a session, no goal was given, or it cannot be used on what is seen; the bench is closed.
    """
    try:
        make_tracker(options.choices.skills().choice)
        if options.goal_file is None:
            raise InputError("on a robot the goal is yours to draw: give its file with --goal")
        goal = load_goal(options.goal_file)
        bench.open()
        check_goal(goal, bench)
    except BaseException:
        bench.close()
        raise
    return bench, goal


def check_goal(goal: Goal, bench: Bench) -> None:
    """Hold a goal against the tissue in the newest image.

    Raises:
        InputError: it cannot be used there.
    """
    camera = bench.endoscope.camera
    tissue = tissue_outline(tissue_mask(bench.endoscope.left().image))
    validate_goal(goal, (camera.width, camera.height), tissue)


def run(
    options: RunOptions,
    bench: StubBench | BenchDVRK,
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
    stub = bench if isinstance(bench, StubBench) else None
    setup = _setup(options, bench, goal)
    recorder = Recorder(options.record, header(options, setup, None if isinstance(bench, StubBench) else bench))
    if rerun is not None and stub is not None:
        bench.observe(_mesh_feed(stub, rerun))

    def judge(attempt: int) -> None:
        if isinstance(bench, StubBench):
            recorder.write(topics.TRUTH, bench.now(), evaluate(bench, attempt).as_dict())
        else:
            recorder.write(topics.BENCH, bench.now(), bench.figures())

    # On a robot time goes on by itself: its bench waits, and long computations leave the tick. One worker keeps their order.
    pace = time.sleep if options.in_real_time and stub is not None else (lambda duration: None)
    executor = ThreadPoolExecutor(1, "skills") if stub is None else None
    shown = (*views, *([] if rerun is None else [rerun]))
    session = Session(bench, setup, approver, recorder, shown, judge, pace, executor)
    outcome = SessionOutcome(Code.INTERNAL_ERROR, "the session ended with an error")
    if stub is None:
        gc.freeze()  # as in `stay_prompt`: what was made since then stays, too
    try:
        outcome = session.run()
    except KeyboardInterrupt:
        outcome = SessionOutcome(Code.ABORTED, "the session was interrupted by the user")
        raise
    finally:
        if executor is not None:
            executor.shutdown(wait=False, cancel_futures=True)
        result = _result(options, setup, bench, session, outcome, time.monotonic() - started)
        recorder.image(topics.ENDOSCOPE, bench.now(), bench.endoscope.left().image)
        recorder.close(dataclasses.asdict(result) | {"record": ""})
        write_report(options.record)
        for view in views:
            view.close()
        if rerun is not None:
            rerun.close()
    return result


def _setup(options: RunOptions, bench: StubBench | BenchDVRK, goal: Goal) -> SessionSetup:
    """What the session is to do; on a robot, as far as its instruments can."""
    skills = options.choices.skills()
    if isinstance(bench, StubBench):
        return SessionSetup(goal, options.seed, options.attempts, options.feedback, skills=skills)
    skills = fitted(skills, bench.config)
    limits, calibration = bench.config.limits.limits(), bench.calibration()
    return SessionSetup(
        goal, options.seed, options.attempts, options.feedback, limits=limits, skills=skills, calibration=calibration
    )


def header(options: RunOptions, setup: SessionSetup, robot: BenchDVRK | None = None) -> dict[str, Any]:
    """What `session.json` says about the session before it begins; no personal path, no host name."""
    scene = None if options.scene is None else dataclasses.asdict(options.scene)
    table = {"scene": scene} if robot is None else {"robot": plain(robot.config)}
    return {
        "bench": "stub" if robot is None else "dvrk",
        "scene": None if options.scene is None else options.scene.name,
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
        "configuration": {"skills": _without_paths(setup.skills), **table},
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
    return 3 if outcome in (*LATCHED, Code.TRIPPED, Code.ABORTED) else 1


def _result(
    options: RunOptions,
    setup: SessionSetup,
    bench: StubBench | BenchDVRK,
    session: Session,
    outcome: SessionOutcome,
    wall_s: float,
) -> RunResult:
    truth = evaluate(bench, session.attempts).truth if isinstance(bench, StubBench) else None
    return RunResult(
        outcome=_verdict(outcome),
        code=outcome.code.value,
        message=outcome.message,
        attempts=session.attempts,
        attachments=None if truth is None else truth.attachments,
        length_deviation_m=None if truth is None else truth.length_deviation,
        success=None if truth is None else truth.success,
        seed=options.seed,
        scene=None if options.scene is None else options.scene.name,
        agent=options.agent,
        exposure=setup.skills.exposure.value,
        device=setup.skills.optimal.device,
        limits=dataclasses.asdict(setup.limits),
        record=str(options.record),
        wall_s=wall_s,
        bench=None if isinstance(bench, StubBench) else plain(bench.figures()),
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
