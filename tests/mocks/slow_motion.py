"""`dissect` in slow motion: `python -m tests.mocks.slow_motion PACE serve-stub ...`, and likewise `run`.

A bench, a renderer and a session at once are more than two busy cores carry in real time. So all clocks on the graph may go slower,
by the same factor on either side: the bench's, the driver's, and that of the stamps. Every limit of the driver and of the session then
holds in slow seconds, as it would in real ones on machines that are fast enough; only the deadman, which watches this machine, needs
its budget in real ones.
"""

from __future__ import annotations

import sys
import time
from functools import partial
from types import SimpleNamespace

from hardware.dvrk.bench import BenchDVRK
from hardware.dvrk.ros1 import TransportROS1
from supervisor import cli, robot, serve_stub


class SlowTime:
    """Seconds that take `1 / pace` seconds."""

    def __init__(self, pace: float) -> None:
        self.pace = pace

    def clock(self) -> float:
        return self.pace * time.monotonic()

    def wait(self, duration: float) -> None:
        time.sleep(duration / self.pace)


class SlowROS1(TransportROS1):
    """A node whose stamps are slow, too; one machine's monotonic clock is the same for all its processes."""

    def __init__(self, name: str, slow: SlowTime) -> None:
        super().__init__(name, slow.clock)

    def stamp(self) -> float:
        return 1.0 + self.clock()


def main() -> None:
    slow = SlowTime(float(sys.argv.pop(1)))

    def make_transport(kind: str, name: str) -> SlowROS1:
        return SlowROS1(name, slow)

    serve_stub.make_transport = make_transport  # type: ignore[assignment]
    serve_stub.time = SimpleNamespace(monotonic=slow.clock, sleep=slow.wait)  # type: ignore[assignment]
    robot.make_transport = make_transport  # type: ignore[assignment]
    robot.BenchDVRK = partial(BenchDVRK, wait=slow.wait)  # type: ignore[misc, assignment]
    cli.main()


if __name__ == "__main__":
    main()
