"""The driver's side of the deadman: send the heartbeat, arm it, ask it to hold, and know whether it watches.

Nothing here has a thread: the driver's monitor calls `beat`, so that a monitor that hangs is a heartbeat that stops.
"""

from __future__ import annotations

import math

from hardware.dvrk.deadman import ARM, DISARM, HEARTBEAT, HOLD, STATE, TELL_EVERY, WATCHING
from hardware.dvrk.messages import Empty, Float64, String
from hardware.dvrk.transport import Transport

PERIOD = 0.02  # [s] between beats
DEAD_AFTER = 5 * TELL_EVERY  # [s] without a word of the deadman


class Heartbeat:
    """The supervisor's heartbeat, every `period` [s], and what the deadman answers. `beat` belongs to one thread; the rest to any."""

    def __init__(self, transport: Transport, period: float = PERIOD) -> None:
        self._transport, self._period = transport, period
        self._count, self._sent = 0, -math.inf
        self._state, self._heard = "", -math.inf
        self._beats = transport.publisher(HEARTBEAT, Float64)
        self._requests = {topic: transport.publisher(topic, Empty) for topic in (ARM, DISARM, HOLD)}
        self._listens = transport.subscribe(STATE, String, self._hear, latched=True)

    def beat(self) -> None:
        """Send a beat if one is due; to be called at 100 Hz or more."""
        now = self._transport.clock()
        if now - self._sent >= 0.9 * self._period:  # a caller at 100 Hz that comes a little early still beats at 50 Hz
            self._count, self._sent = self._count + 1, now
            self._beats.publish(Float64(float(self._count)))

    def arm(self) -> None:
        """Ask the deadman to watch; `what_is_wrong` tells when it does. Ask again until then: it refuses while anything is wrong."""
        self._requests[ARM].publish(Empty())

    def disarm(self) -> None:
        """Ask it to stop watching, at the end of a session, when both arms are held by ourselves."""
        self._requests[DISARM].publish(Empty())

    def hold(self) -> None:
        """Ask it to hold both arms until it is armed anew."""
        self._requests[HOLD].publish(Empty())

    @property
    def state(self) -> str:
        """What the deadman last said: "idle", "watching" or "holding: why"; empty when it said nothing lately."""
        return self._state if self._transport.clock() - self._heard <= DEAD_AFTER else ""

    def what_is_wrong(self, armed: bool = True) -> str:
        """Why motion must not go on, in one sentence; empty when the deadman is there and, where it is to be `armed`, watches."""
        state = self.state
        if self._listens.sources() > 1:
            return "two deadmen are running; stop one of them"
        if not state:
            return "no deadman is running; start `python -m hardware.dvrk.deadman` on the robot's machine"
        if armed and state != WATCHING:
            return f"the deadman does not watch: it is {state}"
        return ""

    def _hear(self, message: String, received: float) -> None:
        self._state, self._heard = message.data, received
