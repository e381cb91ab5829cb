"""How soon both arms are held when the supervisor dies, hangs, or the ROS master is gone.

A real graph on the loopback interface: a robot of two arms that tell their poses at 100 Hz, the deadman, and a supervisor that beats
and streams `servo_cp` to both arms as in a retraction. Each run starts all of them anew and breaks off one. Counted is the time from
the last heartbeat that came to the robot (with the master gone, the heartbeat goes on: from the kill) to the later of the two arms'
first `hold`, by the one monotonic clock of the machine. Run: `python -m benchmarks.deadman --json d.json`; it needs ROS 1.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from hardware.dvrk.choose_transport import make_transport
from hardware.dvrk.deadman import HEARTBEAT
from hardware.dvrk.heartbeat import Heartbeat
from hardware.dvrk.messages import Empty, Float64, JointState, OperatingState, PoseStamped
from tests.mocks.ros_master import RosMaster, ros_is_missing, running_master

ARMS = ("/PSM1", "/PSM2")
CAUSES = ("kill", "stop", "master")  # kill -9 and SIGSTOP of the supervisor, kill -9 of the master
TELEMETRY = 0.01  # [s]
UNIT = np.array((0.0, 0.0, 0.0, 1.0))


def robot() -> None:
    """Two arms; print when each was held first, and when the last heartbeat before came."""
    node = make_transport("ros1", "robot")
    beat = [0.0]
    held: set[str] = set()

    def hold_of(arm: str, received: float) -> None:
        if arm not in held:
            held.add(arm)
            line = json.dumps({"arm": arm, "held": received, "beat": beat[0]})
            os.write(sys.stdout.fileno(), f"{line}\n".encode())  # at once: the arms are held on two threads

    node.subscribe(HEARTBEAT, Float64, lambda _, received: beat.__setitem__(0, received))
    poses = [node.publisher(f"{arm}/measured_cp", PoseStamped) for arm in ARMS]
    joints = [node.publisher(f"{arm}/measured_js", JointState) for arm in ARMS]
    for arm in ARMS:
        node.subscribe(f"{arm}/hold", Empty, lambda _, received, arm=arm: hold_of(arm, received))
        node.subscribe(f"{arm}/servo_cp", PoseStamped, lambda _, __: None)
        node.publisher(f"{arm}/operating_state", OperatingState, latched=True).publish(
            OperatingState(node.stamp(), "ENABLED", True, False)
        )
    while True:
        for pose, joint in zip(poses, joints, strict=True):
            pose.publish(PoseStamped(node.stamp(), "base", np.zeros(3), UNIT))
            joint.publish(JointState(node.stamp(), (), np.zeros(6)))
        time.sleep(TELEMETRY)


def supervisor() -> None:
    """Beat, stream, and print a line when the deadman watches."""
    node = make_transport("ros1", "supervisor")
    heartbeat = Heartbeat(node)
    streams = [node.publisher(f"{arm}/servo_cp", PoseStamped) for arm in ARMS]
    watched, count = False, 0
    while True:
        heartbeat.beat()
        for stream in streams:
            stream.publish(PoseStamped(node.stamp(), "", np.zeros(3), UNIT))
        if not watched and count % 20 == 0:
            heartbeat.arm()
        if not watched and heartbeat.state == "watching":
            watched = True
            print("watching", flush=True)
        count += 1
        time.sleep(TELEMETRY)


class Trial:
    """A robot, the deadman and a supervisor on the graph of `master`, once the deadman watches."""

    def __init__(self, master: RosMaster) -> None:
        self._master = master
        self._robot = master.start("-m", "benchmarks.deadman", "robot")
        self.deadman = master.start("-m", "hardware.dvrk.deadman", *ARMS)
        self.supervise()

    def supervise(self) -> None:
        """Start a supervisor, and wait until the deadman watches for it."""
        self._supervisor = self._master.start("-m", "benchmarks.deadman", "supervisor")
        self._master.wait_for("a deadman that watches", lambda: "watching" in self._master.log_of(self._supervisor), 40.0)

    def break_off(self, cause: str) -> float:
        """Break `cause` (of CAUSES; "deadman" ends the deadman itself), and return the time to the later hold [s]."""
        victims: dict[str, tuple[subprocess.Popen[bytes], int]] = {
            "kill": (self._supervisor, signal.SIGKILL),
            "stop": (self._supervisor, signal.SIGSTOP),
            "master": (self._master.process, signal.SIGKILL),
            "deadman": (self.deadman, signal.SIGTERM),
        }
        victim, number = victims[cause]
        if self._held():
            raise RuntimeError(f"held before anything was broken: {self._master.log_of(self.deadman)}")
        at = time.monotonic()
        os.kill(victim.pid, number)
        self._master.wait_for("both arms held", lambda: len(self._held()) == len(ARMS), 10.0)
        held = self._held()
        since = at if victim is not self._supervisor else min(one["beat"] for one in held)
        return max(float(one["held"]) for one in held) - since

    def _held(self) -> list[dict[str, Any]]:
        lines = self._master.log_of(self._robot).splitlines()
        return [json.loads(line) for line in lines if line.startswith("{") and line.endswith("}")]


def measure(runs: int) -> dict[str, Any]:
    """Break off each cause in turn, `runs` times altogether."""
    times: dict[str, list[float]] = {cause: [] for cause in CAUSES}
    for run in range(runs):
        cause = CAUSES[run % len(CAUSES)]
        with tempfile.TemporaryDirectory() as home, running_master(Path(home)) as master:
            trial = Trial(master)
            time.sleep(0.3 + 0.0031 * (run % 7))  # at different moments between two beats
            times[cause].append(1e3 * trial.break_off(cause))
    return {
        "runs": runs,
        "ms": _figures([ms for found in times.values() for ms in found]),
        "by_cause": {cause: _figures(found) for cause, found in times.items() if found},
        "load": os.getloadavg()[0],
        "cores": os.cpu_count(),
    }


def _figures(ms: list[float]) -> dict[str, float]:
    return {"median": float(np.median(ms)), "p99": float(np.percentile(ms, 99)), "max": max(ms)}


def main() -> int:
    """Measure, print, and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "role", nargs="?", choices=["measure", "robot", "supervisor"], default="measure", help="the others are started by it"
    )
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--runs", type=int, default=50, help="of all causes together")
    arguments = parser.parse_args()
    if arguments.role != "measure":
        {"robot": robot, "supervisor": supervisor}[arguments.role]()
    if reason := ros_is_missing():
        print(reason, file=sys.stderr)
        return 1
    figures = measure(arguments.runs)
    for cause, row in [*figures["by_cause"].items(), ("all", figures["ms"])]:
        print(f"{cause:8s} held after {row['median']:6.1f} ms (median), {row['p99']:6.1f} ms (99th percentile)")
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
