"""Pulling by touch: a line along which stiff tissue is felt before it is pulled too far.

A force is felt late: the arm moves a while after its command, and the gate filters what it reads. Soft tissue hardly changes meanwhile.
Tissue that comes taut may rise by newtons within half a millimetre, from below the limit at which pulling is refused to above the one
at which everything stops. So the way is cut into strides, and none begins that could pass the limit together with what has been sent
but not felt yet: the jaws slow down where the tissue is stiff or the limit near, and wait where they must.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from hardware.gate import Lease
from hardware.interface import GRASPER, MoveReport, MoveStatus, Pose
from skills.motion import DONE, servo_line
from skills.skill import Progress, Steps

SHORT = 1e-9  # [m]; what is left of a line below this is rounding


@dataclass(frozen=True)
class TouchConfig:
    """How carefully a pull feels its way."""

    stride: float = 0.2e-3  # [m] at most: what may be pulled before the force is looked at again
    least: float = 0.02e-3  # [m]; a shorter stride would tell nothing that the force's noise does not hide
    felt: float = 0.1  # [s] after which a command's force is felt: the arm's latency, the gate's filter and a tick
    rise: float = 0.2  # [N] that a stride may add however near the limit is; the gate refuses beyond it
    stiffness: float = 3e3  # [N/m] that is reckoned with at least: tissue that is soft now may come taut
    # Times the stiffness felt last that is reckoned with: that of a plate on the bench rose from 1.9 to 9 kN/m within 0.3 mm.
    stiffening: float = 5.0
    looks: int = 3  # whose greatest stiffness counts: a soft stride after stiff ones may be the arm's backlash

    def __post_init__(self) -> None:
        positive = (self.least, self.felt, self.rise, self.stiffness, self.looks)
        if not (all(value > 0 for value in positive) and self.least <= self.stride and self.stiffening >= 1):
            raise ValueError(
                "strides, time, rise, stiffness and looks of a pull by touch must be positive, the least stride not above the longest, "
                "and stiffening at least 1"
            )


class Touch:
    """What was felt on one pull, which begins at rest under `tension` [N] and is to stay below `limit` [N]."""

    def __init__(self, config: TouchConfig, limit: float, tension: float) -> None:
        self._config = config
        self._limit = limit
        self._sent: deque[tuple[float, float]] = deque()  # strides not felt yet: when [s], length [m]
        self._tension = tension  # [N] at the last look that told a stiffness
        self._felt = 0.0  # [m] felt since then
        self._slopes: deque[float] = deque(maxlen=config.looks)  # [N/m]

    def moved(self, now: float, length: float) -> None:
        """The jaws were sent on by `length` [m] at `now` [s]."""
        self._sent.append((now, length))

    def stride(self, now: float, tension: float) -> float:
        """How far [m] the jaws may go at `now` [s], when `tension` [N] is felt: 0 when more must be felt first."""
        config = self._config
        if not math.isfinite(tension):
            return config.least  # the gate refuses it
        self._look(now, tension)
        stiffness = max((config.stiffness, *(config.stiffening * slope for slope in self._slopes)))
        unfelt = sum(length for _, length in self._sent)
        room = (self._limit - tension) / stiffness - unfelt
        if not unfelt:
            room = max(room, config.rise / stiffness, config.least)
        return min(room, config.stride) if room >= config.least else 0.0

    def _look(self, now: float, tension: float) -> None:
        """Tell the stiffness from what has come to be felt."""
        while self._sent and self._sent[0][0] <= now - self._config.felt + 1e-9:
            self._felt += self._sent.popleft()[1]
        if self._felt >= self._config.least:
            self._slopes.append((tension - self._tension) / self._felt)
            self._tension, self._felt = tension, 0.0


def felt_line(lease: Lease, target: Pose, speed: float, doing: str, start: Pose, touch: Touch) -> Steps[MoveReport]:
    """Move the grasper from `start` straight to `target`, at `speed` [m/s] or slower where the tissue is stiff or its limit near.

    At a refusal it stays where it is, and gives the refusal.
    """
    here = start
    while (left := float(np.linalg.norm(target.position - here.position))) > SHORT:
        longest = touch.stride(lease.now(), lease.tension())
        if not longest:
            yield Progress(doing)
            continue
        strides = math.ceil(left / longest)
        there = target if strides == 1 else here.at(here.position + (target.position - here.position) / strides)
        report = yield from servo_line(lease, GRASPER, there, speed, doing, here)
        if report.status is MoveStatus.FAILED:
            return report
        touch.moved(lease.now(), left / strides)
        here = there
    return DONE
