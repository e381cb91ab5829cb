"""The stub bench as a robot on a graph: two arms, console and stereo camera in step with the physics, and every fault by name.

`advance` runs the physics exactly as the stub's own does, and publishes a hundred times per second of bench time; so with a graph
within one process and its clock tied to the bench, a run is repeatable to the last message. Commands may come from any thread: each is
executed when it arrives, under one lock with the physics.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hardware.codes import InputError
from hardware.dvrk.config import RobotConfig
from hardware.dvrk.messages import Joy, Message, String
from hardware.dvrk.transport import Transport
from hardware.interface import CUTTER, GRASPER
from hardware.served.arm import ServedArm
from hardware.served.console import ServedConsole
from hardware.served.faults import ONCE, Fault, Faults
from hardware.served.pictures import Pictures
from hardware.served.plant import Plant
from hardware.served.reports import OTHER_TOOL
from hardware.served.site import bases
from hardware.served.states import Delays
from hardware.served.wires import ArmWires
from hardware.stub.bench import STEP, StubBench

NAMESPACE = "dissection_stub"
CLOCK_OFFSET = 5.0  # [s]


@dataclass(frozen=True)
class Serving:
    """How the bench is served: telemetry and pictures per second of bench time, pictures from a thread of their own, delays of the arms."""

    telemetry: float = 100.0  # [Hz]
    pictures: float = 30.0  # [Hz], at most the stub's own
    threaded: bool = False
    delays: Delays = Delays()  # noqa: RUF009 - frozen


class ServedBench:
    """Owns `bench`: nobody else may advance it or command its arms. Arms are named as CRTK does, in `config`.

    Other processes inject faults by a String on `/dissection_stub/inject`, below the prefix: "name", "name PSM1", "clear" or "clear name";
    `/dissection_stub/faults` tells what is in effect, or what was wrong with the request.
    """

    def __init__(self, bench: StubBench, transport: Transport, config: RobotConfig, serving: Serving | None = None) -> None:
        serving = serving or Serving()
        self.bench, self._transport, self._config = bench, transport, config
        self._lock = threading.RLock()
        self._rate = serving.telemetry
        self._reported = 0
        roles = {GRASPER: config.grasper, CUTTER: config.cutter}
        self.faults = Faults(arm.name for arm in config.arms)
        self._roles = {arm.name: role for role, arm in roles.items()}
        frames = bases(bench, config)
        self.arms: Mapping[str, ServedArm] = {
            arm.name: ServedArm(
                arm.name,
                arm.tool_type,
                Plant(bench.arms[role], frames[role], arm.instrument),
                arm.frame_id,
                self.faults,
                bench.now,
                serving.delays,
            )
            for role, arm in roles.items()
        }
        self._faults_topic = transport.publisher(config.topic(f"{NAMESPACE}/faults"), String, latched=True, queue=10)
        self._wires = {
            name: ArmWires(arm, config.topic(name), transport, self.faults, self._locked) for name, arm in self.arms.items()
        }
        self.console = ServedConsole(transport, config, self.faults, self._guarded, self._command_all)
        self._pictures = Pictures(bench, transport, config, self.faults, serving.pictures, serving.threaded)
        transport.subscribe(config.topic(f"{NAMESPACE}/inject"), String, self._guarded(self._hear_injection), queue=10)
        self._tell_faults("")

    # ------------------------------------------------------------ time

    def advance(self, duration: float) -> None:
        """Let `duration` [s] pass, rounded to whole physics steps as the stub does, and publish what is due."""
        for _ in range(max(1, round(duration / STEP))):
            with self._lock:
                self._step()
            self._pictures.step(self._clock_offset())

    def now(self) -> float:
        """Bench time [s]."""
        return self.bench.now()

    def close(self) -> None:
        """Hold the arms and stop taking pictures; the transport is its owner's to close."""
        self._pictures.close()
        with self._lock:
            for arm in self.arms.values():
                arm.hold()
            self.bench.close()

    # ------------------------------------------------------------ faults

    def inject(self, name: str, arm: str = "") -> None:
        """Put the fault `name` in effect on `arm` ("" both); what it is about stays so until `clear`, or happens once.

        Raises:
            InputError: there is no such fault or arm.
        """
        with self._lock:
            fault, arms = self.faults.read(name, arm)
            if fault not in ONCE:
                self.faults.begin(fault, arms)
            for one in arms:
                self._begin(fault, one)
            self._after_change()

    def clear(self, name: str = "", arm: str = "") -> None:
        """End the fault `name` on `arm` ("" both), or all faults. What a fault left behind, such as FAULT, stays.

        Raises:
            InputError: there is no such fault or arm.
        """
        with self._lock:
            for fault, arms in [self.faults.read(name, arm)] if name else self.faults.lasting():
                self.faults.end(fault, arms)
                for one in arms:
                    self._end(fault, one)
            self._after_change()

    def _begin(self, fault: Fault, name: str) -> None:
        if fault is Fault.EMERGENCY_STOP:
            self.bench.press_emergency_stop()
            return
        arm = self.arms.get(name)
        if arm is None:
            return
        if fault is Fault.CLUTCH:
            arm.clutch(True)
            self._wires[name].say("arm_clutch", Joy(self._transport.stamp(), (1,)))
        elif fault is Fault.TOOL_REMOVED:
            arm.set_tool_present(False)
        elif fault is Fault.TOOL_CHANGED:
            self._wires[name].force("tool_type", String(OTHER_TOOL))
        elif fault is Fault.SILENT:
            arm.plant.stop()  # the watchdog of the low level cuts the power
        elif fault is Fault.JAW_SLIPS and self._roles[name] == GRASPER:
            self.bench.phantom.release()
        if fault in ONCE:
            arm.happen(fault)

    def _end(self, fault: Fault, name: str) -> None:
        if fault is Fault.EMERGENCY_STOP:
            self.bench.press_emergency_stop(False)
        elif fault is Fault.CLUTCH:
            self.arms[name].clutch(False)
            self._wires[name].say("arm_clutch", Joy(self._transport.stamp(), (0,)))
        elif fault is Fault.TOOL_REMOVED:
            self.arms[name].set_tool_present(True)
        elif fault is Fault.TOOL_CHANGED:
            self._wires[name].force("tool_type", String(self.arms[name].tool_type))
        elif fault is Fault.SILENT:
            self.arms[name].retell()
        elif fault is Fault.JAW_BLOCKED:
            self.arms[name].plant.blocked_at = 0.0

    def _after_change(self) -> None:
        for arm in self.arms.values():
            arm.flush()
        self.console.publish_changes()
        self._tell_faults("")

    def _hear_injection(self, message: String) -> None:
        words = message.data.split()
        try:
            if words[:1] == ["clear"] and len(words) <= 3:
                self.clear(*words[1:])
            elif len(words) in (1, 2):
                self.inject(*words)
            else:
                raise InputError(f"{message.data!r} is no request; send a fault's name, and an arm's after it if it concerns one")
        except InputError as error:
            self._tell_faults(f"refused: {error}")

    def _tell_faults(self, refusal: str) -> None:
        self._faults_topic.publish(String(refusal or ", ".join(self.faults.active()) or "none"))

    # ------------------------------------------------------------ inside

    def _step(self) -> None:
        for arm in self.arms.values():
            arm.step(STEP)
        self.bench.advance(STEP)
        number = int(self.bench.now() * self._rate + 1e-6)
        due = number != self._reported
        for arm in self.arms.values():
            arm.plant.measure()
            arm.settle()
        if not due:
            return
        self._reported = number
        offset = self._clock_offset()
        for wires in self._wires.values():
            wires.report(offset)
        self.console.publish_poses(self._transport.stamp() + offset)

    def _clock_offset(self) -> float:
        ahead, behind = self.faults.on(Fault.CLOCK_AHEAD), self.faults.on(Fault.CLOCK_BEHIND)
        return CLOCK_OFFSET * (int(ahead) - int(behind))

    def _command_all(self, commands: Sequence[str]) -> None:
        for arm in self.arms.values():
            for command in commands:
                arm.state_command(command)
            arm.flush()

    def _locked(self, act: Callable[[], Any]) -> Any:
        with self._lock:
            return act()

    def _guarded(self, hear: Callable[[Any], object]) -> Callable[[Message, float], None]:
        """A callback that acts on a message under the lock."""

        def take(message: Message, received: float) -> None:
            with self._lock:
                hear(message)

        return take
