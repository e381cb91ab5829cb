"""The base of all leaves that run a skill: one generator, advanced once per tick, under a lease if it moves the arms.

At every end, wanted or not: the lease is dead before anything else happens, the gate has told both arms to hold, and the
generator is closed. That they do hold is confirmed before the next skill starts: it waits until no arm is busy.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Generic, TypeVar, cast

from py_trees.common import Status

from behaviours.board import Key, lease_of
from behaviours.leaf import Leaf
from behaviours.services import Services
from hardware.codes import Code
from hardware.gate import Lease
from skills.skill import Outcome, Steps

T = TypeVar("T")


class RunSkill(Leaf, Generic[T]):
    """Runs what `skill` gives; `judge` turns its outcome into SUCCESS for `Code.OK` and FAILURE with the code otherwise."""

    MOVES = False  # whether the skill gets a lease

    def __init__(self, name: str, services: Services, *, reads: Iterable[Key[Any]] = (), writes: Iterable[Key[Any]] = ()) -> None:
        self._leased = lease_of(name)
        super().__init__(name, services, reads=reads, writes=(*writes, self._leased) if self.MOVES else writes)
        self._lease: Lease | None = None
        self._steps: Steps[T] | None = None
        self._since = 0.0
        self._at_rest = False

    def skill(self, lease: Lease | None) -> Steps[T]:
        """Give the generator to run; `lease` is live if the skill `MOVES`, else None."""
        raise NotImplementedError

    def judge(self, outcome: T) -> Status:
        """Say how the step ended; subclasses also keep what the outcome gives."""
        result = cast(Outcome, outcome)
        return self.succeed(result.message) if result.code is Code.OK else self.fail(result.code, result.message)

    def begin(self) -> None:
        """Take the lease if the skill moves the arms; the generator starts once the arms are at rest."""
        self._since, self._at_rest = self.gate.bench.now(), False
        if self.MOVES:
            self._lease = self.gate.grant(self.name)
            self.board.set(self._leased, True)
        self._steps = self.skill(self._lease)

    def advance(self) -> Status:
        """One step of the generator."""
        assert self._steps is not None
        if self._lease is not None:
            if not self._lease.alive:
                return self._ended_by_the_gate()
            if not self._at_rest and (moving := self._moving()):
                return moving
        try:
            progress = next(self._steps)
        except StopIteration as finished:
            # An outcome that was reached while the gate took the lease away is not to be trusted.
            if self._lease is not None and not self._lease.alive:
                return self._ended_by_the_gate()
            return self.judge(finished.value)
        return self.wait(progress.message)

    def end(self, preempted: bool) -> None:
        """Revoke, hold, close. Nothing happens on a leaf that is not running."""
        lease, self._lease = self._lease, None
        steps, self._steps = self._steps, None
        try:
            if lease is not None:
                self.gate.revoke(lease)
                self.board.set(self._leased, False)
        finally:
            if steps is not None:
                steps.close()

    def _ended_by_the_gate(self) -> Status:
        """Wait: at the next tick the guards end the session (a trip) or interrupt the procedure, which then starts anew."""
        return self.wait("the safety gate has taken the arms away")

    def _moving(self) -> Status | None:
        """Wait for arms that still move although they were told to hold; past all patience that is a fault."""
        moving = [name for name, arm in self.gate.bench.arms.items() if arm.operating_state().is_busy]
        if not moving:
            self._at_rest = True
            return None
        names = " and ".join(moving)
        if self.gate.bench.now() - self._since > self.services.hold_patience:
            self.gate.trip(Code.ARM_FAULT, f"{names} did not come to rest within {self.services.hold_patience:.1f} s of a hold")
        return self.wait(f"waiting for {names} to come to rest")
