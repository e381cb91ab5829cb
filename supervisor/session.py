"""One supervised session: tick the tree, let the bench run one tick period, record, show; until the tree has come to its end.

This loop is the only place where time is let pass. On the stub it runs as fast as it can and is repeatable from its seed.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Any

import py_trees

from behaviours import board
from behaviours.proposal import Approver
from behaviours.services import Services
from behaviours.session_outcome import SessionOutcome
from hardware.codes import Code
from hardware.gate import Decision, Limits, SafetyGate
from hardware.interface import Bench
from skills.estimate.stretches import attachments
from skills.expose.optimal import View as ExposureView
from skills.scene.goal import Goal
from skills.skill import ImmediateExecutor
from supervisor.record import Recorder
from supervisor.skillset import SessionSkills, SkillConfig
from supervisor.snapshot import NodeState, TickSnapshot
from supervisor.views import View
from trees.paths import stable_paths
from trees.session import create_root

log = logging.getLogger(__name__)

TICK = 1.0 / 30.0  # [s] of bench time between ticks
LONGEST = 1800.0  # [s] of bench time after which a session is ended, whatever it is doing


@dataclass(frozen=True)
class SessionSetup:
    """What a session is to do, whatever the bench."""

    goal: Goal
    seed: int
    max_attempts: int = 3
    feedback: bool = True
    limits: Limits = field(default_factory=Limits)
    skills: SkillConfig = field(default_factory=SkillConfig)
    calibration: str = "no calibration needed"


class Session:
    """Ticks one tree on one bench. `recorder` and `views` are told every tick; `after_attempt` is called when an attempt has ended.

    Without an `executor` long computations run within the tick: on a robot, where time goes on meanwhile, they must not.
    """

    def __init__(
        self,
        bench: Bench,
        setup: SessionSetup,
        approver: Approver,
        recorder: Recorder | None = None,
        views: Sequence[View] = (),
        after_attempt: Callable[[int], None] = lambda attempt: None,
        pace: Callable[[float], None] = lambda duration: None,
        executor: Executor | None = None,
    ) -> None:
        self.bench = bench
        self.setup = setup
        self._recorder = recorder
        self._views = views
        self._after_attempt = after_attempt
        self._pace = pace
        self._decisions: list[Decision] = []
        self._notes: list[str] = []
        self.gate = SafetyGate(bench, setup.limits, self._decided)
        folder = None if recorder is None else recorder.folder
        self.skills = SessionSkills(
            self.gate, setup.skills, executor or ImmediateExecutor(), setup.seed, setup.calibration, folder
        )
        py_trees.blackboard.Blackboard.clear()
        self.root = create_root(
            Services(
                gate=self.gate,
                skills=self.skills,
                approver=approver,
                goal=setup.goal,
                recorder_fault=lambda: None if recorder is None else recorder.fault(),
                note=self._note,
                max_attempts=setup.max_attempts,
                feedback=setup.feedback,
            )
        )
        self._nodes = [(path, node, path.count("/")) for node, path in stable_paths(self.root).items()]
        self._attempts_ended = 0
        self._shown_frame = -1
        self._shown_exposure: ExposureView | None = None

    def run(self) -> SessionOutcome:
        """Tick until the tree has ended, time has run out or the user interrupts; both arms hold in the end, whatever happened.

        Raises:
            KeyboardInterrupt: after everything was stopped and recorded.
        """
        tick = 0
        try:
            while True:
                self.root.tick_once()
                tick += 1
                self._show(tick)
                self._judge(ended=self.root.status is not py_trees.common.Status.RUNNING)
                if self.root.status is not py_trees.common.Status.RUNNING:
                    return self._outcome()
                if self.bench.now() > LONGEST:
                    return self._stopped(tick, SessionOutcome(Code.ABORTED, f"the session took longer than {LONGEST:.0f} s"))
                self.bench.advance(TICK)
                self._pace(TICK)
        except KeyboardInterrupt:
            self._stopped(tick, SessionOutcome(Code.ABORTED, "the session was interrupted by the user"))
            raise
        finally:
            self.bench.close()

    @property
    def attempts(self) -> int:
        """Attempts begun."""
        return board.read(board.ATTEMPT).number

    def remaining(self) -> int | None:
        """Attachments that the newest estimate found; None before the first."""
        estimate = board.read(board.ESTIMATE)
        return None if estimate is None else len(attachments(estimate.graph))

    # ------------------------------------------------------------ inside

    def _outcome(self) -> SessionOutcome:
        outcome = board.read(board.OUTCOME)
        return outcome or SessionOutcome(Code.INTERNAL_ERROR, "the tree ended without an outcome")

    def _stopped(self, tick: int, outcome: SessionOutcome) -> SessionOutcome:
        """End the tree from outside: leases revoked, arms holding, last states recorded."""
        self.root.stop(py_trees.common.Status.INVALID)
        self._notes.append(outcome.message)
        self._show(tick + 1)
        return outcome

    def _decided(self, decision: Decision) -> None:
        """Recorded before the command is sent: the gate trips if this raises."""
        if self._recorder is not None:
            self._recorder.decision(decision)
        self._decisions.append(decision)

    def _note(self, topic: str, payload: dict[str, Any]) -> None:
        if self._recorder is not None:
            self._recorder.write(topic, self.bench.now(), payload)

    def _judge(self, ended: bool) -> None:
        """Have the attempt that just ended judged from outside."""
        attempt = self.attempts
        finished = attempt if ended else attempt - 1
        while self._attempts_ended < finished:
            self._attempts_ended += 1
            self._after_attempt(self._attempts_ended)

    def _show(self, tick: int) -> None:
        if self._recorder is None and not self._views:
            self._decisions.clear()
            return
        frame = self.skills.frame
        new_frame = frame is not None and frame.sequence != self._shown_frame
        exposure = self.skills.exposure_view
        new_exposure = exposure is not self._shown_exposure
        estimate = board.read(board.ESTIMATE)
        tip = self.root.tip()
        tracked = self.skills.tracked()
        snapshot = TickSnapshot(
            tick=tick,
            stamp=self.bench.now(),
            nodes=tuple(
                NodeState(path, node.name, type(node).__name__, depth, node.status.name, node.feedback_message)
                for path, node, depth in self._nodes
            ),
            attempt=self.attempts,
            max_attempts=self.setup.max_attempts,
            progress="" if tip is None else tip.feedback_message,
            attachments=self.remaining(),
            tension=self.gate.tension(),
            strain=math.nan if tracked is None else tracked.strain,
            tools={name: arm.measured_cp().value for name, arm in self.bench.arms.items()},
            jaws={name: arm.measured_jaw().value for name, arm in self.bench.arms.items()},
            decisions=tuple(self._decisions),
            log=tuple(self._notes),
            frame=frame if new_frame else None,
            tracked=tracked if new_frame else None,
            graph=None if estimate is None else estimate.graph,
            exposure=exposure if new_exposure else None,
        )
        self._decisions.clear()
        self._notes.clear()
        if frame is not None:
            self._shown_frame = frame.sequence
        self._shown_exposure = exposure
        if self._recorder is not None:
            self._recorder.snapshot(snapshot)
        for view in self._views:
            view.update(snapshot)
