"""Everything that one arm says, gathered: its topics by CRTK's names, and one frozen reading of all of them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from hardware.dvrk import messages as m
from hardware.dvrk.telemetry import (
    Event,
    Received,
    Sample,
    Stream,
    TopicFigures,
    joints_problem,
    pose_problem,
    wrench_problem,
)
from hardware.dvrk.transport import Transport
from hardware.interface import Array, Pose

JOINTS = 6
SAME_STAMP = 1e-6  # [s]


@dataclass(frozen=True)
class ArmReadings:
    """One arm as last heard of; `busy_at` [s]: when it was last told to be busy."""

    state: Received[m.OperatingState] | None
    busy_at: float
    tool_type: str | None  # None: not told
    ratio: float | None  # of the trajectory speed
    pressed: bool  # the clutch at the arm
    cp: Sample[m.PoseStamped]  # in the arm's reference frame
    local: Sample[m.PoseStamped]  # from the remote centre
    setpoint: Sample[m.PoseStamped]  # likewise
    joints: Sample[m.JointState]
    force: Sample[m.WrenchStamped]  # in the dVRK's tip frame
    jaw: Sample[m.JointState]
    jaw_setpoint: Sample[m.JointState]
    base: Array | None  # (4, 4), the arm's base in its reference frame

    @property
    def busy(self) -> bool:
        """Whether the arm says that it is busy."""
        return self.state is not None and self.state.message.is_busy

    def streams(self, with_jaw: bool) -> dict[str, Sample[Any]]:
        """The periodic readings that motion rests on, by name."""
        named: dict[str, Sample[Any]] = {
            "measured_cp": self.cp,
            "local/measured_cp": self.local,
            "local/setpoint_cp": self.setpoint,
            "measured_js": self.joints,
            "body/measured_cf": self.force,
        }
        if with_jaw:
            named |= {"jaw/measured_js": self.jaw, "jaw/setpoint_js": self.jaw_setpoint}
        return named


class ArmTopics:
    """Listens to one arm. Thread-safe: each reading is replaced as a whole."""

    def __init__(self, transport: Transport, namespace: str, epoch: float, with_jaw: bool = True) -> None:
        def stream_of(name: str, joints: int) -> Stream[m.JointState]:
            return Stream(transport, f"{namespace}/{name}", m.JointState, epoch, joints_problem(joints))

        def pose_of(name: str) -> Stream[m.PoseStamped]:
            return Stream(transport, f"{namespace}/{name}", m.PoseStamped, epoch, pose_problem)

        self._epoch = epoch
        self._state: Received[m.OperatingState] | None = None
        self._busy_at = -math.inf
        self._base: Array | None = None
        self.cp, self.local, self.setpoint = pose_of("measured_cp"), pose_of("local/measured_cp"), pose_of("local/setpoint_cp")
        self.joints = stream_of("measured_js", JOINTS)
        self.jaw, self.jaw_setpoint = stream_of("jaw/measured_js", 1), stream_of("jaw/setpoint_js", 1)
        self.force = Stream(transport, f"{namespace}/body/measured_cf", m.WrenchStamped, epoch, wrench_problem)
        self.tool_type = Event(transport, f"{namespace}/tool_type", m.String, epoch)
        self.ratio = Event(transport, f"{namespace}/trajectory_j/ratio", m.Float64, epoch)
        self.goal_reached = Event(transport, f"{namespace}/goal_reached", m.Bool, epoch)
        self.error = Event(transport, f"{namespace}/error", m.String, epoch)
        self.warning = Event(transport, f"{namespace}/warning", m.String, epoch)
        self.clutches = [
            Event(transport, f"{namespace}/{name}", m.Joy, epoch, latched=False)
            for name in ("arm_clutch", "io/manip_clutch", "manip_clutch", "io/suj_clutch")
        ]
        # Every change counts, also a busy pulse that is over before anybody looks.
        self._listens = transport.subscribe(
            f"{namespace}/operating_state", m.OperatingState, self._take_state, latched=True, queue=100
        )
        self._streams: list[Stream[Any]] = [self.cp, self.local, self.setpoint, self.joints, self.force]
        if with_jaw:
            self._streams += [self.jaw, self.jaw_setpoint]
        self._events: list[Event[Any]] = [self.tool_type, self.ratio, self.goal_reached, self.error, self.warning, *self.clutches]

    def read(self) -> ArmReadings:
        """Everything as last heard."""
        tool, ratio = self.tool_type.newest(), self.ratio.newest()
        cp, local = self.cp.sample(), self.local.sample()
        self._base = base_frame(cp, local, self._base)
        return ArmReadings(
            state=self._state,
            busy_at=self._busy_at,
            tool_type=None if tool is None else tool.message.data,
            ratio=None if ratio is None else ratio.message.data,
            pressed=any(_pressed(clutch.newest()) for clutch in self.clutches),
            cp=cp,
            local=local,
            setpoint=self.setpoint.sample(),
            joints=self.joints.sample(),
            force=self.force.sample(),
            jaw=self.jaw.sample(),
            jaw_setpoint=self.jaw_setpoint.sample(),
            base=self._base,
        )

    def said_since(self, stamp: float) -> str:
        """The robot's own last error, or else warning, received since `stamp` [s]; what came before may be old."""
        said = self.error.since(stamp) or self.warning.since(stamp)
        return "" if said is None else said.data.strip()

    def figures(self) -> list[TopicFigures]:
        """How the periodic topics came in."""
        return [stream.figures() for stream in self._streams]

    def sources(self) -> dict[str, int]:
        """How many nodes publish each periodic topic."""
        return {stream.topic: stream.sources() for stream in self._streams}

    def missing(self) -> list[str]:
        """Topics of the arm that nobody publishes."""
        needed: list[Stream[Any] | Event[Any]] = [*self._streams, self.tool_type]
        missing = [topic.topic for topic in needed if topic.sources() == 0]
        return missing if self._listens.sources() else [*missing, self.cp.topic.replace("measured_cp", "operating_state")]

    def _take_state(self, message: m.OperatingState, received: float) -> None:
        now = received - self._epoch
        if message.is_busy:
            self._busy_at = now
        self._state = Received(message, now, now)


def base_frame(cp: Sample[m.PoseStamped], local: Sample[m.PoseStamped], last: Array | None) -> Array | None:
    """The arm's base in its reference frame (4, 4), from one instant's two poses of the tip; `last` where the instants differ."""
    if cp.good is None or local.good is None or abs(cp.good.message.stamp - local.good.message.stamp) > SAME_STAMP:
        return last
    return matrix(cp.good.message) @ np.linalg.inv(matrix(local.good.message))


def matrix(message: m.PoseStamped) -> Array:
    """The pose of a message as a (4, 4) matrix."""
    pose = pose_of(message)
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = pose.rotation(), pose.position
    return result


def pose_of(message: m.PoseStamped) -> Pose:
    """The pose of a message, its quaternion made exactly unit."""
    quaternion = np.asarray(message.quaternion, dtype=np.float64)
    return Pose(np.asarray(message.position, dtype=np.float64), quaternion / np.linalg.norm(quaternion))


def _pressed(joy: Received[m.Joy] | None) -> bool:
    return joy is not None and bool(joy.message.buttons) and joy.message.buttons[0] == 1
