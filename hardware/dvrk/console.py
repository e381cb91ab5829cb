"""What stands around the arms: the surgeon's console with teleoperation and pedals, the stop button, endoscope arm, set-up joints."""

from __future__ import annotations

from hardware.codes import Code
from hardware.dvrk import messages as m
from hardware.dvrk.arm_readings import matrix
from hardware.dvrk.config import RobotConfig
from hardware.dvrk.preconditions import ConsoleReadings, base_still, console_free, pressed, worst
from hardware.dvrk.telemetry import Event, Stream, pose_problem
from hardware.dvrk.transport import Transport
from hardware.interface import Array
from hardware.verdicts import Verdict


class Console:
    """Listens to the console and to what carries the calibration; `verdict` says whether arms may move."""

    def __init__(self, transport: Transport, config: RobotConfig, epoch: float) -> None:
        self._config = config
        name, console = config.topic, config.console

        def says(topic: str) -> Event[m.Bool]:
            return Event(transport, name(topic), m.Bool, epoch)

        def pedal(topic: str) -> Event[m.Joy]:
            return Event(transport, name(topic), m.Joy, epoch)

        self._teleops = [says(f"{teleop}/following") for teleop in console.teleops]
        self._operator: Event[m.Joy] | None = None
        self._clutches: list[Event[m.Joy]] = []
        if console.console:
            self._teleops.insert(0, says(f"{console.console}/teleop/enabled"))
            self._operator = pedal(f"{console.console}/operator_present")
            self._clutches = [pedal(f"{console.console}/clutch"), pedal(f"{console.console}/camera")]
        self._stop = pedal(console.emergency_stop) if console.emergency_stop else None
        self._mounts: dict[str, Stream[m.PoseStamped]] = {}
        if console.endoscope_arm:
            self._mounts["the endoscope"] = self._mount(transport, name(f"{console.endoscope_arm}/local/measured_cp"), epoch)
        if console.setup_joints:
            for arm in config.arms:
                topic = name(f"{console.setup_joints}/{arm.name}/local/measured_cp")
                self._mounts[f"the set-up joint of {arm.name}"] = self._mount(transport, topic, epoch)
        self._first: dict[str, Array] = {}

    def read(self) -> ConsoleReadings:
        """The console as last heard of."""
        operator = self._operator
        return ConsoleReadings(
            {event.topic: None if (newest := event.newest()) is None else newest.message.data for event in self._teleops},
            None if operator is None or operator.newest() is None or operator.sources() == 0 else pressed(operator.newest()),
            {event.topic: pressed(event.newest()) for event in self._clutches},
        )

    def verdict(self) -> Verdict:
        """Whether nobody else drives, somebody looks on, and camera and bases are where they were at the first look."""
        moved = []
        for what, stream in self._mounts.items():
            good = stream.sample().good
            if good is None:
                moved.append(Verdict(False, False, Code.ARM_DATA_STALE, f"{stream.topic} says nothing of where {what} is"))
                continue
            pose = matrix(good.message)
            moved.append(base_still(pose, self._first.setdefault(what, pose), self._config.tolerances, what))
        return worst([*moved, console_free(self.read(), self._config.console.operator_presence)])

    def stop_pressed(self) -> bool:
        """Whether the stop button is pressed. One that is configured and silent, or no longer there, counts as pressed."""
        if self._stop is None:
            return False
        newest = self._stop.newest()
        return newest is None or self._stop.sources() == 0 or pressed(newest)

    def missing(self) -> list[str]:
        """Topics that the configuration names and nobody publishes."""
        wanted: list[Event[m.Joy] | Event[m.Bool] | Stream[m.PoseStamped]] = [*self._mounts.values(), *self._teleops]
        if self._operator is not None and self._config.console.operator_presence:
            wanted.append(self._operator)
        if self._stop is not None:
            wanted.append(self._stop)
        return [topic.topic for topic in wanted if topic.sources() == 0]

    @staticmethod
    def _mount(transport: Transport, topic: str, epoch: float) -> Stream[m.PoseStamped]:
        return Stream(transport, topic, m.PoseStamped, epoch, pose_problem)
