"""When a motion of the robot counts as done: reference 2.4, and the holes of the upstream wait handle (traps 2, 3)."""

from dataclasses import replace

import pytest

from hardware.codes import Code
from hardware.dvrk.motion import SETTLE_WITHIN, Look, Motion, begin, follow
from hardware.interface import MoveStatus

START = 10.0


def look(now: float, **changes: object) -> Look:
    """At rest at the goal, all said."""
    well = Look(
        now=START + now,
        trouble=Code.OK,
        why="",
        busy=False,
        busy_at=START + 0.01,
        goal_reached=True,
        said="",
        setpoint_near=True,
        measured_near=True,
        stamp=START + now,
    )
    return replace(well, **changes)  # type: ignore[arg-type]


def after(*looks: Look, duration: float = 1.0) -> Motion:
    motion = begin(START, duration)
    for one in looks:
        motion = follow(motion, one, "PSM1", 0.5, 3)
    return motion


def code(motion: Motion) -> Code:
    assert motion.report.status is MoveStatus.FAILED
    return motion.report.code


NEVER_BUSY = {"busy_at": float("-inf"), "goal_reached": None}


def test_done_is_busy_then_rest_then_goal_reached_and_three_samples_near():
    moving = look(0.1, busy=True, goal_reached=None, measured_near=False, setpoint_near=False)

    early = after(moving, look(0.2), look(0.21), look(0.22))
    done = after(moving, look(0.2), look(0.21), look(0.22), look(0.23))

    assert early.report.status is MoveStatus.RUNNING
    assert done.report.status is MoveStatus.DONE


def test_a_motion_that_was_over_before_anybody_looked_is_done_too():
    assert after(look(0.02), look(0.03), look(0.04), look(0.05)).report.status is MoveStatus.DONE


def test_one_sample_seen_three_times_is_one_sample():
    same = look(0.2, stamp=START + 0.15)

    assert after(look(0.1), same, same, same, same).report.status is MoveStatus.RUNNING


def test_a_sample_away_from_the_goal_starts_the_count_anew():
    motion = after(look(0.1), look(0.2), look(0.21), look(0.22, measured_near=False), look(0.23), look(0.24))

    assert motion.report.status is MoveStatus.RUNNING


def test_a_command_that_makes_nothing_busy_was_rejected_with_the_robots_own_words():
    waiting = after(look(0.4, **NEVER_BUSY))
    ended = after(look(0.6, **NEVER_BUSY, said="PSM1: move_jp, arm not ready (3 errors)"))

    assert waiting.report.status is MoveStatus.RUNNING
    assert code(ended) is Code.MOVE_REJECTED and "arm not ready" in ended.report.message


def test_an_old_busy_pulse_accepts_nothing():
    assert code(after(look(0.6, busy_at=START - 0.001, goal_reached=None))) is Code.MOVE_REJECTED


def test_somebody_elses_busy_pulse_is_no_success():
    motion = after(look(0.1, goal_reached=None), look(0.2 + SETTLE_WITHIN, goal_reached=None))

    assert code(motion) is Code.MOVE_NOT_REACHED and "without saying" in motion.report.message


@pytest.mark.parametrize("missing", ["setpoint_near", "measured_near"])
def test_no_longer_busy_away_from_the_goal_is_no_success(missing: str):
    motion = after(look(0.1, **{missing: False}), look(0.2 + SETTLE_WITHIN, **{missing: False}))

    assert code(motion) is Code.MOVE_NOT_REACHED


def test_goal_reached_false_ends_the_motion_whatever_else_is_seen():
    assert code(after(look(0.1, busy=True, goal_reached=False))) is Code.MOVE_NOT_REACHED


def test_a_motion_that_never_ends_is_late():
    assert code(after(look(0.1, busy=True, goal_reached=None), look(3.1, busy=True, goal_reached=None))) is Code.MOVE_TIMEOUT


def test_an_arm_that_faults_is_no_longer_busy_and_has_not_arrived():
    motion = after(look(0.1, busy=True), look(0.2, trouble=Code.ARM_FAULT, why="PSM1 is fault"))

    assert code(motion) is Code.ARM_FAULT


def test_an_end_is_an_end():
    failed = after(look(0.1, goal_reached=False), look(0.2), look(0.3), look(0.4), look(0.5))

    assert failed.report.status is MoveStatus.FAILED
