"""Ask the operator whether what comes next may be cut, and give the approval to the safety gate.

An approval is bound to its goal, to the frame it was asked on, and to a time limit. If the scene moved or too much time passed
between question and answer, the operator is asked again with what is seen now, a bounded number of times.
"""

from __future__ import annotations

from py_trees.common import Status

from behaviours.board import INTERRUPTIONS, PLAN, TRACKING, Key
from behaviours.leaf import Leaf
from behaviours.proposal import Answer, Proposal, displacement, goal_id
from behaviours.services import Services
from behaviours.to_cut import NO_SEGMENTS, ToCut, to_cut
from hardware.codes import Code
from hardware.gate import Approval


class Approve(Leaf):
    """SUCCESS when approved; FAILURE with NOT_APPROVED, SCENE_MOVED, APPROVAL_EXPIRED or GOAL_LOST.

    The key `granted` keeps what was approved.
    """

    def __init__(self, name: str, services: Services, granted: Key[Proposal | None]) -> None:
        super().__init__(name, services, reads=(INTERRUPTIONS, PLAN, TRACKING), writes=(granted,))
        self._granted = granted
        self._asked: Proposal | None = None
        self._count = 0

    def begin(self) -> None:
        """Forget any older approval; the question itself is asked at the first update."""
        self._asked, self._count = None, 0
        self.gate.withdraw_approval()

    def advance(self) -> Status:
        """Ask, wait, check that the answer still fits the scene."""
        answer = None
        if self._asked is not None:
            answer = self.services.approver.answer()
            if answer is None or answer.goal_id != self._asked.goal_id:
                return self.wait(f"waiting for the operator: {first_line(self._asked.reason)}")
        now = self._now()
        if now is None:
            return self.fail(Code.GOAL_LOST, "the goal cannot be seen, so there is nothing to approve")
        if self._asked is None or answer is None:
            return self._ask(now)
        return self._heard(self._asked, answer, now)

    def end(self, preempted: bool) -> None:
        """Withdraw an open question."""
        if self._asked is not None:
            self._asked = None
            self.services.approver.cancel()

    def _now(self) -> ToCut | None:
        tracked = self.services.skills.tracked() if self.board.get(TRACKING) else None
        return to_cut(self.services.goal, tracked, self.board.get(PLAN), self.board.get(INTERRUPTIONS))

    def _ask(self, now: ToCut, because: str = "") -> Status:
        frame = self.gate.bench.endoscope.left()
        self._asked = Proposal(
            kind="goal" if now.segments is None else "corrective",
            goal_id=goal_id(now.pixels),
            polyline=now.polyline,
            segments=NO_SEGMENTS if now.segments is None else now.segments,
            frame_sequence=frame.sequence,
            stamp=self.gate.bench.now(),
            reason=now.reason + because,
        )
        self._count += 1
        self._tell("asked", self._asked)
        self.services.approver.request(self._asked)
        return self.wait(f"asked the operator: {first_line(self._asked.reason)}")

    def _heard(self, asked: Proposal, answer: Answer, now: ToCut) -> Status:
        if not answer.approved:
            self._tell("refused", asked, by=answer.by, comment=answer.comment)
            return self.fail(
                Code.NOT_APPROVED, f"{answer.by} did not approve" + (f": {answer.comment}" if answer.comment else "")
            )
        stamp, lifetime = self.gate.bench.now(), self.services.approval_lifetime
        if moved := scene_moved(asked, now, self.services.max_displacement):
            return self._again(Code.SCENE_MOVED, moved, asked, now)
        if stamp - asked.stamp > lifetime:
            late = f"the answer came {stamp - asked.stamp:.0f} s after the question, {lifetime:.0f} s are allowed"
            return self._again(Code.APPROVAL_EXPIRED, late, asked, now)
        self._asked = None
        self.gate.approve(Approval(asked.goal_id, answer.by, asked.frame_sequence, stamp, stamp + lifetime))
        self.board.set(self._granted, asked)
        self._tell("approved", asked, by=answer.by, comment=answer.comment)
        return self.succeed(f"approved by {answer.by}")

    def _again(self, code: Code, why: str, asked: Proposal, now: ToCut) -> Status:
        self._tell("void", asked, code=code.value, message=why)
        if self._count >= self.services.max_asks:
            return self.fail(code, f"{why}; the operator was asked {self._count} times")
        return self._ask(now, f" (asked again: {why})")

    def _tell(self, event: str, proposal: Proposal, **more: str) -> None:
        self.services.tell(
            "approval",
            event=event,
            kind=proposal.kind,
            goal_id=proposal.goal_id,
            frame_sequence=proposal.frame_sequence,
            reason=proposal.reason,
            polyline=proposal.polyline.tolist(),
            segments=proposal.segments.tolist(),
            **more,
        )


def scene_moved(asked: Proposal, now: ToCut, limit: float) -> str:
    """Say how far the goal has moved from `asked` if that is beyond `limit` [px] or unknown; empty when it has not."""
    moved = displacement(asked.polyline, now.polyline)
    return "" if moved <= limit else f"the goal has moved by {moved:.0f} px, {limit:.0f} px are allowed"


def first_line(reason: str) -> str:
    """What fits into one line of a status: the operator is asked with all of it."""
    return reason.splitlines()[0] if reason else ""
