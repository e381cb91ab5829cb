"""What keeps one arm from being moved, judged anew at every look: everything that must hold, in the order in which one explains another.

What is latched stays. What the arm remembers of itself is here: whether it is engaged, where its base was first, and what it refused.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import replace

from hardware.codes import Code
from hardware.dvrk import preconditions as must
from hardware.dvrk.arm_readings import ArmReadings, ArmTopics
from hardware.dvrk.config import ArmConfig, RobotConfig
from hardware.dvrk.jaw import EnergyTip, Jaw
from hardware.dvrk.obedience import Obedience, Part
from hardware.dvrk.tip import TipStream
from hardware.interface import Array, OperatingState, Pose, Stamped
from hardware.verdicts import Verdict

log = logging.getLogger(__name__)

REMEMBERED = 0.3  # [s] for which a refused setpoint keeps the arm from moving, so that whoever sent it notices


class ArmGuard:
    """Judges one arm; `outside` is what stands in the way beyond it, `setpoint` the robot's own. The arm calls it under its lock."""

    def __init__(
        self,
        config: RobotConfig,
        arm: ArmConfig,
        topics: ArmTopics,
        tip: TipStream,
        jaw: Jaw | EnergyTip,
        setpoint: Callable[[], Stamped[Pose]],
        outside: Callable[[], Verdict],
    ) -> None:
        self._config, self._arm, self._topics, self._tip, self._jaw = config, arm, topics, tip, jaw
        self._setpoint, self._outside = setpoint, outside
        self.engaged = False  # its instrument is, and its pose is known
        self.obedience = Obedience()
        self._first_base: Array | None = None
        self._jitter = 0.0  # [m], of the base
        self._late = False  # the setpoint was behind since it was last at rest,
        self._said = ""  # and what the robot said to it
        self._latched: Verdict | None = None
        self._refused: tuple[float, Verdict] = (-math.inf, must.FINE)

    def refuse(self, reason: str, now: float) -> None:
        """Keep the arm from moving for a moment: a setpoint was refused, and nobody waits for an answer."""
        self._refused = (now + REMEMBERED, Verdict(False, False, Code.MOVE_REJECTED, reason))

    def judge(self, readings: ArmReadings, now: float, commanded_at: float) -> Verdict:
        """All that must hold at `now` [s]; the last command of ours went out at `commanded_at` [s]."""
        outside = self._outside()
        if self._latched is not None:
            return self._latched
        state = readings.state
        homed = state is not None and state.message.is_homed and state.message.state == OperatingState.ENABLED
        data = must.data_fresh(readings, now, self._config.rates, self._arm.instrument.has_jaw)
        self.engaged = homed and (self.engaged or (data.ok and readings.tool_type == self._arm.tool_type))
        if not homed:
            self._not_ours()
            return self._remember(outside)
        if not self.engaged:
            self._not_ours()
            told = must.tool_as_told(readings, self._arm) if readings.tool_type else must.FINE
            return self._remember(must.worst([outside, told]))
        held = must.nobody_holds_it(readings, now, self._jaw.moving, commanded_at)
        if not held.ok:
            self._not_ours()
        alive = must.encoders_alive(
            readings, self._tip.sent_away(readings.joints.unchanged_since), now, self._config.rates, self._arm.instrument.has_jaw
        )
        verdicts = [
            must.tool_as_configured(readings, self._arm),
            must.one_source(self._topics.sources()),
            must.frame_as_configured(readings, self._arm),
            self._base_still(readings, data),
            outside,
            held,
            data,
            alive,
            must.slow_enough(readings, self._config.speeds.ratio),
        ]
        trusted = held.ok and data.ok and alive.ok
        if trusted:
            verdicts += self._followed(readings, commanded_at)
        unrest = self._unrest(readings) if trusted else "its data cannot be relied on"
        verdicts.append(self.obedience.verdict(unrest, now))
        if now < self._refused[0]:
            verdicts.append(self._refused[1])
        return self._remember(must.worst(verdicts))

    # ------------------------------------------------------------ inside

    def _base_still(self, readings: ArmReadings, data: Verdict) -> Verdict:
        if self._first_base is None and data.ok:
            self._first_base = readings.base
        self._jitter = max(self._jitter, must.shifted(readings.base, self._first_base))
        return must.base_still(readings.base, self._first_base, self._config.tolerances)

    def _followed(self, readings: ArmReadings, commanded_at: float) -> list[Verdict]:
        """Whether setpoints are where they were sent, and the tip beside its own."""
        setpoint, was_settled = self._setpoint(), self._tip.sent.settled
        obeys = self._tip.sent.judge(setpoint.value, setpoint.stamp, self._jitter)
        if obeys.code in (Code.MOVE_REJECTED, Code.NOT_OBEYED):
            self._said = self._topics.said_since(commanded_at) or self._said
            message = f"{obeys.message}: {self._said}" if self._said else obeys.message
            obeys = replace(obeys, message=message)
            if not self._late:
                self._late = True
                self.obedience.failed(Part.SETPOINT, obeys.code, message)
        elif self._tip.sent.settled:
            self._said = ""
            if not was_settled and not self._late:
                self.obedience.obeyed(Part.SETPOINT)
            self._late = False
        return [
            obeys,
            must.tracks_setpoint(readings, self._config.tolerances),
            must.jaw_ours(readings.jaw_setpoint, self._jaw.commanded(readings), self._config.tolerances),
        ]

    def _unrest(self, readings: ArmReadings) -> str:
        """Why the arm is not quiet, "" when it is."""
        if readings.busy or self._tip.moving or self._jaw.moving or not self._tip.sent.settled:
            return f"{self._arm.called} has not come to rest"
        return must.stands_beside(readings, self._config.tolerances, self._arm.called) or self._jaw.unrest(readings)

    def _remember(self, verdict: Verdict) -> Verdict:
        if not verdict.ok and verdict.latched:
            self._latched = verdict
            log.error("%s: %s", self._arm.called, verdict.message)
        return verdict

    def _not_ours(self) -> None:
        """The arm may go where it wants until it is ours again."""
        self._tip.forget()
        self._jaw.forget()
