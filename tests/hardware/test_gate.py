"""The safety gate's checks of single commands: what passes, and each refusal with its code and sentence."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hardware.codes import Code
from hardware.gate import Limits
from hardware.interface import CUTTER, GRASPER, MoveStatus, Pose
from tests.mocks.table import TICK, Table, camera_frozen, disabled, faulted, from_the_future, pressed, revoked, stale, tripped


@pytest.fixture
def table() -> Table:
    return Table()


# Commands that pass


def test_an_allowed_servo_step_reaches_the_arm_and_is_reported_first(table: Table) -> None:
    reached = []
    table.gate._on_decision = lambda decision: reached.append((decision, len(table.bench.motions())))

    code = table.servo(GRASPER, 0.0, 0.0, 0.3)

    decision, motions_before = reached[0]
    assert code is Code.OK and len(table.bench.motions(GRASPER)) == 1
    assert decision.accepted and decision.command == "servo_cp" and motions_before == 0
    assert decision.target is not None and len(decision.target) == 7


def test_a_move_is_done_when_the_arm_says_so(table: Table) -> None:
    table.bench.grasper.delay = 0.2
    handle = table.lease.move_cp(GRASPER, table.bench.grasper.pose.moved(np.array([-0.005, 0, 0])))

    before = handle.report().status
    table.bench.advance(0.3)

    assert before is MoveStatus.RUNNING and handle.report().status is MoveStatus.DONE


# Refusals, one by one


@pytest.mark.parametrize(
    ("condition", "code"),
    [
        (revoked, Code.LEASE_REVOKED),
        (tripped, Code.TRIPPED),
        (pressed, Code.TRIPPED),
        (disabled, Code.ARM_NOT_READY),
        (faulted, Code.ARM_FAULT),
        (stale, Code.ARM_DATA_STALE),
        (from_the_future, Code.ARM_DATA_STALE),
        (camera_frozen, Code.CAMERA_STALE),
    ],
)
def test_a_condition_of_the_bench_blocks_every_motion(table: Table, condition: Callable[[Table], None], code: Code) -> None:
    table.approve()
    condition(table)

    answers = [table.servo(GRASPER, 0, 0, 0.1), table.move(GRASPER, 0, 0, 1), table.lease.move_jaw(GRASPER, 0.1).report().code]

    assert answers[0] is code
    assert all(answer is not Code.OK for answer in answers)
    assert table.bench.motions() == []
    assert all(d.message for d in table.decisions if d.command == "servo_cp")


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_numbers_that_are_not_finite_are_refused_and_reported_without_them(table: Table, bad: float) -> None:
    pose = table.bench.grasper.pose.at(np.array([bad, 0.0, 0.06]))

    codes = [
        table.lease.servo_cp(GRASPER, pose).code,
        table.lease.move_cp(GRASPER, pose).report().code,
        table.lease.move_jaw(GRASPER, bad).report().code,
    ]

    assert codes == [Code.NOT_FINITE] * 3
    assert [d.target for d in table.decisions] == [None] * 3


def test_a_quaternion_that_is_no_rotation_is_refused(table: Table) -> None:
    pose = Pose(table.bench.grasper.pose.position, np.array([0.0, 0.0, 0.0, 0.5]))

    assert table.lease.servo_cp(GRASPER, pose).code is Code.NOT_FINITE


def test_leaving_the_workspace_is_refused_with_the_range_in_millimetres(table: Table) -> None:
    report = table.lease.move_cp(GRASPER, table.bench.grasper.pose.at(np.array([0.0, 0.0, 0.250]))).report()

    assert report.code is Code.WORKSPACE
    assert "250.0 mm" in report.message and "200 mm" in report.message


def test_a_servo_step_over_the_limit_is_refused(table: Table) -> None:
    assert table.servo(GRASPER, 0, 0, 1.0) is Code.OK
    table.bench.advance(1.0)
    assert table.servo(GRASPER, 0, 0, 1.1) is Code.STEP_TOO_LONG


def test_steps_may_not_run_away_from_an_arm_that_does_not_follow(table: Table) -> None:
    table.bench.grasper.servo_cp = lambda pose: None  # type: ignore[method-assign]
    start, codes = table.bench.grasper.pose, []

    for step in range(1, 6):
        codes.append(table.lease.servo_cp(GRASPER, start.moved(np.array([0, 0, step * 0.9e-3]))).code)
        table.bench.advance(0.2)

    assert codes == [Code.OK] + [Code.STEP_TOO_LONG] * 4


def test_a_large_turn_in_one_step_is_refused(table: Table) -> None:
    pose = table.bench.grasper.pose

    assert table.lease.servo_cp(GRASPER, Pose.looking(pose.position, np.array([1.0, 0, 0]), np.array([0, 1.0, 0]))).code is (
        Code.STEP_TOO_LONG
    )


def test_servo_steps_that_come_too_fast_are_refused_also_after_a_hold(table: Table) -> None:
    first = table.servo(CUTTER, 0, 0, 0.3)
    table.lease.hold()
    at_once = table.servo(CUTTER, 0, 0, 0.3)
    table.bench.advance(TICK)
    later = table.servo(CUTTER, 0, 0, 0.3)

    assert (first, at_once, later) == (Code.OK, Code.TOO_FAST, Code.OK)


def test_a_loaded_grasper_moves_slowly_and_never_freely(table: Table) -> None:
    table.pull(1.0)
    table.servo(GRASPER, 0, -0.1, 0)
    table.bench.advance(TICK)

    assert table.servo(GRASPER, 0, -0.3, 0) is Code.TOO_FAST
    assert table.servo(GRASPER, 0, -0.16, 0) is Code.OK
    assert table.move(GRASPER, 0, -2, 0) is Code.TOO_FAST


def test_an_unloaded_closed_grasper_moves_freely(table: Table) -> None:
    table.pull(0.05)

    assert table.move(GRASPER, -5, 0, 0) is Code.OK


def test_tools_may_not_come_too_close_even_on_the_way(table: Table) -> None:
    target = table.bench.cutter.pose.position + np.array([0.020, 0.0, 0.0])  # beyond the scissors, through them

    report = table.lease.move_cp(GRASPER, table.bench.grasper.pose.at(target)).report()

    assert report.code is Code.TOOLS_TOO_CLOSE and "3.0 mm" in report.message


def test_the_line_that_the_other_tool_still_sweeps_is_kept_clear(table: Table) -> None:
    table.bench.cutter.delay = 1.0
    assert table.move(CUTTER, -20, 0, 0) is Code.OK

    assert table.move(GRASPER, 8, 0, 0) is Code.TOOLS_TOO_CLOSE


def test_tools_that_are_too_close_may_part(table: Table) -> None:
    near = table.bench.cutter.pose.position - np.array([0.002, 0.0, 0.0])
    table.bench.grasper.pose = table.bench.grasper.pose.at(near)

    assert table.servo(GRASPER, 0.3, 0, 0) is Code.TOOLS_TOO_CLOSE
    assert table.servo(GRASPER, -0.3, 0, 0) is Code.OK


# Tension and strain


def test_at_the_tension_limit_the_grasper_may_only_relax(table: Table) -> None:
    table.bench.grasper.jaw = 0.0
    table.bench.advance(TICK)
    for _ in range(6):
        assert table.servo(GRASPER, 0, -0.15, 0) is Code.OK
        table.bench.advance(TICK)
    table.pull(4.2)

    assert table.servo(GRASPER, 0, -0.1, 0) is Code.TENSION
    assert table.servo(GRASPER, 0, 0.1, 0) is Code.OK
    assert table.gate.tripped is None and table.gate.check_tension().ok


def test_at_the_strain_limit_the_grasper_may_only_relax(table: Table) -> None:
    table.pull(0.5)
    table.servo(GRASPER, 0, -0.15, 0)
    table.bench.advance(TICK)
    table.lease.report_strain(0.6, table.bench.now())

    assert table.servo(GRASPER, 0, -0.1, 0) is Code.STRAIN
    assert table.servo(GRASPER, 0, 0.1, 0) is Code.OK


def test_unknown_strain_blocks_pulling(table: Table) -> None:
    table.pull(0.5)
    table.lease.report_strain(math.nan, table.bench.now())

    assert table.servo(GRASPER, 0, -0.1, 0) is Code.STRAIN


def test_strain_measured_too_long_ago_counts_as_unknown(table: Table) -> None:
    table.bench.advance(1.0)
    table.gate.report_strain(0.1, table.bench.now() - 0.8)

    assert math.isnan(table.gate.strain())


def test_letting_go_of_the_tissue_forgets_its_strain(table: Table) -> None:
    table.pull(0.5)
    table.lease.report_strain(0.6, table.bench.now())

    table.lease.move_jaw(GRASPER, 0.6)
    table.bench.advance(TICK)

    assert table.gate.strain() == 0.0


def test_without_a_grasp_only_backing_out_along_the_shaft_relieves_a_pressed_grasper(table: Table) -> None:
    table.bench.grasper.force = np.array([0.0, 0.0, -4.5])
    table.bench.advance(2 * TICK)
    back = -0.3 * table.bench.grasper.pose.rotation()[:, 2]

    assert table.servo(GRASPER, *(-back)) is Code.TENSION
    assert table.servo(GRASPER, *back) is Code.OK


def test_force_noise_and_single_wild_samples_do_not_trip(table: Table) -> None:
    rng = np.random.default_rng(0)

    for step in range(600):
        table.bench.grasper.force = 0.05 * rng.standard_normal(3) + (40.0 if step % 50 == 0 else 0.0)
        table.bench.advance(0.01)

    assert table.gate.tripped is None
    assert table.gate.tension() < table.gate.limits.loaded_tension


# Cuts


def test_closing_the_scissors_without_an_approval_is_refused_and_opening_is_not(table: Table) -> None:
    assert table.snip() is Code.CUT_NOT_APPROVED
    assert table.gate.cuts == 0


def test_an_approval_allows_cuts_until_it_expires(table: Table) -> None:
    table.approve(lasting=1.0)
    during = table.snip()
    table.bench.advance(1.1)

    assert during is Code.OK
    assert table.snip() is Code.CUT_NOT_APPROVED
    assert table.gate.approval is None


def test_a_withdrawn_approval_allows_nothing(table: Table) -> None:
    table.approve()
    table.gate.withdraw_approval()

    assert table.snip() is Code.CUT_NOT_APPROVED


def test_cuts_are_counted_per_approval_and_in_total() -> None:
    table = Table(replace(Limits(), max_cuts_per_approval=2, max_cuts_total=3))
    codes = []

    for _ in range(2):
        table.approve()
        codes += [table.snip() for _ in range(3)]

    assert codes == [Code.OK, Code.OK, Code.CUT_LIMIT, Code.OK, Code.CUT_LIMIT, Code.CUT_LIMIT]
    assert table.gate.cuts == 3


def test_closing_in_many_small_steps_is_many_cuts_not_none(table: Table) -> None:
    table.lease.move_jaw(CUTTER, 0.8)

    codes = {table.lease.move_jaw(CUTTER, 0.8 - 0.01 * step).report().code for step in range(1, 5)}

    assert codes == {Code.CUT_NOT_APPROVED}


def test_closing_the_grasper_is_no_cut(table: Table) -> None:
    assert table.lease.move_jaw(GRASPER, 0.0).report().code is Code.OK


def test_a_jaw_beyond_its_range_is_refused(table: Table) -> None:
    assert table.lease.move_jaw(GRASPER, 3.0).report().code is Code.WORKSPACE
