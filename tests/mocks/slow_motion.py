"""`dissect` and the deadman on a graph whose time waits for whoever is late: `python -m tests.mocks.slow_motion FILE serve-stub ...`.

A bench, a renderer and a session at once are more than two busy cores carry in real time. So all processes of a graph go by one clock in a
shared file: at most `PACE` as fast as the wall's, and never further ahead than `SLACK` of the last sign of life of the bench, of the
driver's monitor and of the deadman. Every limit of the driver, the deadman and the session then holds unchanged, in that time, however
few and busy the cores are; what a machine cannot do in time it does later. Run it as `serve-stub`, `run` or `deadman`.
"""

from __future__ import annotations

import atexit
import mmap
import sys
import threading
import time
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from hardware.dvrk import deadman
from hardware.dvrk.bench import BenchDVRK
from hardware.dvrk.ros1 import TransportROS1
from hardware.served.node import Serving
from hardware.stub.bench import STEP
from supervisor import cli

PACE = 0.7
SLACK = 0.03  # [s] by which nobody is left behind
POLL = 0.5e-3  # [s]
AHEAD, REACHED, MONITOR, DEADMAN, SLOTS = range(5)


class SharedTime:
    """The graph's clock [s]. The bench's process makes it go on, `step` by step; all others read it and say that they are `here`.

    Each number in the file is written by one process alone.
    """

    def __init__(self, file: Path) -> None:
        with file.open("r+b") as opened:
            self._slots = np.frombuffer(mmap.mmap(opened.fileno(), 8 * SLOTS), np.float64)
        self._turn = threading.Lock()
        self._told = 0.0

    @staticmethod
    def create(file: Path) -> None:
        """Make the file of a clock that stands still at 0 until the bench runs."""
        np.array([-np.inf, 0.0, np.inf, np.inf]).tofile(file)

    def clock(self) -> float:
        """Read the time; it never goes back."""
        with self._turn:
            ahead, reached = self._slots[AHEAD], self._slots[REACHED]
            self._told = max(self._told, float(min(ahead + PACE * time.monotonic(), reached + STEP)))
            return self._told

    def step(self) -> float:
        """Let time go on to now, by one physics step at most, unless somebody is too far behind."""
        real, reached = PACE * time.monotonic(), self._slots[REACHED]
        ahead = max(self._slots[AHEAD], -real)  # at the first step
        now = max(reached, min(ahead + real, reached + STEP, self._slots[MONITOR] + SLACK, self._slots[DEADMAN] + SLACK))
        self._slots[AHEAD], self._slots[REACHED] = now - real, now
        return float(now)

    def here(self, who: int) -> None:
        """Say that `who` has come as far as the time is."""
        self._slots[who] = self.clock()

    def leave(self, who: int) -> None:
        """Wait for `who` no more."""
        self._slots[who] = np.inf

    def wait(self, duration: float) -> None:
        """Let `duration` [s] pass that others make."""
        until = self.clock() + duration
        while (left := until - self.clock()) > 0.0:
            time.sleep(max(left / PACE, POLL))

    def wait_stepping(self, duration: float) -> None:
        """Let `duration` [s] pass."""
        until = self.step() + duration
        while (left := until - self.step()) > 0.0:
            time.sleep(max(min(left, STEP) / PACE, POLL))


class SharedROS1(TransportROS1):
    """A node whose stamps are by the shared clock, too."""

    def __init__(self, name: str, shared: SharedTime) -> None:
        super().__init__(name, shared.clock)

    def stamp(self) -> float:
        return 1.0 + self.clock()


class WatchedBench(BenchDVRK):
    """A driver whose monitor says when it looks."""

    def __init__(self, *arguments: object, shared: SharedTime, **options: object) -> None:
        super().__init__(*arguments, wait=shared.wait, **options)  # type: ignore[arg-type]
        self._shared = shared
        self.observe(partial(shared.here, MONITOR))

    def close(self) -> None:
        super().close()
        self._shared.leave(MONITOR)


def main() -> None:
    shared, command = SharedTime(Path(sys.argv.pop(1))), sys.argv[1]
    {"serve-stub": _serve, "run": _run, "deadman": _watch}[command](shared, lambda kind, name: SharedROS1(name, shared))
    cli.main()


# Each process imports no more than it needs: starting takes longer than all else that these do.


def _serve(shared: SharedTime, make_transport: Any) -> None:
    from supervisor import serve_stub

    serve_stub.make_transport = make_transport
    serve_stub.time = SimpleNamespace(monotonic=shared.step, sleep=shared.wait_stepping)  # type: ignore[assignment]
    # Pictures are taken in step with the physics, so that none is late.
    serve_stub.Serving = lambda pictures, threaded: Serving(pictures=pictures)  # type: ignore[assignment, misc]


def _run(shared: SharedTime, make_transport: Any) -> None:
    from supervisor import robot

    robot.make_transport = make_transport
    robot.BenchDVRK = partial(WatchedBench, shared=shared)  # type: ignore[misc, assignment]


def _watch(shared: SharedTime, make_transport: Any) -> None:
    def nap(duration: float) -> None:
        shared.here(DEADMAN)
        time.sleep(duration)

    deadman.make_transport = make_transport
    deadman.time = SimpleNamespace(sleep=nap)  # type: ignore[assignment]
    atexit.register(shared.leave, DEADMAN)


if __name__ == "__main__":
    main()
