"""What stands around the served arms: the surgeon's console, the endoscope's arm and the set-up joints, as far as clients look."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hardware.dvrk.config import RobotConfig
from hardware.dvrk.messages import Bool, Empty, Float64, JointState, Joy, Message, OperatingState, PoseStamped
from hardware.dvrk.transport import Publisher, Transport
from hardware.served.faults import Fault, Faults

MOVED = np.array([0.0, 0.0, 3e-3])  # [m], of an endoscope that was touched
ENDOSCOPE_JOINTS = ("yaw", "pitch", "insertion", "roll")
SCALE = 0.2  # of teleoperation


class ServedConsole:
    """`operator`, `pedals` and `teleop` change by messages and by faults. Not thread-safe: the bench calls under its lock."""

    def __init__(
        self,
        transport: Transport,
        config: RobotConfig,
        faults: Faults,
        guard: Callable[..., object],
        command: Callable[[Sequence[str]], None],
    ) -> None:
        self._transport, self._config, self._faults = transport, config, faults
        self._operator, self._teleop = True, False
        self._pedals = {"clutch": 0, "camera": 0}
        self._said: dict[str, Message | tuple[object, ...]] = {}
        self._latched: dict[str, Publisher[Message]] = {}
        self._bodies = [config.console.endoscope_arm] * bool(config.console.endoscope_arm)
        if config.console.setup_joints:
            self._bodies += [f"{config.console.setup_joints}/{arm.name}" for arm in config.arms]
        self._poses = [
            (body, transport.publisher(config.topic(f"{body}/{kind}"), PoseStamped, queue=0))
            for body in self._bodies
            for kind in ("measured_cp", "local/measured_cp")
        ]
        self._joints = [
            (body, transport.publisher(config.topic(f"{body}/measured_js"), JointState, queue=0)) for body in self._bodies
        ]
        console, system = config.console.console, config.console.system
        self._listen(f"{console}/emulate_operator_present", Joy, guard(self._see_operator))
        for pedal in self._pedals:
            self._listen(f"{console}/emulate_{pedal}", Joy, guard(lambda joy, pedal=pedal: self._step_on(pedal, joy)))
        self._listen(f"{console}/teleop/enable", Bool, guard(self._enable_teleop))
        for topic, commands in (("power_on", ("enable",)), ("power_off", ("disable",)), ("home", ("enable", "home"))):
            self._listen(f"{system}/{topic}", Empty, guard(lambda _, commands=commands: command(commands)))
        self.publish_changes()

    def publish_changes(self) -> None:
        """Tell what changed since it was told last; latched, as the console does."""
        console, on = self._config.console, self._faults.on
        present = self._operator and not on(Fault.OPERATOR_ABSENT)
        following = on(Fault.TELEOP_FOLLOWING)
        self._joy(f"{console.console}/operator_present", int(present))
        for pedal, pressed in self._pedals.items():
            self._joy(f"{console.console}/{pedal}", pressed)
        self._once(f"{console.console}/teleop/enabled", Bool(self._teleop or following or on(Fault.TELEOP_ENABLED)))
        self._once(f"{console.console}/teleop/scale", Float64(SCALE))
        for teleop in console.teleops:
            self._once(f"{teleop}/following", Bool(following))
        if console.emergency_stop:
            self._joy(console.emergency_stop, int(on(Fault.EMERGENCY_STOP)))
        for body in self._bodies:
            topic = f"{body}/operating_state"
            if topic not in self._said:
                self._said[topic] = ()
                self._publisher(topic, OperatingState).publish(OperatingState(self._transport.stamp(), "ENABLED", True, False))

    def publish_poses(self, stamp: float) -> None:
        """Tell where endoscope and set-up joints are: they stand still, unless somebody touches the endoscope."""
        still = np.array([0.0, 0.0, 0.0, 1.0])
        for body, publisher in self._poses:
            if not publisher.listeners():
                continue
            touched = body == self._config.console.endoscope_arm and self._faults.on(Fault.ENDOSCOPE_MOVED)
            publisher.publish(PoseStamped(stamp, f"{body.replace('/', '_')}_base", MOVED if touched else np.zeros(3), still))
        for _, joints in self._joints:
            if joints.listeners():
                joints.publish(JointState(stamp, ENDOSCOPE_JOINTS, np.zeros(4), np.zeros(4), np.zeros(4)))

    # ------------------------------------------------------------ inside

    def _listen(self, topic: str, kind: type[Message], callback: object) -> None:
        self._transport.subscribe(self._config.topic(topic), kind, callback, queue=10)  # type: ignore[arg-type]

    def _see_operator(self, joy: Joy) -> None:
        self._operator = bool(joy.buttons) and joy.buttons[0] != 0
        self.publish_changes()

    def _step_on(self, pedal: str, joy: Joy) -> None:
        self._pedals[pedal] = joy.buttons[0] if joy.buttons else 0
        self.publish_changes()

    def _enable_teleop(self, message: Bool) -> None:
        self._teleop = message.data
        self.publish_changes()

    def _joy(self, topic: str, button: int) -> None:
        if self._said.get(topic) != (button,):
            self._said[topic] = (button,)
            self._publisher(topic, Joy).publish(Joy(self._transport.stamp(), (button,)))

    def _once(self, topic: str, message: Message) -> None:
        if self._said.get(topic) != message:
            self._said[topic] = message
            self._publisher(topic, type(message)).publish(message)

    def _publisher(self, topic: str, kind: type[Message]) -> Publisher[Message]:
        if topic not in self._latched:
            self._latched[topic] = self._transport.publisher(self._config.topic(topic), kind, latched=True, queue=10)
        return self._latched[topic]
