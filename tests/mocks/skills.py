"""Scripted skills and a scripted operator: each obeys its protocol and ends as the test says; what ran is kept.

A skill yields once (unless `eager`), so that it takes at least one tick, then asks its script at every advance: `running` goes on
(moving the arms under its lease, cutting if it dissects), `raise` raises, any other word ends it with the outcome of that name.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import TypeVar

import numpy as np

from behaviours.proposal import Answer, Proposal
from hardware.codes import Code
from hardware.gate import Lease
from hardware.interface import CUTTER, GRASPER, Array
from skills.checklist_outcome import CheckOutcome
from skills.dissect.outcome import DissectOutcome
from skills.estimate.graph import ConnectivityGraph, EdgeState
from skills.expose.outcome import ExposeOutcome
from skills.replan.next_goal import NextGoal
from skills.retreat_outcome import RetreatOutcome
from skills.scene.goal import Goal
from skills.skill import Progress, Steps
from skills.tracking.outcome import TrackOutcome
from skills.tracking.tracks import TrackedGoal

T = TypeVar("T")
Choose = Callable[[str, tuple[str, ...]], str]

GOAL = Goal(np.array([[200.0, 240.0], [300.0, 240.0], [400.0, 240.0]]), np.array([300.0, 180.0]), (640, 480))
SEGMENTS = np.array([[[240.0, 235.0], [260.0, 245.0]]])


def script(**words: str | list[str]) -> Choose:
    """Make a script of `step="word"` (always) or `step=["word", ...]` (in turn, the last for ever); what is not named ends well.

    Tracking, which is not to end, goes on unless it is named.
    """
    queues = {step: [word] if isinstance(word, str) else list(word) for step, word in words.items()}

    def choose(step: str, options: tuple[str, ...]) -> str:
        queue = queues.get(step, ["running"] if step == "track" else None)
        if queue:
            return queue.pop(0) if len(queue) > 1 else queue[0]
        return next(word for word in options if word not in ("running", "raise", "wait"))

    return choose


class ScriptedSkills:
    """A `SkillSet` whose outcomes `choose(step, options)` picks. `opened` are the generators that run; `shift` moves the goal [px]."""

    def __init__(self, choose: Choose) -> None:
        self.choose = choose
        self.opened: list[str] = []
        self.begun: list[str] = []
        self.segments: list[Array | None] = []
        self.shift = 0.0
        self.lost = False
        self.following = False
        self.eager = False

    def checklist(self) -> Steps[CheckOutcome]:
        """End with `ok` or `failed`."""
        return self._run(
            "checklist",
            {
                "ok": lambda: CheckOutcome(Code.OK, "all is ready", ("arms", "camera")),
                "failed": lambda: CheckOutcome(Code.CHECKLIST, "the calibration is too old"),
            },
        )

    def start_tracking(self, goal: Goal) -> Steps[TrackOutcome]:
        """End with `ok` or `failed`."""
        outcome = yield from self._run(
            "start_tracking",
            {
                "ok": lambda: TrackOutcome(Code.OK, "following the goal"),
                "failed": lambda: TrackOutcome(Code.GOAL_LOST, "the goal is not seen"),
            },
        )
        self.following = outcome.code is Code.OK
        return outcome

    def track(self) -> Steps[None]:
        """Go on for ever, `raise`, or end with `ended`."""
        return self._run("track", {"ended": lambda: None})

    def tracked(self) -> TrackedGoal | None:
        """Give the goal, shifted to the right by `shift`."""
        return goal_seen(self.shift, self.lost) if self.following else None

    def dissect(self, lease: Lease, segments: Array | None) -> Steps[DissectOutcome]:
        """End with `ok`, or with a code for which one looks, tries again, or ends."""
        self.segments.append(segments)
        codes = {"ok": Code.OK, "look": Code.MOVE_TIMEOUT, "retry": Code.GRASP_EMPTY, "end": Code.BAD_INPUT}
        return self._run("dissect", {w: partial(DissectOutcome, c, f"dissect: {c}", ()) for w, c in codes.items()}, lease)

    def expose(self, lease: Lease) -> Steps[ExposeOutcome]:
        """End with `ok`, or with a code for which one looks again, tries again, or ends."""
        codes = {"ok": Code.OK, "look": Code.GOAL_LOST, "retry": Code.GRASP_SLIPPED, "end": Code.BAD_INPUT}
        none = np.zeros(0)

        def outcome(code: Code) -> ExposeOutcome:
            return ExposeOutcome(code, f"expose: {code}", Code.EXPOSURE_STEPS_DONE, np.zeros((0, 3)), none, none, none)

        return self._run("expose", {w: partial(outcome, c) for w, c in codes.items()}, lease)

    def estimate(self) -> Steps[ConnectivityGraph]:
        """End with `complete`, `incomplete`, or a code for which one looks again or ends."""
        return self._run(
            "estimate",
            {
                "complete": lambda: graph(EdgeState.SEVERED),
                "incomplete": lambda: graph(EdgeState.CONNECTED),
                "look": lambda: graph(EdgeState.UNKNOWN, Code.TOO_MANY_UNKNOWN),
                "end": lambda: graph(EdgeState.UNKNOWN, Code.BAD_INPUT),
            },
        )

    def replan(self, graph: ConnectivityGraph) -> Steps[NextGoal]:
        """End with `ok`, `empty` or `end`."""
        assert not graph.complete, "replan is for incomplete goals"
        return self._run(
            "replan",
            {
                "ok": lambda: NextGoal(Code.OK, "1 segment to sever 1 attachment", SEGMENTS, ((0,),)),
                "end": lambda: NextGoal(Code.NO_CANDIDATE, "no segment is possible", SEGMENTS[:0], ()),
                "empty": lambda: NextGoal(Code.OK, "nothing is left", SEGMENTS[:0], ()),
            },
        )

    def retreat(self, lease: Lease) -> Steps[RetreatOutcome]:
        """End with `ok` or `end`."""
        codes = {"ok": Code.OK, "end": Code.MOVE_TIMEOUT}
        return self._run("retreat", {w: partial(RetreatOutcome, c, f"retreat: {c}") for w, c in codes.items()}, lease)

    def _run(self, step: str, outcomes: Mapping[str, Callable[[], T]], lease: Lease | None = None) -> Steps[T]:
        self.opened.append(step)
        self.begun.append(step)
        try:
            if not self.eager:
                yield Progress(f"{step} begins")
            while True:
                word = self.choose(step, ("running", *outcomes, "raise"))
                if word == "raise":
                    raise RuntimeError(f"{step} broke")
                if word != "running":
                    return outcomes[word]()
                if lease is not None:
                    self._move(lease, cut=step == "dissect")
                yield Progress(f"{step} goes on", 0.5)
        finally:
            if lease is not None:
                lease.hold()
            self.opened.remove(step)

    def _move(self, lease: Lease, cut: bool) -> None:
        """Open and close the scissors if `cut`, and let the grasper's jaw be where it is."""
        lease.move_jaw(GRASPER, lease.measured_jaw(GRASPER).value)
        if cut:
            lease.move_jaw(CUTTER, 0.8)
            lease.move_jaw(CUTTER, 0.1)


class ScriptedApprover:
    """An `Approver` that answers `yes`, `no`, or waits (`wait`), as `choose("answer", options)` says."""

    def __init__(self, choose: Choose) -> None:
        self.choose = choose
        self.open: Proposal | None = None
        self.asked: list[Proposal] = []

    def request(self, proposal: Proposal) -> None:
        """Keep the question."""
        self.open = proposal
        self.asked.append(proposal)

    def answer(self) -> Answer | None:
        """Answer as scripted."""
        if self.open is None:
            return None
        word = self.choose("answer", ("wait", "yes", "no"))
        if word == "wait":
            return None
        answered, self.open = self.open, None
        return Answer(answered.goal_id, word == "yes", "the operator")

    def cancel(self) -> None:
        """Forget the question."""
        self.open = None


def goal_seen(shift: float = 0.0, lost: bool = False) -> TrackedGoal:
    """Give `GOAL` as tracked, moved to the right by `shift` [px]."""
    line = GOAL.polyline + np.array([shift, 0.0])
    count = len(line)
    up = np.array([0.0, -8.0])
    return TrackedGoal(
        0.0, line, line + up, line - up, np.ones(count, dtype=bool), GOAL.grasp + np.array([shift, 0.0]), True, lost, float("nan")
    )


def graph(state: EdgeState, code: Code = Code.OK) -> ConnectivityGraph:
    """Make a graph of two keypoints joined by one edge in `state` that crosses the goal."""
    points = np.array([[300.0, 232.0], [300.0, 248.0]])
    return ConnectivityGraph(
        code=code,
        message=f"one edge, {state.name.lower()}",
        reference=points,
        points=points,
        edges=np.array([[0, 1]]),
        elongation=np.array([1.0]),
        state=np.array([state]),
        probability=np.array([0.5]),
        crosses_goal=np.array([True]),
        station=np.array([0.5]),
    )
