"""A real ROS 1 master on the loopback interface, for the tests and benchmarks that need a graph of several processes."""

from __future__ import annotations

import importlib.util
import os
import socket
import subprocess
import sys
import time
import xmlrpc.client
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[2]
START_WITHIN = 20.0  # [s]; a busy machine takes seconds to start Python


@dataclass
class RosMaster:
    """A master on the loopback interface and the processes that a test started on it."""

    uri: str
    home: Path
    process: subprocess.Popen[bytes]
    started: list[subprocess.Popen[bytes]] = field(default_factory=list)

    @property
    def environment(self) -> dict[str, str]:
        """What a node's process needs to find it."""
        ros = {"ROS_MASTER_URI": self.uri, "ROS_IP": "127.0.0.1", "ROS_HOME": str(self.home), "ROS_VERSION": "1"}
        # One arithmetic thread each: the processes of a graph share few cores.
        return {**os.environ, **ros, "OMP_NUM_THREADS": "1", "PYTHONUNBUFFERED": "1"}

    def start(self, *command: str) -> subprocess.Popen[bytes]:
        """Run `python COMMAND...` on this graph; it is ended with the master. Its output goes to `log_of(process)`."""
        with (self.home / f"node{len(self.started)}.log").open("wb") as log:
            process = subprocess.Popen(
                [sys.executable, *command],
                cwd=ROOT,
                env=self.environment,
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=subprocess.STDOUT,
            )
        self.started.append(process)
        return process

    def log_of(self, process: subprocess.Popen[bytes]) -> str:
        """What the process printed so far."""
        return (self.home / f"node{self.started.index(process)}.log").read_text()

    def topics(self) -> dict[str, str]:
        """The types of the topics that are published."""
        return dict(xmlrpc.client.ServerProxy(self.uri).getPublishedTopics("/test", "")[2])  # type: ignore[index, arg-type]

    def wait_for(self, what: str, until: Callable[[], bool], within: float = START_WITHIN) -> None:
        """Wait until something is so, or raise TimeoutError and say what every process printed."""
        deadline = time.monotonic() + within
        while not until():
            if time.monotonic() > deadline:
                printed = "\n".join(f"{process.args}: {self.log_of(process)}" for process in self.started)
                raise TimeoutError(f"not within {within:.0f} s: {what}\n{printed}")
            time.sleep(0.01)

    def restart(self) -> None:
        """End the master and start another at the same place, which knows none of the nodes."""
        self.process.kill()
        self.process.wait()
        self.process = _start(self.uri, self.home)
        self.wait_for("another ROS master that answers", lambda: _answers(self.uri))

    def stop(self) -> None:
        """End every process."""
        for process in (*reversed(self.started), self.process):
            process.kill()
            process.wait()
            if process.stdin is not None:
                process.stdin.close()


def ros_is_missing() -> str:
    """Why the tests on a real graph cannot run here; nothing where they can."""
    missing = [name for name in ("rospy", "rosmaster", "sensor_msgs", "std_srvs") if importlib.util.find_spec(name) is None]
    return f"ROS 1 is not installed ({', '.join(missing)} missing; `make ros` installs it on Debian)" if missing else ""


@contextmanager
def running_master(home: Path) -> Iterator[RosMaster]:
    """A master on a free port with its files in the empty folder `home`; see `ros_is_missing` first."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    uri = f"http://127.0.0.1:{port}"
    master = RosMaster(uri, home, _start(uri, home))
    try:
        master.wait_for("a ROS master that answers", lambda: _answers(uri))
        yield master
    finally:
        master.stop()


def _answers(uri: str) -> bool:
    try:
        return bool(xmlrpc.client.ServerProxy(uri).getPid("/test"))
    except OSError:
        return False


def _start(uri: str, home: Path) -> subprocess.Popen[bytes]:
    environment = {**os.environ, "ROS_MASTER_URI": uri, "ROS_IP": "127.0.0.1", "ROS_HOME": str(home)}
    with (home / "master.log").open("ab") as log:
        return subprocess.Popen(
            [sys.executable, "-c", "import rosmaster; rosmaster.rosmaster_main()", "--core", "-p", uri.rpartition(":")[2]],
            env=environment,
            stdout=log,
            stderr=subprocess.STDOUT,
        )
