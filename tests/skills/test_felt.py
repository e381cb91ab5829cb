"""A pull by touch goes at full speed through soft tissue, and slows down for stiff tissue before the force has passed its limits."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from hardware.codes import Code
from hardware.interface import GRASPER, MoveReport, MoveStatus, Pose
from skills.expose.felt import Touch, TouchConfig, felt_line
from skills.motion import servo_line
from tests.mocks.servo import LATENCY, sent
from tests.mocks.table import Table

SPEED = 5e-3  # [m/s]
STEP = 0.5e-3  # [m]
OUT = np.array([0.6, 0.0, -0.8])  # away from where the jaws closed


class Tissue:
    """A table whose grasper follows its commands late, pulled back with `force(travel)` [N] after `travel` [m]."""

    def __init__(self, force: Callable[[float], float], preload: float = 0.3) -> None:
        self.table = Table()
        self.lease, self.bench = self.table.lease, self.table.bench
        self.start = self.lease.setpoint_cp(GRASPER)
        self.table.pull(preload)
        self.peak = 0.0  # [N], true
        arm = self.bench.arms[GRASPER]

        def arrive(pose: Pose) -> None:
            newtons = force(float((pose.position - self.start.position) @ OUT))
            arm.pose, arm.force = pose, -newtons * OUT
            self.peak = max(self.peak, newtons)

        def servo(pose: Pose) -> None:
            self.bench.record(GRASPER, "servo_cp", pose)
            self.bench.at(self.bench.now() + LATENCY, lambda: arrive(pose))

        arm.servo_cp = servo  # type: ignore[method-assign]

    def pull(self, steps: int, config: TouchConfig | None = None) -> MoveReport:
        """Steps of half a millimetre, one touch for all of them; the last one's report."""
        touch, here = Touch(config or TouchConfig(), self.lease.limits.tension_stop, self.lease.tension()), self.start
        for _ in range(steps):
            target = here.moved(STEP * OUT)
            report = self.table.finish(felt_line(self.lease, target, SPEED, "pulling", here, touch))
            if report.status is MoveStatus.FAILED:
                break
            here = target
        self.bench.advance(0.3)
        return report

    def pull_without(self, steps: int) -> MoveReport:
        """The same, not by touch."""
        here = self.start
        for _ in range(steps):
            target = here.moved(STEP * OUT)
            report = self.table.finish(servo_line(self.lease, GRASPER, target, SPEED, "pulling", here))
            if report.status is MoveStatus.FAILED:
                break
            here = target
        self.bench.advance(0.3)
        return report


def taut_after(slack: float, stiffness: float) -> Callable[[float], float]:
    """Force [N] of tissue that hangs loose for `slack` [m] and then resists with `stiffness` [N/m]."""
    return lambda travel: 0.3 + stiffness * max(travel - slack, 0.0)


@pytest.mark.parametrize("stiffness", [3e3, 5e3, 7e3])
@pytest.mark.parametrize("slack", [0.9e-3, 1.1e-3, 1.25e-3, 1.4e-3])
def test_tissue_that_comes_taut_is_refused_and_never_trips_the_gate(slack, stiffness):
    tissue = Tissue(taut_after(slack, stiffness))

    report = tissue.pull(20)

    assert report.code is Code.TENSION
    assert tissue.table.gate.tripped is None
    assert tissue.peak < 4.6
    assert tissue.peak > 3.5  # what the limit leaves is used


def test_the_same_tissue_pulled_without_touch_passes_the_abort_limit():
    tissue = Tissue(taut_after(1.25e-3, 7e3))

    tissue.pull_without(20)

    assert tissue.table.gate.tripped is not None
    assert tissue.peak > tissue.lease.limits.tension_abort


def test_tissue_that_stiffens_as_it_is_stretched_never_trips_the_gate():
    tissue = Tissue(lambda travel: 0.3 + 0.1 * math.expm1(travel / 0.45e-3))

    report = tissue.pull(20)

    assert report.code is Code.TENSION
    assert tissue.table.gate.tripped is None


def test_a_plate_that_comes_taut_five_times_as_stiff_within_what_is_not_felt_yet_does_not_trip_the_gate():
    # As a bonded plate on the bench did: 1.9 kN/m were felt when it had 9 already.
    tissue = Tissue(lambda travel: 0.3 + 1.9e3 * min(travel, 0.5e-3) + 9e3 * max(travel - 0.5e-3, 0.0))

    tissue.pull(20)

    assert tissue.table.gate.tripped is None


def test_soft_tissue_is_pulled_about_as_fast_as_without_touch():
    by_touch, without = Tissue(taut_after(0.0, 20.0)), Tissue(taut_after(0.0, 20.0))

    by_touch.pull(10)
    without.pull_without(10)

    assert by_touch.bench.now() == pytest.approx(without.bench.now(), abs=0.25)
    assert sent(by_touch.bench, GRASPER)[-1] == pytest.approx(by_touch.start.position + 10 * STEP * OUT, abs=1e-12)


def test_taut_tissue_near_its_limit_is_pulled_in_strides_that_add_little_and_are_felt_before_the_next():
    config = TouchConfig()
    tissue = Tissue(taut_after(0.0, 4e3))

    tissue.pull(2)

    late = [command.stamp for command in tissue.bench.motions(GRASPER)][-3:]
    strides = np.linalg.norm(np.diff(sent(tissue.bench, GRASPER), axis=0), axis=1)
    assert strides[-2:].max() * 4e3 <= 2.0 * config.rise
    assert np.diff(late).min() >= config.felt - 1e-9


def felt(*forces: float, stride: float = 0.1e-3) -> Touch:
    """A touch below 4 N that felt these tensions [N], from 0.3 N, in full after one stride each; the last at 10 s."""
    touch = Touch(TouchConfig(), 4.0, 0.3)
    for number, force in enumerate(forces, start=1 - len(forces)):
        touch.moved(9.5 + number, stride)
        touch.stride(10.0 + number, force)
    return touch


def test_what_was_sent_and_is_not_felt_yet_counts_against_the_room():
    touch = felt(2.0)  # 17 N/mm: 85 are reckoned with, 0.02 mm are left
    free = touch.stride(10.0, 2.0)

    touch.moved(10.0, 0.9 * free)

    assert free == pytest.approx(2.0 / (TouchConfig().stiffening * 1.7e4))
    assert touch.stride(10.01, 2.0) == 0.0
    assert touch.stride(10.2, 2.0) == pytest.approx(free)


def test_one_soft_stride_after_stiff_ones_does_not_let_the_next_be_long():
    assert felt(1.3, 1.3).stride(10.0, 1.3) == pytest.approx(felt(1.3).stride(10.0, 1.3))
    assert felt(1.3, 1.3, 1.3, 1.3).stride(10.0, 1.3) == TouchConfig().stride


def test_at_the_limit_a_stride_that_adds_little_is_still_tried_for_the_gate_to_refuse():
    touch = felt(0.4, 0.5)  # 1 N/mm

    assert touch.stride(10.0, 4.1) * TouchConfig().stiffening * 1e3 == pytest.approx(TouchConfig().rise)


def test_a_force_that_is_not_known_is_left_to_the_gate():
    assert felt(1.0).stride(10.0, math.nan) == TouchConfig().least


@pytest.mark.parametrize(
    "wrong", [{"stride": 0.0}, {"least": 1e-3}, {"least": 0.0}, {"rise": 0.0}, {"felt": -0.1}, {"stiffening": 0.5}, {"looks": 0}]
)
def test_settings_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValueError, match="positive"):
        TouchConfig(**wrong)
