"""Leases, the monitor that needs no tick, trips, and the readings for the guards."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hardware.codes import Code, InputError
from hardware.gate import Decision, Limits
from hardware.interface import CUTTER, GRASPER, MoveStatus
from tests.mocks.table import Table, camera_frozen, disabled, faulted, pressed, stale


@pytest.fixture
def table() -> Table:
    return Table()


# Leases


def test_only_one_lease_lives_at_a_time(table: Table) -> None:
    with pytest.raises(RuntimeError, match="dissect holds the lease"):
        table.gate.grant("expose")


def test_an_unknown_arm_is_a_programming_error(table: Table) -> None:
    with pytest.raises(KeyError, match="PSM1"):
        table.lease.servo_cp("PSM3", table.bench.grasper.pose)


def test_the_lease_is_dead_before_the_arms_are_told_to_hold(table: Table) -> None:
    alive_at_hold: list[bool] = []
    table.bench.grasper.hold = lambda: alive_at_hold.append(table.lease.alive)  # type: ignore[method-assign]

    table.gate.revoke(table.lease)

    assert alive_at_hold == [False]


def test_revoking_twice_holds_once_and_a_dead_lease_cannot_disturb_the_next_one(table: Table) -> None:
    old = table.lease
    table.gate.revoke(old)
    table.gate.revoke(old)
    holds = [c for c in table.bench.log if c.name == "hold"]
    table.gate.grant("expose")

    old.hold()

    assert len(holds) == 2 and [c for c in table.bench.log if c.name == "hold"] == holds


def test_a_motion_under_a_revoked_lease_has_failed(table: Table) -> None:
    table.bench.grasper.delay = 1.0
    handle = table.lease.move_cp(GRASPER, table.bench.grasper.pose.moved(np.array([-0.005, 0, 0])))

    table.gate.revoke(table.lease)
    table.bench.advance(2.0)

    assert handle.report().status is MoveStatus.FAILED
    assert table.bench.holding()


def test_an_arm_that_ignores_holds_and_arrives_later_was_still_no_success(table: Table) -> None:
    table.bench.grasper.delay = 1.0
    table.bench.grasper.hold = lambda: None  # type: ignore[method-assign]
    handle = table.lease.move_cp(GRASPER, table.bench.grasper.pose.moved(np.array([-0.005, 0, 0])))

    table.gate.revoke(table.lease)
    table.bench.advance(2.0)

    assert handle.report().code is Code.LEASE_REVOKED


def test_an_arm_that_cannot_be_told_to_hold_does_not_spare_the_other(table: Table) -> None:
    def broken() -> None:
        raise ConnectionError("cable")

    table.bench.grasper.hold = broken  # type: ignore[method-assign]

    table.gate.revoke(table.lease)

    assert [c.arm for c in table.bench.log if c.name == "hold"] == [CUTTER]
    assert {d.arm: d.accepted for d in table.decisions} == {GRASPER: False, CUTTER: True}


# The monitor


@pytest.mark.parametrize(
    ("event", "code"),
    [
        (pressed, Code.EMERGENCY_STOP),
        (faulted, Code.ARM_FAULT),
        (lambda table: setattr(table.bench.grasper, "force", np.array([0.0, 5.5, 0.0])), Code.TENSION_ABORT),
    ],
)
def test_the_monitor_trips_and_holds_within_few_physics_steps(table: Table, event: Callable[[Table], None], code: Code) -> None:
    table.approve()
    table.bench.grasper.delay = math.inf
    table.move(GRASPER, -5, 0, 0)
    event(table)

    table.bench.advance(0.03)

    assert table.gate.tripped is not None and table.gate.tripped.code is code
    assert not table.lease.alive and table.bench.holding() and table.gate.approval is None


@pytest.mark.parametrize(
    ("event", "code"),
    [
        (camera_frozen, Code.CAMERA_STALE),
        (stale, Code.ARM_DATA_STALE),
        (disabled, Code.ARM_NOT_READY),
        (lambda table: setattr(table.bench.grasper, "force", np.array([math.nan, 0.0, 0.0])), Code.NOT_FINITE),
        (lambda table: setattr(table.bench.cutter, "pose", table.bench.cutter.pose.at(np.full(3, math.nan))), Code.NOT_FINITE),
    ],
)
def test_a_lost_sense_revokes_and_holds_without_tripping(table: Table, event: Callable[[Table], None], code: Code) -> None:
    event(table)
    table.bench.advance(0.6)

    assert not table.lease.alive and table.gate.tripped is None
    assert [(d.code, d.command) for d in table.decisions] == [(code, "hold")] * 2


def test_a_short_gap_of_the_camera_does_not_end_the_skill(table: Table) -> None:
    table.bench.eye.freeze()
    table.bench.advance(0.4)
    table.bench.eye.thaw()

    assert table.lease.alive and table.servo(GRASPER, 0, 0, 0.1) is Code.OK


def test_the_first_trip_stays_until_a_person_clears_it(table: Table) -> None:
    table.gate.trip(Code.EMERGENCY_STOP, "first")
    table.gate.trip(Code.ARM_FAULT, "second")
    kept = table.gate.tripped
    table.gate.clear_trip()

    assert kept is not None and kept.message == "first"
    assert table.gate.tripped is None
    assert not table.lease.alive


def test_clearing_a_trip_whose_cause_persists_trips_again(table: Table) -> None:
    table.bench.cutter.fault()
    table.bench.advance(0.01)
    table.gate.clear_trip()

    table.bench.advance(0.01)

    assert table.gate.tripped is not None and table.gate.tripped.code is Code.ARM_FAULT


def test_a_decision_that_cannot_be_recorded_trips_and_the_command_is_not_sent(table: Table) -> None:
    def full(decision: Decision) -> None:
        raise OSError("disk full")

    table.gate._on_decision = full

    code = table.servo(GRASPER, 0, 0, 0.1)

    assert code is Code.LEASE_REVOKED and table.bench.motions() == []
    assert table.gate.tripped is not None and table.gate.tripped.code is Code.RECORDER_FAILED


def test_a_monitor_that_cannot_look_trips(table: Table) -> None:
    table.bench.cutter.operating_state = lambda: 1 / 0  # type: ignore[method-assign, assignment, return-value]

    table.bench.advance(0.01)

    assert table.gate.tripped is not None and table.gate.tripped.code is Code.INTERNAL_ERROR
    assert [c.arm for c in table.bench.log if c.name == "hold"] == [GRASPER, CUTTER]


# Readings for the guards


def test_the_guards_read_what_is_wrong_and_whether_it_is_latched(table: Table) -> None:
    gate, bench = table.gate, table.bench
    checks = (gate.check_arms, gate.check_camera, gate.check_workspace, gate.check_tension, gate.check_emergency_stop)
    assert all(check().ok for check in checks)

    bench.grasper.pose = bench.grasper.pose.at(np.array([0.5, 0, 0.06]))
    bench.cutter.power_off()
    bench.eye.freeze()
    bench.advance(0.3)
    bench.pressed = True

    readings = [(check().code, check().latched) for check in checks]
    assert readings == [
        (Code.ARM_NOT_READY, False),
        (Code.CAMERA_STALE, False),
        (Code.WORKSPACE, False),
        (Code.OK, False),
        (Code.EMERGENCY_STOP, True),
    ]


def test_a_fault_outranks_another_arms_missing_readiness(table: Table) -> None:
    table.bench.grasper.power_off()
    table.bench.cutter.fault("encoder")

    verdict = table.gate.check_arms()

    assert verdict.latched and verdict.code is Code.ARM_FAULT and "encoder" in verdict.message


@pytest.mark.parametrize(
    "change",
    [
        {"max_step": math.nan},
        {"max_step": 0.0},
        {"tension_stop": 6.0},
        {"workspace_lower": (0.0, 0.0, 1.0)},
        {"max_loaded_speed": 1.0},
    ],
)
def test_contradicting_limits_are_bad_input(change: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(change))):
        replace(Limits(), **change)  # type: ignore[arg-type]
