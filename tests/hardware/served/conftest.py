"""A served stub bench on a graph within one process, and a client that hears everything."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hardware.dvrk import messages as m
from hardware.dvrk.config import RobotConfig
from hardware.dvrk.local import LocalGraph
from hardware.served.node import ServedBench
from hardware.served.site import write_site
from hardware.stub.bench import StubBench
from hardware.stub.scene import Scene, load_scene

ARMS = ("PSM1", "PSM2")
KINDS: dict[str, type[m.Message]] = {
    "operating_state": m.OperatingState,
    "desired_state": m.String,
    "error": m.String,
    "warning": m.String,
    "status": m.String,
    "goal_reached": m.Bool,
    "tool_type": m.String,
    "arm_clutch": m.Joy,
    "measured_js": m.JointState,
    "setpoint_js": m.JointState,
    "measured_cp": m.PoseStamped,
    "setpoint_cp": m.PoseStamped,
    "measured_cv": m.TwistStamped,
    "local/measured_cp": m.PoseStamped,
    "local/setpoint_cp": m.PoseStamped,
    "local/measured_cv": m.TwistStamped,
    "body/measured_cf": m.WrenchStamped,
    "spatial/measured_cf": m.WrenchStamped,
    "body/jacobian": m.Matrix,
    "spatial/jacobian": m.Matrix,
    "jaw/measured_js": m.JointState,
    "jaw/setpoint_js": m.JointState,
    "trajectory_j/ratio": m.Float64,
}


def scene() -> Scene:
    """Silicone, coarse enough for quick tests, and no calibration error."""
    loaded = load_scene("silicone")
    tissue = replace(loaded.tissue, fine_spacing=2e-3, coarse_spacing=6e-3, puncture_variation=0.0)
    return replace(loaded, tissue=tissue, arms=replace(loaded.arms, bias=0.0))


@dataclass
class Rig:
    """The bench, how it is served, and what a client heard: (bench time, message) by topic."""

    bench: StubBench
    graph: LocalGraph
    config: RobotConfig
    served: ServedBench
    heard: dict[str, list[tuple[float, Any]]] = field(default_factory=lambda: defaultdict(list))

    def __post_init__(self) -> None:
        self.client = self.graph.node("client")
        self._publishers: dict[str, Any] = {}
        for arm in ARMS:
            for topic, kind in KINDS.items():
                self.listen(f"/{arm}/{topic}", kind)

    def listen(self, topic: str, kind: type[m.Message]) -> None:
        self.client.subscribe(topic, kind, lambda message, received: self.heard[topic].append((received, message)))

    def send(self, topic: str, message: m.Message) -> None:
        if topic not in self._publishers:
            self._publishers[topic] = self.client.publisher(topic, type(message))
        self._publishers[topic].publish(message)

    def newest(self, topic: str) -> Any:
        return self.heard[topic][-1][1]

    def since(self, topic: str, start: float) -> list[Any]:
        return [message for at, message in self.heard[topic] if at >= start]

    def state(self, arm: str) -> m.OperatingState:
        return self.newest(f"/{arm}/operating_state")

    def command(self, arm: str, command: str) -> None:
        self.send(f"/{arm}/state_command", m.StringStamped(0.0, command))

    def joints(self, arm: str, topic: str, position: Any) -> None:
        self.send(f"/{arm}/{topic}", m.JointState(0.0, (), np.atleast_1d(np.array(position, dtype=np.float64))))

    def pose(self, arm: str, topic: str, position: Any, quaternion: Any) -> None:
        self.send(f"/{arm}/{topic}", m.PoseStamped(0.0, "", np.array(position), np.array(quaternion)))

    def shift(self, arm: str, topic: str, offset: Any) -> np.ndarray:
        """Command the arm's setpoint moved by `offset` [m], and give the goal."""
        now = self.newest(f"/{arm}/setpoint_cp")
        goal = now.position + np.array(offset)
        self.pose(arm, topic, goal, now.quaternion)
        return goal

    def go(self, duration: float) -> float:
        """Let time pass; gives when that began."""
        start = self.bench.now()
        self.served.advance(duration)
        return start

    def ready(self) -> Rig:
        for command, done in (("enable", "ENABLED"), ("home", "TOOL_ENGAGED")):
            for arm in ARMS:
                self.command(arm, command)
            while any(self.newest(f"/{arm}/desired_state").data != done for arm in ARMS):
                self.go(0.05)
                assert self.bench.now() < 5.0, "the arms did not become ready"
        self.go(0.05)
        return self


@pytest.fixture
def make_rig(tmp_path: Path) -> Callable[..., Rig]:
    def make(**served: Any) -> Rig:
        bench = StubBench(scene(), 0)
        config = write_site(bench, tmp_path)
        graph = LocalGraph(bench.now)
        return Rig(bench, graph, config, ServedBench(bench, graph.node("dvrk"), config, **served))

    return make


@pytest.fixture
def rig(make_rig) -> Rig:
    """A robot that was just switched on."""
    return make_rig()


@pytest.fixture
def robot(rig: Rig) -> Rig:
    """A robot that is enabled and homed, with its instruments."""
    return rig.ready()
