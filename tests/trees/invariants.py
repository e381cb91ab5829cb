"""What must hold in every state of a session, whatever the skills, the operator and the bench do."""

from __future__ import annotations

from py_trees.common import Status

from behaviours import board
from behaviours.run_skill import RunSkill
from hardware.codes import Code
from hardware.interface import CUTTER
from tests.mocks.stage import Stage

MOTIONS = ("servo_cp", "move_cp", "move_jaw")


class InvariantError(AssertionError):
    """An invariant does not hold."""


class Invariants:
    """Watches the commands that reach the arms of `stage`; `check` after each tick."""

    def __init__(self, stage: Stage) -> None:
        self.stage = stage
        self.broken: list[str] = []
        self._record = stage.bench.record
        stage.bench.record = self._watch  # type: ignore[method-assign]
        self._succeeded_before = False

    def check(self) -> None:
        """Raise `InvariantError` for the first invariant that does not hold."""
        stage, root, gate = self.stage, self.stage.root, self.stage.gate
        outcome, verdict = board.read(board.OUTCOME), board.read(board.VERDICT)
        procedure = root.children[1]
        running = [node for node in root.iterate() if isinstance(node, RunSkill) and node.status is Status.RUNNING]
        ended = root.status is not Status.RUNNING
        for holds, what in (
            (not self.broken, "; ".join(self.broken)),
            (
                root.status is not Status.SUCCESS or (verdict and verdict.complete and outcome == verdict and not gate.tripped),
                "SUCCESS without a complete goal, or after a trip",
            ),
            (
                board.read(board.ATTEMPT).number <= stage.services.max_attempts,
                "there were more attempts than allowed",
            ),
            (len(stage.skills.opened) <= len(running), "a skill is open whose leaf does not run"),
            (gate.lease is None or any(node.MOVES for node in running), "a lease is alive although no leaf moves the arms"),
            (gate.lease is None or not gate.tripped, "a lease is alive after a trip"),
            (gate.approval is None or not gate.tripped, "an approval is alive after a trip"),
            (not ended or stage.settled(), "the session ended, but something is left over"),
            (not ended or outcome is not None, "the session ended without an outcome"),
            (not (ended and gate.tripped) or (outcome and outcome.code is gate.tripped.code), "the outcome is not the trip's"),
            (
                not ended
                or outcome is None
                or outcome.code is not Code.INTERNAL_ERROR
                or "broke" in outcome.message
                or "tracking ended" in outcome.message,
                f"an internal error that no skill raised: {outcome and outcome.message}",
            ),
            (
                ended or procedure.status is not Status.INVALID or stage.settled(),
                "the procedure was interrupted, but something is left over",
            ),
            (self._plan_is_fresh(), "a plan made before an interruption is being cut"),
        ):
            if not holds:
                raise InvariantError(what)

    def _watch(self, arm: str, name: str, target: object) -> None:
        gate = self.stage.gate
        if name in MOTIONS and gate.lease is None:
            self.broken.append(f"{arm} got {name} without a live lease")
        if name in MOTIONS and gate.tripped:
            self.broken.append(f"{arm} got {name} after a trip")
        closes = arm == CUTTER and name == "move_jaw" and isinstance(target, float) and target < self.stage.bench.cutter.jaw
        if closes and gate.approval is None:
            self.broken.append("the scissors closed without a live approval")
        self._record(arm, name, target)  # type: ignore[arg-type]

    def _plan_is_fresh(self) -> bool:
        dissect = next(node for node in self.stage.root.iterate() if node.name == board.Step.DISSECT)
        plan = board.read(board.PLAN)
        if dissect.status is not Status.RUNNING or not self.stage.skills.segments or self.stage.skills.segments[-1] is None:
            return True
        return plan is not None and plan.interruptions == board.read(board.INTERRUPTIONS)
