"""A mock bench under a safety gate with one lease, and the things that go wrong with it."""

from __future__ import annotations

from typing import TypeVar

import numpy as np

from hardware.codes import Code
from hardware.gate import Approval, Decision, Lease, Limits, SafetyGate
from hardware.interface import CUTTER
from skills.skill import Steps
from tests.mocks.bench import MockBench

TICK = 1 / 30
T = TypeVar("T")


class Table:
    """A mock bench under a gate, with one lease and all decisions kept."""

    def __init__(self, limits: Limits | None = None) -> None:
        self.bench = MockBench()
        self.decisions: list[Decision] = []
        self.gate = SafetyGate(self.bench, limits or Limits(), self.decisions.append)
        self.lease: Lease = self.gate.grant("dissect")
        self.bench.advance(TICK)

    def finish(self, steps: Steps[T]) -> T:
        """Run a skill's generator to its end, a tick of bench time at each step, and give its outcome."""
        for _ in range(5000):
            try:
                next(steps)
            except StopIteration as end:
                outcome: T = end.value
                return outcome
            self.bench.advance(TICK)
        raise AssertionError("the steps did not come to their end")

    def servo(self, arm: str, *offset_mm: float) -> Code:
        """Servo `arm` by an offset [mm] from where it is told to be."""
        return self.lease.servo_cp(arm, self.lease.setpoint_cp(arm).moved(np.array(offset_mm) * 1e-3)).code

    def move(self, arm: str, *offset_mm: float) -> Code:
        """Send a free motion by an offset [mm]."""
        return self.lease.move_cp(arm, self.lease.setpoint_cp(arm).moved(np.array(offset_mm) * 1e-3)).report().code

    def approve(self, lasting: float = 60.0) -> None:
        """Approve cuts from now on."""
        now = self.bench.now()
        self.gate.approve(Approval("goal", "operator", 0, now, now + lasting))

    def snip(self) -> Code:
        """Open the scissors and close them."""
        assert self.lease.move_jaw(CUTTER, 0.8).report().code is Code.OK
        return self.lease.move_jaw(CUTTER, 0.0).report().code

    def pull(self, newtons: float) -> None:
        """Grasp here, then let the tissue pull with this force."""
        self.bench.grasper.jaw = 0.0
        self.bench.advance(TICK)
        self.bench.grasper.force = np.array([0.0, newtons, 0.0])
        self.bench.advance(2 * TICK)


def disabled(table: Table) -> None:
    """Take the grasper's power."""
    table.bench.grasper.power_off()


def stale(table: Table) -> None:
    """Let the grasper's data stand still."""
    table.bench.grasper.stale = True
    table.bench.advance(0.15)


def from_the_future(table: Table) -> None:
    """Stamp the grasper's data ahead of the clock."""
    table.bench.grasper._stale_since = table.bench.now() + 5.0


def camera_frozen(table: Table) -> None:
    """Freeze the camera for longer than motion allows."""
    table.bench.eye.freeze()
    table.bench.advance(0.3)


def tripped(table: Table) -> None:
    """Trip, then ask for a new lease."""
    table.gate.trip(Code.ABORTED, "the operator aborted")
    table.lease = table.gate.grant("retreat")


def pressed(table: Table) -> None:
    """Press the emergency stop."""
    table.bench.pressed = True


def revoked(table: Table) -> None:
    """Revoke the lease."""
    table.gate.revoke(table.lease)


def faulted(table: Table) -> None:
    """Put the grasper in fault."""
    table.bench.grasper.fault()
