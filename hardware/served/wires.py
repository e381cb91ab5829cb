"""One served arm on a graph: every topic and service that a dVRK arm has, the upstream client's whole list (reference 4.2) among them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, TypeVar

import numpy as np

from hardware.dvrk import kinematics
from hardware.dvrk import messages as m
from hardware.dvrk.transport import Publisher, Transport
from hardware.interface import Array, Pose
from hardware.served.arm import ServedArm
from hardware.served.faults import Fault, Faults
from hardware.served.motion import JAW
from hardware.served.reports import Readings, altered, messages, read

CRTK_VERSION = "1.1.0"
# What an arm says on events: kind, and whether the topic is latched
EVENTS: Mapping[str, tuple[type[m.Message], bool]] = {
    "operating_state": (m.OperatingState, True),
    "desired_state": (m.String, True),
    "error": (m.String, True),
    "warning": (m.String, True),
    "status": (m.String, True),
    "goal_reached": (m.Bool, True),
    "tool_type": (m.String, True),
    "tool_type_request": (m.Empty, False),
    "trajectory_j/ratio": (m.Float64, True),
    "trajectory_j/ratio_v": (m.Float64, True),
    "trajectory_j/ratio_a": (m.Float64, True),
    "arm_clutch": (m.Joy, False),
}
EVENT_QUEUE = 100  # a busy pulse must not be lost

A = TypeVar("A")
Locked = Callable[[Callable[[], A]], A]  # calls with the bench's lock held


class ArmWires:
    """Publishes for one arm, and hands it what is sent. `report` is called by the bench under its lock."""

    def __init__(self, arm: ServedArm, namespace: str, transport: Transport, faults: Faults, locked: Locked[Any]) -> None:
        self.arm, self._faults, self._transport, self._locked = arm, faults, transport, locked
        self._namespace = namespace
        self._last: Readings | None = None
        self._kept: Readings | None = None  # from before they froze
        self._events = {
            topic: transport.publisher(f"{namespace}/{topic}", kind, latched, EVENT_QUEUE)
            for topic, (kind, latched) in EVENTS.items()
        }
        self._reports: list[tuple[Publisher[m.Message], Callable[[Readings], m.Message]]] = [
            (transport.publisher(f"{namespace}/{topic}", kind, queue=0), make)
            for topic, (kind, make) in messages(arm.name, faults).items()
        ]
        self._listen()
        self._serve()
        arm.connect(self.say, transport.stamp)

    def say(self, topic: str, message: m.Message) -> None:
        """Publish what happened."""
        if self._faults.on(Fault.SILENT, self.arm.name):
            return
        if topic == "tool_type" and self._faults.on(Fault.TOOL_CHANGED, self.arm.name):
            return
        self.force(topic, message)

    def force(self, topic: str, message: m.Message) -> None:
        """Publish it, whatever faults are in effect."""
        self._events[topic].publish(message)

    def report(self, clock_offset: float) -> None:
        """Take readings, and publish them to whoever listens."""
        if self._faults.on(Fault.SILENT, self.arm.name):
            return
        age = self.arm.now() - self.arm.plant.stamp  # not 0 where the stub's own encoders were told to stand still
        readings = read(self.arm, self._transport.stamp() + clock_offset - age, self._last)
        self._last = readings
        if not any(self._faults.on(fault, self.arm.name) for fault in (Fault.FROZEN, Fault.STAMP_STALE)):
            self._kept = readings
        told = altered(readings, self._kept, self._faults, self.arm.name)
        for publisher, make in self._reports:
            if publisher.listeners():
                publisher.publish(make(told))

    # ------------------------------------------------------------ inside

    def _listen(self) -> None:
        arm, hear = self.arm, self._hear
        hear("state_command", m.StringStamped, lambda x: arm.state_command(x.string))
        hear("hold", m.Empty, lambda x: arm.hold())
        hear("servo_jp", m.JointState, lambda x: arm.servo_jp(x.position))
        hear("servo_jr", m.JointState, lambda x: arm.servo_jp(x.position, relative=True))
        hear("move_jp", m.JointState, lambda x: arm.move_jp(x.position))
        hear("move_jr", m.JointState, lambda x: arm.move_jp(x.position, relative=True))
        hear("servo_cp", m.PoseStamped, lambda x: arm.servo_cp(_matrix(x)))
        hear("move_cp", m.PoseStamped, lambda x: arm.move_cp(_matrix(x)))
        hear("jaw/servo_jp", m.JointState, lambda x: arm.jaw_servo_jp(_first(x)))
        hear("jaw/move_jp", m.JointState, lambda x: arm.jaw_move_jp(_first(x)))
        for topic, kind in (
            ("free", m.Empty),
            ("servo_jf", m.JointState),
            ("jaw/servo_jf", m.JointState),
            ("body/servo_cf", m.WrenchStamped),
            ("spatial/servo_cf", m.WrenchStamped),
        ):
            hear(topic, kind, partial(_relax, arm, topic))
        for which in ("", "v", "a"):
            topic = f"trajectory_j/set_ratio{'_' * bool(which)}{which}"
            hear(topic, m.Float64, partial(_set_ratio, arm, which))
        hear("set_base_frame", m.PoseStamped, lambda x: arm.set_base_frame(_matrix(x), x.frame_id))
        hear("set_tool_type", m.String, lambda x: arm.set_tool_type(x.data))
        hear("emulate_tool_present", m.Bool, lambda x: arm.set_tool_present(x.data))
        for topic in ("emulate_adapter_present", "use_gravity_compensation", "body/set_cf_orientation_absolute"):
            hear(topic, m.Bool, lambda x: None)

    def _hear(self, topic: str, kind: type[m.Message], obey: Callable[[Any], None]) -> None:
        def take(message: m.Message, received: float) -> None:
            def act() -> None:
                if not any(self._faults.on(fault, self.arm.name) for fault in (Fault.SILENT, Fault.LOST_COMMANDS)):
                    obey(message)
                    self.arm.flush()

            self._locked(act)

        # Servo setpoints supersede one another; moves and states are taken in order.
        queue = 1 if "servo" in topic else 10
        self._transport.subscribe(f"{self._namespace}/{topic}", kind, take, queue=queue)

    def _serve(self) -> None:
        def offer(name: str, service: m.Service[Any, Any], answer: Callable[[Any], Any]) -> None:
            self._transport.serve(f"{self._namespace}/{name}", service, lambda asked: self._locked(lambda: answer(asked)))

        offer("operating_state", m.TRIGGER_STATE, lambda asked: m.AnswerState(self.arm.operating_state()))
        offer("crtk_version", m.TRIGGER, lambda asked: m.AnswerTrigger(True, CRTK_VERSION))
        offer("forward_kinematics", m.FORWARD_KINEMATICS, lambda asked: self._forward(asked, self.arm.base))
        offer("local/forward_kinematics", m.FORWARD_KINEMATICS, lambda asked: self._forward(asked, np.eye(4)))
        offer("inverse_kinematics", m.INVERSE_KINEMATICS, self._inverse)

    def _forward(self, asked: m.AskPose, base: Array) -> m.AnswerPose:
        if not 0 <= len(asked.jp) <= JAW or not np.isfinite(asked.jp).all():
            nowhere = m.Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
            return m.AnswerPose(nowhere, False, f"forward kinematics: at most {JAW} finite joints, not {len(asked.jp)}")
        pose = kinematics.frames(self.arm.plant.instrument, asked.jp)[-1]
        pose = base @ (pose @ kinematics.TIP if len(asked.jp) == JAW else pose)
        found = Pose.from_matrix(pose[:3, :3], pose[:3, 3])
        return m.AnswerPose(m.Pose(found.position, found.quaternion), True, "")

    def _inverse(self, asked: m.AskJoints) -> m.AnswerJoints:
        """Of a pose below the remote centre, whatever the documentation says: no base frame is removed (reference 1.2)."""
        seed = asked.jp if asked.jp.shape == (JAW,) and np.isfinite(asked.jp).all() else self.arm.plant.joints
        found = kinematics.inverse(self.arm.plant.instrument, _rigid(asked.cp.position, asked.cp.quaternion), seed)
        solved = bool(np.isfinite(found.q).all())
        return m.AnswerJoints(found.q if solved else seed, solved, "" if solved else f"unable to solve ({found.reason})")


def _relax(arm: ServedArm, what: str, message: m.Message) -> None:
    arm.relax(what)


def _set_ratio(arm: ServedArm, which: str, message: m.Float64) -> None:
    arm.set_ratio(message.data, which)


def _matrix(message: m.PoseStamped) -> Array:
    return _rigid(message.position, message.quaternion)


def _rigid(position: Array, quaternion: Array) -> Array:
    """A (4, 4) pose; the quaternion is normalised without a look at it, so that of length 0 makes numbers that are none."""
    with np.errstate(invalid="ignore", divide="ignore"):
        matrix = np.eye(4)
        matrix[:3, :3] = Pose(position, quaternion / np.linalg.norm(quaternion)).rotation()
    matrix[:3, 3] = position
    return matrix


def _first(message: m.JointState) -> float:
    return float(message.position[0]) if len(message.position) else float("nan")
