"""The deadman: a small process beside the robot that holds both arms when the supervisor can no longer do so itself.

The dVRK has no watchdog on its topics: when a client dies, a started move runs to its end. This process watches the supervisor's
heartbeat, both arms and the graph, and does nothing else:

    idle        nobody armed it; it sends nothing, so that a robot under teleoperation is left alone
    watching    armed; all is well
    holding     it publishes `hold` on both arms, again and again, and says why

It goes from watching to holding when the heartbeat stops, when an arm is in FAULT or no longer listens, when a second supervisor
appears, when the ROS master is gone (connections between nodes outlive it), and from anywhere when it is asked. It stops holding only
when it is armed anew while none of this is so. `hold` is a software stop. It is no replacement of the emergency stop.

    python -m hardware.dvrk.deadman --config robot.toml
    python -m hardware.dvrk.deadman /PSM1 /PSM2
"""

from __future__ import annotations

import argparse
import logging
import math
import signal
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from hardware.codes import InputError
from hardware.dvrk.choose_transport import KINDS, make_transport
from hardware.dvrk.messages import Empty, Float64, OperatingState, String
from hardware.dvrk.transport import Transport, TransportError

NAME = "dissection_deadman"
HEARTBEAT = "/dissection_supervisor/heartbeat"  # Float64: a count that changes with every beat
STATE = f"/{NAME}/state"  # String, latched and again and again: "idle", "watching" or "holding: why"
ARM = f"/{NAME}/arm"  # Empty: watch from now on
DISARM = f"/{NAME}/disarm"  # Empty: stop watching; ignored while holding
HOLD = f"/{NAME}/hold"  # Empty: hold both arms

DEFAULT_ARMS = ("/PSM1", "/PSM2")
IDLE, WATCHING, HOLDING = "idle", "watching", "holding"

BUDGET = 0.1  # [s] without a heartbeat, after which the arms are held
LOOK_EVERY = 0.005  # [s]
HOLD_EVERY = 0.02  # [s]; more than once, since a message may be lost and a foreign client may move the arm again
TELL_EVERY = 0.05  # [s]

log = logging.getLogger(__name__)


class Deadman:
    """Watches and holds the `arms`, given by their namespaces, such as "/PSM1". Callbacks and `look` may be on different threads."""

    def __init__(self, transport: Transport, arms: Sequence[str], budget: float = BUDGET) -> None:
        self._transport, self._budget = transport, budget
        self._turn = threading.RLock()
        self.state = IDLE
        self._count, self._beaten = math.nan, -math.inf  # the last heartbeat, and when it came [s]
        self._asked_to = ""  # what was asked since the last look
        self._arm_states: dict[str, str] = {}
        self._held, self._told = -math.inf, -math.inf  # [s]
        self._holds = {arm: transport.publisher(f"{arm}/hold", Empty) for arm in arms}
        self._tells = transport.publisher(STATE, String, latched=True)
        self._beats = transport.subscribe(HEARTBEAT, Float64, self._hear_beat)
        for arm in arms:
            transport.subscribe(f"{arm}/operating_state", OperatingState, self._hear_state_of(arm), latched=True, queue=10)
        for topic in (ARM, DISARM, HOLD):
            transport.subscribe(topic, Empty, self._hear_request(topic), queue=10)

    def look(self) -> None:
        """Look at everything once, and hold if something is wrong; to be called every few milliseconds."""
        with self._turn:
            now = self._transport.clock()
            asked, self._asked_to = self._asked_to, ""
            wrong = self._what_is_wrong(now)
            if asked == HOLD:
                self._become(f"{HOLDING}: it was asked for")
            elif self.state == WATCHING and wrong:
                self._become(f"{HOLDING}: {wrong}")
            elif asked == ARM and wrong:
                log.warning("not armed: %s", wrong)
            elif asked == ARM:
                self._become(WATCHING)
            elif asked == DISARM and self.state == WATCHING:
                self._become(IDLE)
            if self.state.startswith(HOLDING) and now - self._held >= HOLD_EVERY:
                self.hold(now)
            if now - self._told >= TELL_EVERY:
                self._tell(now)

    def hold(self, now: float) -> None:
        """Hold both arms, here and now."""
        self._held = now
        for publisher in self._holds.values():
            publisher.publish(Empty())

    def _what_is_wrong(self, now: float) -> str:
        if not self._transport.alive():
            return "the ROS master is gone or no longer knows this node"
        if self._beats.sources() > 1:
            return "two supervisors send heartbeats"
        if now - self._beaten > self._budget:
            return "the supervisor's heartbeat stopped"
        for arm, publisher in self._holds.items():
            state = self._arm_states.get(arm, "")
            if not state:
                return f"{arm} has not told its operating state"
            if state == "FAULT":
                return f"{arm} is in FAULT"
            if publisher.listeners() == 0:
                return f"nobody listens to {arm}/hold"
        return ""

    def _become(self, state: str) -> None:
        if state != self.state:
            log.warning("%s", state)
            self.state, self._told, self._held = state, -math.inf, -math.inf

    def _tell(self, now: float) -> None:
        self._told = now
        self._tells.publish(String(self.state))

    def _hear_beat(self, message: Float64, received: float) -> None:
        with self._turn:
            if math.isfinite(message.data) and message.data != self._count:  # the same count again is no sign of life
                self._count, self._beaten = message.data, received

    def _hear_state_of(self, arm: str) -> Callable[[OperatingState, float], None]:
        def hear(message: OperatingState, _: float) -> None:
            with self._turn:
                self._arm_states[arm] = message.state

        return hear

    def _hear_request(self, topic: str) -> Callable[[Empty, float], None]:
        def hear(_: Empty, __: float) -> None:
            with self._turn:
                if self._asked_to != HOLD:  # nothing overrules a hold that was asked for in the same moment
                    self._asked_to = topic

        return hear


def _configured(file: Path) -> tuple[list[str], str]:
    """Namespaces of the arms, and the transport, as a session is told them."""
    from hardware.dvrk.config import load_robot

    robot = load_robot(file)
    return [robot.topic(arm.name) for arm in robot.arms], robot.transport


def main(arguments: Sequence[str] | None = None) -> int:
    """Watch until interrupted; hold both arms once more on the way out, unless idle."""
    parser = argparse.ArgumentParser(
        prog="python -m hardware.dvrk.deadman", description="Hold both arms when the supervisor dies."
    )
    parser.add_argument("arms", nargs="*", help="namespaces of the arms; /PSM1 /PSM2 if none is given")
    parser.add_argument("--config", type=Path, help="the session's robot.toml, which names arms, prefix and transport")
    parser.add_argument("--transport", choices=KINDS, help="ros1 if none is given")
    parser.add_argument("--budget", type=float, default=BUDGET, help="seconds without a heartbeat until the arms are held")
    options = parser.parse_args(arguments)
    if not 0.02 < options.budget <= 1.0:
        parser.error(f"--budget is {options.budget:g} s; choose more than 0.02 s (one heartbeat) and at most 1 s")
    if options.config and (options.arms or options.transport):
        parser.error("--config names arms and transport; give either it or them")
    logging.basicConfig(format="%(asctime)s deadman: %(message)s")
    try:
        arms, kind = (
            _configured(options.config) if options.config else (options.arms or DEFAULT_ARMS, options.transport or "ros1")
        )
        transport = make_transport(kind, NAME)
    except (InputError, TransportError) as error:
        print(error, file=sys.stderr)
        return 1
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    deadman = Deadman(transport, arms, options.budget)
    try:
        while True:
            deadman.look()
            time.sleep(LOOK_EVERY)
    except KeyboardInterrupt:
        pass
    finally:
        if deadman.state != IDLE:
            deadman.hold(transport.clock())
        transport.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
