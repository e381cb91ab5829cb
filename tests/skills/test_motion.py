"""Servoed lines keep to the gate's limits, end where they should, and give refusals back as they are."""

import numpy as np
import pytest

from hardware.codes import Code
from hardware.gate import Lease
from hardware.interface import CUTTER, MoveStatus
from skills.motion import pause, servo_line, wait
from tests.mocks.servo import lag, sent
from tests.mocks.table import TICK, Table


@pytest.fixture
def table() -> Table:
    return Table()


@pytest.fixture
def lease(table) -> Lease:
    return table.lease


def test_a_servoed_line_ends_at_its_target(table, lease):
    target = lease.setpoint_cp(CUTTER).moved(np.array([0.004, 0.0, 0.003]))

    report = table.finish(servo_line(lease, CUTTER, target, 8e-3, "moving"))

    assert report.status is MoveStatus.DONE
    assert np.linalg.norm(lease.measured_cp(CUTTER).value.position - target.position) < 0.6e-3


def test_a_servoed_line_keeps_to_its_speed(table, lease):
    started = lease.now()
    target = lease.setpoint_cp(CUTTER).moved(np.array([0.005, 0.0, 0.0]))

    table.finish(servo_line(lease, CUTTER, target, 5e-3, "moving"))

    assert 1.0 <= lease.now() - started < 1.5


def test_a_line_at_the_fastest_speed_is_never_too_fast_though_time_goes_on_within_a_tick(table, lease):
    rng, clock, late = np.random.default_rng(1), table.bench.now, 0.0

    def now() -> float:
        nonlocal late
        late += float(rng.uniform(0.0, 2e-3))
        return clock() + late

    table.bench.now = now
    target = lease.setpoint_cp(CUTTER).moved(np.array([0.01, 0.0, 0.0]))

    report = table.finish(servo_line(lease, CUTTER, target, lease.limits.max_speed, "moving"))

    assert report.status is MoveStatus.DONE, report.message


def test_lines_that_continue_each_other_never_go_back_though_the_setpoint_lags(table, lease):
    lag(table.bench, CUTTER)
    start = lease.setpoint_cp(CUTTER)
    here, behind = start, []
    for number in range(1, 6):
        target = start.moved(np.array([number * 1e-3, 0.0, 0.0]))
        behind.append(here.position[0] - lease.setpoint_cp(CUTTER).position[0])
        report = table.finish(servo_line(lease, CUTTER, target, 8e-3, "moving", here))
        assert report.status is MoveStatus.DONE
        here = target

    assert min(behind[1:]) > 0.1e-3
    assert np.diff(sent(table.bench, CUTTER)[:, 0]).min() > -1e-12
    assert sent(table.bench, CUTTER)[-1] == pytest.approx(here.position, abs=1e-12)


def test_a_line_from_a_start_lies_between_it_and_its_target(table, lease):
    lag(table.bench, CUTTER)
    start = lease.setpoint_cp(CUTTER).moved(np.array([0.0, 0.3e-3, 0.0]))
    target = start.moved(np.array([0.002, 0.0, 0.0]))

    table.finish(servo_line(lease, CUTTER, target, 5e-3, "moving", start))

    along = sent(table.bench, CUTTER) - start.position
    assert np.abs(along[:, 1:]).max() < 1e-12
    assert 0.0 < along[0, 0] <= 5e-3 * TICK * (1 + 1e-9)
    assert along[-1, 0] == pytest.approx(0.002)


def test_a_line_without_a_start_begins_where_the_arm_is_told_to_be(table, lease):
    lag(table.bench, CUTTER)
    here = lease.setpoint_cp(CUTTER)
    target = here.moved(np.array([0.002, 0.0, 0.0]))

    table.finish(servo_line(lease, CUTTER, target, 5e-3, "moving"))

    first = here.moved(np.array([5e-3 * TICK, 0.0, 0.0]))
    assert sent(table.bench, CUTTER)[0] == pytest.approx(first.position)


def test_a_start_far_from_the_arm_is_refused_and_nothing_moves(table, lease):
    start = lease.setpoint_cp(CUTTER).moved(np.array([0.004, 0.0, 0.0]))

    report = table.finish(servo_line(lease, CUTTER, start.moved(np.array([0.004, 0.0, 0.0])), 5e-3, "moving", start))

    assert report.code is Code.STEP_TOO_LONG
    assert table.bench.motions() == []


def test_a_refusal_comes_back_with_its_code(table, lease):
    target = lease.setpoint_cp(CUTTER).moved(np.array([0.0, 0.0, 1.0]))

    report = table.finish(servo_line(lease, CUTTER, target, 5e-3, "moving"))

    assert report.status is MoveStatus.FAILED
    assert report.code is Code.WORKSPACE


def test_an_arm_that_does_not_follow_is_no_success(table, lease):
    target = lease.setpoint_cp(CUTTER).moved(np.array([0.003, 0.0, 0.0]))
    steps = servo_line(lease, CUTTER, target, 5e-3, "moving")
    stuck = table.bench.arms[CUTTER].pose
    for _ in range(5000):
        try:
            next(steps)
        except StopIteration as end:
            report = end.value
            break
        table.bench.advance(TICK)
        table.bench.arms[CUTTER].pose = stuck

    assert report.status is MoveStatus.FAILED


def test_a_revoked_lease_ends_the_motion(table, lease):
    target = lease.setpoint_cp(CUTTER).moved(np.array([0.004, 0.0, 0.0]))
    steps = servo_line(lease, CUTTER, target, 5e-3, "moving")
    next(steps)
    table.bench.advance(TICK)
    table.gate.revoke(lease)

    report = table.finish(steps)

    assert report.code is Code.LEASE_REVOKED


def test_waiting_gives_the_report_of_the_motion(table, lease):
    table.bench.arms[CUTTER].fail_next(Code.MOVE_NOT_REACHED)

    report = table.finish(wait(lease.move_cp(CUTTER, lease.setpoint_cp(CUTTER).moved(np.array([0.01, 0, 0]))), "moving"))

    assert report.code is Code.MOVE_NOT_REACHED


def test_a_pause_lasts_as_long_as_it_says(table, lease):
    started = lease.now()

    table.finish(pause(lease, 0.5, "waiting"))

    assert 0.5 <= lease.now() - started < 0.6
