"""A whole session to be disturbed: tree, guards, recorder and the real skills, which see, track, cut, pull and judge, over the served stub.

It is the session of `dissect run`, on a small sheet, with everything on a graph within one process. The light session of `faults_stand`
makes the same motions in a fraction of the time. This one shows that they are the same, what is recorded, and how a session ends.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar, cast

import py_trees

from behaviours.session_outcome import SessionOutcome
from hardware.codes import Code
from hardware.dvrk.config import SpeedConfig
from hardware.gate import Decision
from hardware.interface import CUTTER, GRASPER
from hardware.served.faults import Fault as Served
from hardware.served.node import Serving
from hardware.stub.scene import Scene, load_scene
from hardware.stub.truth import measure
from skills.estimate.graph import ConnectivityGraph
from skills.skill import Progress, Steps
from supervisor import topics
from supervisor.approvers import AutoApprover
from supervisor.experiments.faults_cases import Fault, Moment, Moments, Phase
from supervisor.experiments.faults_split import branch
from supervisor.experiments.faults_stand import Watched
from supervisor.experiments.faults_watch import GOES_ON, PATIENT, Patience, Row, Story, lead, watch
from supervisor.reading import read
from supervisor.record import MCAP_FILE, Recorder
from supervisor.robot import fitted
from supervisor.session import TICK, Session, SessionSetup
from supervisor.skillset import ExposureKind, SkillConfig
from supervisor.status import StatusWriter

T = TypeVar("T")

PICTURES = 10.0  # [Hz]; to draw them takes most of the time
SEED = 4
ATTEMPTS = 2
FAST = SpeedConfig(ratio=0.3, linear=0.05, angular=1.5)  # as fast as the configuration of a robot may be
SCISSORS = "CURVED_SCISSORS:400178"  # they open wide: the goal takes two snips
JUDGING = 1.0  # [s] that an estimate takes here: on a robot it is made beside the ticks, and time goes on
FOLLOWED = 90.0  # [s] for a session in which nobody noticed anything to come to its end
ESTIMATING = "estimating what is still attached"
# As `faults_cases.MOMENTS`, in the words of the real skills.
WHOLE_MOMENTS: Moments = {
    Phase.APPROACH: ("lowering the grasper", 0.4, GRASPER),
    Phase.GRASP: ("closing the grasper", 0.4, GRASPER),
    Phase.RETRACT: ("retracting along the goal's normal", 0.4, GRASPER),
    Phase.CUT: ("segment 1 of 1: snip 1", 1.5, CUTTER),
    Phase.EXPOSE: ("exposing: step 3", 0.1, GRASPER),
    Phase.ESTIMATE: (ESTIMATING, 0.3, GRASPER),
}
# While the grasper closes nothing is held that could be lost: it is a moment later.
LATER: Mapping[tuple[Fault, Phase], Moment] = {(Served.JAW_SLIPS, Phase.GRASP): ("testing the grasp", 0.0, GRASPER)}


@dataclass(frozen=True)
class SessionRow(Row):
    """As `Row`, and what the record of the session says, read back from its file.

    `recorded`: the code of the outcome. `closed`: the record was closed as it should be. `coded`: where the code that was noticed first
    stands in it, by topic. `exposures`: why each pull that ended later had ended. `attachments`: strands that truly bridge the goal now.
    """

    recorded: str
    closed: bool
    coded: tuple[str, ...]
    exposures: tuple[str, ...]
    attachments: int


def small_scene() -> Scene:
    """A small, coarse sheet of silicone with a goal of 6 mm, arms without calibration error."""
    loaded = load_scene("silicone")
    tissue = replace(loaded.tissue, width=0.056, height=0.050, fine_spacing=2e-3, coarse_spacing=5e-3, puncture_variation=0.0)
    goal = replace(loaded.goal, line=((-0.003, 0.0), (0.003, 0.0)), grasp=(0.0, 0.008))
    return replace(loaded, tissue=tissue, goal=goal, arms=replace(loaded.arms, bias=0.0))


class Split(Recorder):
    """A record that a branch of the session goes on with in a copy; it remembers what it was told of decisions and interruptions."""

    def __init__(self, folder: Path, header: dict[str, Any]) -> None:
        self.decisions: list[Decision] = []
        self.notes: list[tuple[float, str, dict[str, Any]]] = []
        super().__init__(folder, header)

    def decision(self, decision: Decision) -> None:
        """Remember it, and record it."""
        self.decisions.append(decision)
        super().decision(decision)

    def write(self, topic: str, stamp: float, payload: Any) -> None:
        """Remember an interruption, and record what is told."""
        if topic.strip("/") == topics.INTERRUPTION.strip("/"):
            self.notes.append((stamp, topic.strip("/"), payload))
        super().write(topic, stamp, payload)

    def move(self, folder: Path) -> None:
        """Leave the file to others, and go on in a copy."""
        self.flush()
        self._file.flush()
        shutil.copytree(self._folder, folder)
        with (folder / MCAP_FILE).open("r+b") as copy:
            copy.seek(0, os.SEEK_END)
            os.dup2(copy.fileno(), self._file.fileno())
        self._folder, self._status = folder, StatusWriter(folder)


class WholeStand(Watched):
    """One session, recorded into `folder`. `play` runs it beside a story, which goes on by one step after each tick."""

    def __init__(self, folder: Path, shown: Scene | None = None) -> None:
        super().__init__(folder / "site", shown or small_scene(), False, Serving(pictures=PICTURES), SCISSORS, FAST)
        skills = fitted(SkillConfig(exposure=ExposureKind.GOAL_NORMAL), self.config)
        setup = SessionSetup(self.goal, SEED, ATTEMPTS, skills=skills, calibration="hand-eye of the served stub")
        self.record = Split(folder / "record", {"bench": "dvrk", "seed": SEED, "skills": asdict(skills)})
        self.decisions, self.notes = self.record.decisions, self.record.notes
        self._story: Story[Any] | None = None
        self._told: list[Any] = []
        self._doing = ("", 0.0)
        self.session = Session(self.bench, setup, AutoApprover(), self.record, pace=self._after_tick)
        self.gate = self.session.gate
        judge = self.session.skills.estimate
        self.session.skills.estimate = lambda: self._unhurried(judge())  # type: ignore[method-assign]

    @property
    def doing(self) -> tuple[str, float]:
        """As the tree says."""
        return self._doing

    @property
    def begun(self) -> int:
        """As many as there were leases."""
        self.lease()
        return len(self._leases)

    @property
    def ended(self) -> bool:
        """Whether the tree has come to its end."""
        return self.session.root.status not in (py_trees.common.Status.RUNNING, py_trees.common.Status.INVALID)

    def play(self, story: Story[T]) -> tuple[T, SessionOutcome]:
        """Run the session until the story ends, as if the user interrupted it then, or by itself; the record is closed."""
        self._story, self._told = story, []
        self._go_on()  # up to its first tick
        try:
            outcome = self.session.run()
        except KeyboardInterrupt:
            if not self._told:
                raise  # a real one
            outcome = SessionOutcome(Code.ABORTED, "the session was interrupted: enough was seen")
        while not self._told:  # the session is over, its bench closed; only time goes on
            self._let_pass(TICK)
            self._go_on()
        self.record.close({"code": outcome.code.value, "message": outcome.message, "attempts": self.session.attempts})
        return cast(T, self._told[0]), outcome

    # ------------------------------------------------------------ inside

    def _after_tick(self, duration: float) -> None:
        self.lease()  # each gets its number
        tip = next((one for one in reversed(list(self.session.root.iterate())) if _runs(one)), None)
        message = "" if tip is None else tip.feedback_message
        if message != self._doing[0]:
            self._doing = (message, self.now())
        self._go_on()
        if self._told:
            raise KeyboardInterrupt

    def _unhurried(self, judge: Steps[ConnectivityGraph]) -> Steps[ConnectivityGraph]:
        until = self.now() + JUDGING
        while self.now() < until:
            yield Progress(ESTIMATING)
        return (yield from judge)

    def _go_on(self) -> None:
        assert self._story is not None
        try:
            next(self._story)
        except StopIteration as ended:
            self._told.append(ended.value)


def run_whole(
    cases: Iterable[tuple[Fault, Phase]],
    folder: Path,
    tell: Callable[[SessionRow], None],
    patience: Patience = PATIENT,
) -> None:
    """Lead one session from phase to phase, and let each fault befall a copy of it; `tell` is given what became of each."""
    wanted = list(cases)
    stand = WholeStand(folder)

    def story() -> Story[None]:
        for phase in Phase:
            faults = [fault for fault, at in wanted if at is phase]
            if not faults:
                continue
            for fault in sorted(faults, key=lambda one: (one, phase) in LATER):
                yield from lead(stand, phase, moments_of(fault, phase))
                disturbed = partial(_disturbed, stand, fault, phase, folder / f"{phase}-{fault}", patience)
                tell(branch(disturbed, stand.threads_before))

    stand.play(story())


def run_alone(fault: Fault, phase: Phase, folder: Path, patience: Patience = PATIENT) -> SessionRow:
    """The same for one case, with a session of its own that is never split."""
    stand = WholeStand(folder)

    def story() -> Story[tuple[Row, float]]:
        yield from lead(stand, phase, moments_of(fault, phase))
        at = stand.now()
        return (yield from _watched(stand, fault, phase, patience)), at

    (row, at), _ = stand.play(story())
    return _judged(stand, row, at)


def _disturbed(stand: WholeStand, fault: Fault, phase: Phase, folder: Path, patience: Patience) -> SessionRow:
    stand.record.move(folder)
    at = stand.now()
    row, _ = stand.play(_watched(stand, fault, phase, patience))
    return _judged(stand, row, at)


def _watched(stand: WholeStand, fault: Fault, phase: Phase, patience: Patience) -> Story[Row]:
    """As `watch`; a session that goes on is followed to its end, so that it tells what came of it."""
    row = yield from watch(stand, fault, phase, patience)
    goes_on, until = row.noticed is None or row.outcome.startswith(GOES_ON), stand.now() + FOLLOWED
    while goes_on and not stand.ended and stand.now() < until:
        yield
    return row


def _judged(stand: WholeStand, row: Row, at: float) -> SessionRow:
    """What became of it, with what the file says."""
    record = read(stand.record.folder)
    coded = tuple(
        topic
        for topic, entries in record.messages.items()
        if row.code and any(one.stamp >= at - 1e-6 and one.payload.get("code") == row.code for one in entries)
    )
    exposures = tuple(
        str(one.payload["stopped_by"] or one.payload["code"]) for one in record.topic(topics.EXPOSED) if one.stamp > at
    )
    left = measure(stand.stub.phantom).attachments
    return SessionRow(
        **vars(row),
        recorded=record.outcome.get("code", ""),
        closed=record.closed,
        coded=coded,
        exposures=exposures,
        attachments=left,
    )


def moments_of(fault: Fault, phase: Phase) -> Moments:
    """The moments of a whole session, where `fault` comes at its own in `phase`."""
    return {**WHOLE_MOMENTS, phase: LATER.get((fault, phase), WHOLE_MOMENTS[phase])}


def _runs(node: py_trees.behaviour.Behaviour) -> bool:
    return not node.children and node.status is py_trees.common.Status.RUNNING
