"""What the gate knows about the grasped tissue: filtered tension, strain, and where the grasper closed."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from hardware.codes import Code
from hardware.interface import Arm, Array, Pose
from hardware.limits import Limits
from hardware.motion_checks import ROUNDING
from hardware.verdicts import Refusal, Verdict

WINDOW = 5  # samples of the median: it ignores two wild ones and answers to the third of a true change


class GraspLoad:
    """Follows the grasper's force, jaw and position sample by sample. Not thread-safe: the gate calls it under its lock."""

    def __init__(self, grasper: Arm, limits: Limits) -> None:
        self._arm = grasper
        self._limits = limits
        self._forces: deque[tuple[float, float, float]] = deque(maxlen=WINDOW)
        self._stamp = -math.inf
        self._tension = math.nan
        self._strain = 0.0
        self._origin: Array | None = None
        self._closed = False

    @property
    def tension(self) -> float:
        """Norm of the component-wise median of the last force samples [N]; NaN when one of them was not finite."""
        return self._tension

    @property
    def strain(self) -> float:
        """The strain reported last; 0 when nothing is grasped, NaN when a skill reported that it does not know."""
        return self._strain

    @property
    def loaded(self) -> bool:
        """Whether the closed grasper holds tissue under load; unknown tension counts as load."""
        return self._closed and not self._tension <= self._limits.loaded_tension

    def report_strain(self, strain: float) -> None:
        """Take the strain that a skill measured."""
        self._strain = float(strain)

    def sample(self) -> None:
        """Read force, jaw and position once; a sample with a stamp already seen changes nothing."""
        force = self._arm.measured_cf()
        if force.stamp != self._stamp:
            self._stamp = force.stamp
            x, y, z = (float(value) for value in force.value)
            self._forces.append((x, y, z))
            self._tension = self._median_norm()
        jaw = self._arm.measured_jaw().value
        if self._closed and jaw >= self._limits.jaw_open:
            self._closed, self._origin, self._strain = False, None, 0.0
        elif not self._closed and jaw <= self._limits.jaw_closed:
            self._closed, self._origin = True, np.array(self._arm.measured_cp().value.position)

    def pulling_refusal(self, start: Array, target: Pose) -> Refusal | None:
        """Refuse moving the grasper further from where it grasped while tension or strain is at its stop limit.

        Relaxing is always allowed. Without a grasp the only way out is back along the shaft.
        """
        if self._tension < self._limits.tension_stop and self._strain < self._limits.strain_stop:
            return None
        if self._relaxes(start, target):
            return None
        limits = self._limits
        if math.isnan(self._tension) or math.isnan(self._strain):
            code, what = (Code.TENSION, "tension") if math.isnan(self._tension) else (Code.STRAIN, "strain")
            return Refusal(code, f"the {what} of the tissue is unknown: only relaxing is allowed")
        if self._tension >= limits.tension_stop:
            pull = f"the tissue is pulled with {self._tension:.1f} N, the limit is {limits.tension_stop:.1f} N"
            return Refusal(Code.TENSION, f"{pull}: only relaxing is allowed")
        stretch = f"the tissue is stretched by {self._strain:.0%}, the limit is {limits.strain_stop:.0%}"
        return Refusal(Code.STRAIN, f"{stretch}: only relaxing is allowed")

    def check(self) -> Verdict:
        """Whether tension is known and below the abort limit.

        Between the stop and the abort limit this is still ok: pulling further is refused command by command and the skill may
        relax; a guard that waited there would wait forever, as a held grasp keeps its tension.
        """
        tension, limits = self._tension, self._limits
        if math.isnan(tension):
            return Verdict(False, False, Code.NOT_FINITE, "the tension of the tissue is unknown")
        pull = f"the tissue is pulled with {tension:.1f} N"
        if tension >= limits.tension_abort:
            return Verdict(False, True, Code.TENSION_ABORT, f"{pull}, which reaches the limit of {limits.tension_abort:.1f} N")
        if tension >= limits.tension_stop:
            return Verdict(True, message=f"{pull}: only relaxing is allowed")
        if tension >= limits.tension_warn:
            return Verdict(True, message=f"{pull}; the limit is {limits.tension_stop:.1f} N")
        return Verdict(True)

    def _relaxes(self, start: Array, target: Pose) -> bool:
        offset = target.position - start
        if self._origin is None:
            along = float(offset @ target.rotation()[:, 2])
            return along <= 0.0 and float(offset @ offset) <= along * along + ROUNDING**2
        return float(np.linalg.norm(target.position - self._origin)) <= float(np.linalg.norm(start - self._origin)) + ROUNDING

    def _median_norm(self) -> float:
        total = 0.0
        for axis in range(3):
            values = [force[axis] for force in self._forces]
            if not all(map(math.isfinite, values)):
                return math.nan
            values.sort()
            total += values[len(values) // 2] ** 2
        return math.sqrt(total)
