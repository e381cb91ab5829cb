"""Two arms and a stereo endoscope of a da Vinci Research Kit, as `hardware.interface.Bench`.

Time is the clock on the wall: `advance` waits. A thread of its own looks at everything 100 times a second: it lets each arm take its
step, calls the observers, the safety gate's monitor first of all, and then beats the heart that the deadman listens for. A look
that hangs or fails sends no beat, and the deadman holds the arms. Without a thread, whoever lets time pass calls `monitor`.
"""

from __future__ import annotations

import logging
import math
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any

from hardware.codes import Code, InputError
from hardware.dvrk import preconditions as must
from hardware.dvrk.arm import ArmDVRK
from hardware.dvrk.arm_readings import matrix
from hardware.dvrk.calibration import HandEye, arm_frames, load_hand_eye
from hardware.dvrk.config import ArmConfig, RobotConfig
from hardware.dvrk.console import Console
from hardware.dvrk.deadman import HEARTBEAT
from hardware.dvrk.deadman import NAME as DEADMAN
from hardware.dvrk.endoscope import EndoscopeDVRK
from hardware.dvrk.energy import Energy, NoEnergy
from hardware.dvrk.heartbeat import Heartbeat
from hardware.dvrk.messages import PoseStamped
from hardware.dvrk.survey import survey
from hardware.dvrk.telemetry import TopicFigures
from hardware.dvrk.transport import Transport, TransportError
from hardware.interface import CUTTER, GRASPER
from hardware.verdicts import Verdict

log = logging.getLogger(__name__)

SURVEY_EVERY = 0.5  # [s] between questions to the master about who else commands the arms
ASK_AGAIN = 0.1  # [s] between two looks at what is missing
PARTING = 0.1  # [s] for the last hold to arrive before the heart stops
NOT_OPEN = Verdict(False, False, Code.ARM_NOT_READY, "no session has begun: the bench is not open")


class BenchDVRK:
    """Implements `hardware.interface.Bench`. Nothing moves before `open` has found everything in order.

    `wait` lets time pass, `wall` [s since 1970] tells the age of the calibration. Without `threaded`, `advance` calls the monitor.

    Raises:
        InputError: a hand-eye file is missing or wrong.
    """

    def __init__(
        self,
        config: RobotConfig,
        transport: Transport,
        *,
        wait: Callable[[float], None] = time.sleep,
        energy: Energy | None = None,
        wall: float = math.nan,
        threaded: bool = True,
    ) -> None:
        self._config, self._transport, self._wait, self._wall, self._threaded = config, transport, wait, wall, threaded
        self._epoch = transport.clock()
        self._heartbeat = Heartbeat(transport)
        self._console = Console(transport, config, self._epoch)
        self._endoscope = EndoscopeDVRK(transport, config.camera, config.prefix, self._epoch)
        self._around = must.FINE
        self._elsewhere = must.FINE
        self._surveyed = -math.inf
        self._beats = False  # from the moment that a session is to begin
        self._armed = False  # the deadman was asked to watch
        self._opened = False
        self._asked_to_hold = False
        self._closing = threading.Event()
        self._observers: list[Callable[[], None]] = []
        self._looks, self._last_look, self._longest_look, self._late = 0, math.nan, 0.0, 0
        self._due = 0.0
        self.hand_eyes = {role: self._hand_eye(arm) for role, arm in self._roles().items()}
        energy = energy or NoEnergy()
        self._arms = {
            role: ArmDVRK(
                role,
                config,
                arm,
                arm_frames(self.hand_eyes[role], arm),
                transport,
                self.now,
                self._outside,
                self._is_open,
                energy,
            )
            for role, arm in self._roles().items()
        }
        self._threads = [threading.Thread(target=self._watch, name="dvrk-monitor", daemon=True)] if threaded else []
        if threaded:
            self._threads.append(threading.Thread(target=self._look_around, name="dvrk-survey", daemon=True))
        for thread in self._threads:
            thread.start()

    # ------------------------------------------------------------ interface.Bench

    @property
    def arms(self) -> Mapping[str, ArmDVRK]:
        """The arms by what they do in the session, `GRASPER` and `CUTTER`, whatever the robot calls them."""
        return self._arms

    @property
    def endoscope(self) -> EndoscopeDVRK:
        """The stereo endoscope."""
        return self._endoscope

    def now(self) -> float:
        """Bench time [s] since this object was made."""
        return self._transport.clock() - self._epoch

    def advance(self, duration: float) -> None:
        """Wait until `duration` [s] after the end of the last wait; whoever is late goes on at once and does not catch up."""
        due = self._due + duration
        if due < self.now():
            self._late += 1
            due = self.now()
        self._due = due
        self._let_pass(max(due - self.now(), 0.0))

    def observe(self, callback: Callable[[], None]) -> None:
        """Have `callback` called at every look, on the monitor's thread."""
        self._observers.append(callback)

    def emergency_stop(self) -> bool:
        """Whether the configured stop button is pressed, or the robot's own chain was opened: then all arms lose their power at once."""
        states = [arm.operating_state() for arm in self._arms.values()]
        return self._console.stop_pressed() or must.chain_open([(state.state, state.error) for state in states])

    def close(self) -> None:
        """Hold both arms, tell the deadman that all is over, and leave the graph. What was received can still be read.

        A bench that was never opened commands nothing here either.
        """
        if self._closing.is_set():
            return
        if self._opened:
            for arm in self._arms.values():
                try:
                    arm.hold()
                except TransportError as error:
                    log.error("%s could not be told to hold: %s", arm.name, error)
            self._opened = False
            self._let_pass(PARTING)
        self._disarm()
        self._closing.set()
        for thread in self._threads:
            if thread is not threading.current_thread():
                thread.join(timeout=2.0)
        self._transport.close()

    # ------------------------------------------------------------ beyond the protocol

    @property
    def config(self) -> RobotConfig:
        """What the robot is told to be."""
        return self._config

    @property
    def console(self) -> Console:
        """The surgeon's console, for reading."""
        return self._console

    @property
    def deadman(self) -> str:
        """What the deadman says of itself; empty when it says nothing."""
        return self._heartbeat.state

    def open(self) -> None:
        """Wait until everything that a session needs is there, then arm the deadman. Refused, nothing is left armed.

        Raises:
            InputError: something is missing or wrong; the sentence lists all of it.
        """
        self._beats = True
        until = self.now() + self._config.rates.connect_within
        while problems := self.blockers():
            if self.now() > until:
                self._disarm()
                raise InputError(f"the robot is not ready for a session: {'; '.join(problems)}")
            if problems == [self._heartbeat.what_is_wrong()] and not self._heartbeat.what_is_wrong(armed=False):
                self._armed = True  # nothing else is in the way
                self._heartbeat.arm()
            self._let_pass(ASK_AGAIN)
        self._armed = self._opened = True
        self._let_pass(1.0 / self._config.rates.monitor)  # the arms hear of it at the next look
        self._due = self.now()

    def blockers(self, armed: bool = True) -> list[str]:
        """What would keep a session from starting, one sentence each. That arms are not yet enabled and homed is not among it.

        Unless it is to be `armed` already, a deadman that is idle or holds is none either: a session arms it.
        """
        found = survey(self._config, self._transport, list(self._arms.values()), self._endoscope, self._console)
        verdicts = [
            must.connected(self._transport.alive()),
            must.deadman_watches(self._heartbeat.what_is_wrong(armed)),
            self._deadman_has_arms() if self.deadman else must.FINE,
            *(must.one_source(arm.sources()) for arm in self._arms.values()),
            self._console.verdict(),
            self._sight(),
            self._strangers(),
        ]
        if self._console.stop_pressed():
            found.append("the emergency stop is pressed, or its button says nothing")
        if not self.now() - self._endoscope.stamp() <= self._config.camera.max_age:
            found.append(f"there is no pair of images younger than {self._config.camera.max_age * 1e3:.0f} ms")
        return [*found, *(verdict.message for verdict in verdicts if not verdict.ok)]

    def monitor(self) -> None:
        """Look once: every arm takes its step, the observers are called, and then the heart beats. Before `open` nothing is sent."""
        now = self.now()
        if self._looks:
            self._longest_look = max(self._longest_look, now - self._last_look)
        self._looks, self._last_look = self._looks + 1, now
        self._around = must.worst(
            [
                must.connected(self._transport.alive()),
                must.deadman_watches(self._heartbeat.what_is_wrong()) if self._opened else NOT_OPEN,
                self._elsewhere,
                self._console.verdict(),
                self._sight(),
            ]
        )
        try:
            for arm in self._arms.values():
                arm.step()
        finally:
            # The gate looks even where an arm cannot be reached, and holds the other one.
            for callback in tuple(self._observers):
                callback()
        if self._opened and not self._asked_to_hold and any(arm.driven_by_others for arm in self._arms.values()):
            self._asked_to_hold = True
            self._heartbeat.hold()  # again and again, whatever becomes of us
        if not self._threaded and now >= self._surveyed + SURVEY_EVERY:
            self._surveyed = now
            self._elsewhere = self._strangers()
        if self._beats:
            self._heartbeat.beat()

    def calibration(self) -> str:
        """What calibration is loaded, and its age, in words."""
        said = []
        for role, eye in self.hand_eyes.items():
            days = eye.age(self._wall) / 86400.0
            age = f"{days:.0f} days old" if days >= 2.0 else f"{days * 24.0:.0f} hours old" if days >= 0.0 else "of unknown age"
            said.append(f"{self._arms[role].config.called} hand-eye {age}")
        return ", ".join(said)

    def figures(self) -> dict[str, Any]:
        """Rates [Hz], delays [s], lost and invalid messages of each topic, and how evenly the monitor looked: for the record.

        `force_at_rest` (3,) [N], left camera frame, is what was taken off the grasper's force; None: it was not found.
        """
        topics: list[TopicFigures] = [*self._endoscope.figures()]
        for arm in self._arms.values():
            topics += arm.figures()
        span = self._last_look
        return {
            "topics": topics,
            "unpaired_images": self._endoscope.unpaired,
            "monitor": {
                "looks": self._looks,
                "rate": self._looks / span if span > 0 else 0.0,
                "longest_gap": self._longest_look,
            },
            "late_ticks": self._late,
            "force_at_rest": self._arms[GRASPER].tare.at_rest,
        }

    # ------------------------------------------------------------ inside

    def _let_pass(self, duration: float) -> None:
        """Wait; without a thread for it, looking meanwhile."""
        if self._threaded:
            self._wait(duration)
            return
        until, period = self.now() + duration, 1.0 / self._config.rates.monitor
        while self.now() < until - 1e-9:
            self._wait(min(period, until - self.now()))
            self.monitor()

    def _roles(self) -> dict[str, ArmConfig]:
        return {GRASPER: self._config.grasper, CUTTER: self._config.cutter}

    def _hand_eye(self, arm: ArmConfig) -> HandEye:
        """The calibration of one arm; one that rests on an endoscope arm needs to know where that stands."""
        scope = self._config.console.endoscope_arm
        pose, topic = None, ""
        if scope:
            found: list[PoseStamped] = []
            topic = self._config.topic(f"{scope}/local/measured_cp")
            subscription = self._transport.subscribe(topic, PoseStamped, lambda message, _: found.append(message))
            until = self._transport.clock() + self._config.rates.connect_within
            while not (found and found[-1].stamp > 0) and self._transport.clock() < until:
                self._wait(0.05)
            subscription.close()
            pose = matrix(found[-1]) if found and found[-1].stamp > 0 else None
        return load_hand_eye(arm.calibration, arm.name, arm.calibration_axes, pose, topic)

    def _sight(self) -> Verdict:
        return must.sees_as_calibrated(self._endoscope.changed(), self._endoscope.apart(), self._config.camera.max_skew)

    def _outside(self) -> Verdict:
        return self._around

    def _is_open(self) -> bool:
        return self._opened

    def _disarm(self) -> None:
        """Have the deadman idle again if it was asked to watch; the heart beats until it has heard so."""
        if self._armed:
            self._armed = False
            self._heartbeat.disarm()
            self._let_pass(PARTING)

    def _deadman_has_arms(self) -> Verdict:
        """Whether the deadman watches the arms of the configuration, as the master knows it."""
        try:
            topics = [self._config.topic(f"{arm.name}/hold") for arm in self._config.arms]
            return must.deadman_has({topic: self._transport.publishers_of(topic) for topic in topics}, DEADMAN)
        except TransportError as error:
            return Verdict(False, True, Code.CONNECTION_LOST, str(error))

    def _strangers(self) -> Verdict:
        """Whether somebody else may command the arms, as the master knows it."""
        try:
            us, published = self._transport.publishers_of(HEARTBEAT), self._transport.kinds()
            topics = [
                topic for arm in self._config.arms for topic in must.command_topics(self._config, arm) if topic in published
            ]
            return must.only_us({topic: self._transport.publishers_of(topic) for topic in topics}, us)
        except TransportError as error:
            return Verdict(False, True, Code.CONNECTION_LOST, str(error))

    def _watch(self) -> None:
        """The monitor's thread."""
        period = 1.0 / self._config.rates.monitor
        due = self._transport.clock()
        while not self._closing.is_set():
            try:
                self.monitor()
            except Exception:
                log.exception("a look of the monitor failed; the heart does not beat")
            due = max(due + period, self._transport.clock())
            self._closing.wait(due - self._transport.clock())

    def _look_around(self) -> None:
        """The survey's thread: a master that hangs keeps no arm from being watched."""
        while not self._closing.wait(SURVEY_EVERY):
            if self._opened:
                self._elsewhere = self._strangers()
