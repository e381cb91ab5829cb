"""What was sent, held against the setpoint that the robot tells: followed, behind, at rest, or somebody else's."""

import numpy as np
import pytest

from hardware.codes import Code
from hardware.dvrk.config import ToleranceConfig
from hardware.dvrk.setpoints import Setpoints
from hardware.interface import Pose

PERIOD = 0.01


def pose(x: float, y: float = 0.0, turn: float = 0.0) -> Pose:
    return Pose(np.array([x, y, 0.0]), np.array([0.0, 0.0, np.sin(turn / 2), np.cos(turn / 2)]))


@pytest.fixture
def sent() -> Setpoints:
    return Setpoints(ToleranceConfig())


def stream(sent: Setpoints, until: float = 0.5, speed: float = 0.01) -> float:
    """A straight way along x at `speed` [m/s], followed at once; gives the time [s] of the last setpoint."""
    for k in range(round(until / PERIOD) + 1):
        sent.send(k * PERIOD, pose(speed * k * PERIOD))
        assert sent.judge(pose(speed * k * PERIOD), k * PERIOD + 1e-3, 0.0).ok
    return until


def test_what_is_followed_and_ends_where_it_was_sent_is_settled(sent: Setpoints):
    last = stream(sent)
    assert not sent.settled

    sent.rest()

    assert sent.judge(pose(5e-3), last + 0.02, 0.0).ok and sent.settled


def test_where_nothing_was_sent_the_setpoint_is_taken_for_what_is_to_stay(sent: Setpoints):
    assert sent.judge(pose(1.0), 0.0, 0.0).ok and sent.settled

    assert sent.judge(pose(1.0002), 0.1, 0.0).code is Code.FOREIGN_MOTION


@pytest.mark.parametrize(("delay", "ok"), [(0.05, True), (0.15, False)])
def test_a_setpoint_may_be_a_little_behind_but_not_for_long(sent: Setpoints, delay: float, ok: bool):
    verdicts = []
    for k in range(60):
        sent.send(k * PERIOD, pose(0.01 * k * PERIOD))
        verdicts.append(sent.judge(pose(max(0.0, 0.01 * (k * PERIOD - delay))), k * PERIOD, 0.0))

    found = next((verdict for verdict in verdicts if not verdict.ok), verdicts[-1])
    assert found.ok is ok
    assert ok or (found.code is Code.MOVE_REJECTED and not found.latched and "100 ms" in found.message)


def test_a_reading_that_is_old_says_nothing_of_what_was_sent_since(sent: Setpoints):
    last = stream(sent)
    for k in range(20):
        sent.send(last + k * PERIOD, pose(5e-3 + 1e-4 * k))

    assert sent.judge(pose(5e-3), last + 0.02, 0.0).ok


def test_a_robot_that_does_not_come_to_where_it_was_sent_does_not_obey(sent: Setpoints):
    last = stream(sent)
    sent.send(last, pose(6e-3))
    sent.rest()

    early = sent.judge(pose(5e-3), last + 0.08, 0.0)
    late = sent.judge(pose(5e-3), last + 0.35, 0.0)

    assert early.ok and not sent.settled
    assert late.code is Code.NOT_OBEYED and late.latched and "1.00 mm" in late.message


@pytest.mark.parametrize(("aside", "ok"), [(0.2e-3, True), (0.3e-3, False)])
def test_a_setpoint_far_beside_the_way_is_foreign_at_once(sent: Setpoints, aside: float, ok: bool):
    last = stream(sent)

    verdict = sent.judge(pose(5e-3, aside), last + 0.02, 0.0)

    assert verdict.ok is ok
    assert ok or (verdict.code is Code.FOREIGN_MOTION and verdict.latched)


def test_a_stranger_whose_commands_ours_replace_shows_by_a_little_each_time(sent: Setpoints):
    last = stream(sent)

    codes = [sent.judge(pose(5e-3, 0.04e-3), last + k * PERIOD, 0.0).code for k in range(1, 7)]

    assert codes[:4] == [Code.OK] * 4 and codes[-1] is Code.FOREIGN_MOTION


def test_a_frame_that_trembles_makes_no_setpoint_foreign(sent: Setpoints):
    last = stream(sent)

    assert all(sent.judge(pose(5e-3, 0.04e-3), last + k * PERIOD, 0.05e-3).ok for k in range(1, 9))


def test_the_last_setpoint_may_come_late_when_nothing_more_is_sent(sent: Setpoints):
    last = stream(sent, speed=4e-3)
    sent.rest()

    late = [sent.judge(pose(2e-3 - 0.04e-3), last + k * PERIOD, 0.0) for k in range(1, 9)]
    settled = sent.settled
    come = [sent.judge(pose(2e-3), last + 0.1 + k * PERIOD, 0.0) for k in range(1, 9)]

    assert all(verdict.ok for verdict in (*late, *come))
    assert not settled and sent.settled


def test_where_the_last_setpoint_was_lost_the_arm_rests_a_step_before_it(sent: Setpoints):
    last = stream(sent, speed=4e-3)
    sent.rest()

    verdicts = [sent.judge(pose(2e-3 - 0.04e-3), last + k * PERIOD, 0.0) for k in range(1, 60)]

    assert all(verdict.ok for verdict in verdicts) and sent.settled
    assert sent.judge(pose(2e-3 - 0.15e-3), last + 0.6, 0.0).code is Code.FOREIGN_MOTION


def test_a_stranger_who_creeps_at_rest_shows(sent: Setpoints):
    last = stream(sent)
    sent.rest()

    codes = [sent.judge(pose(5e-3 + 0.01e-3 * k), last + k * PERIOD, 0.0).code for k in range(20)]

    assert Code.FOREIGN_MOTION in codes


@pytest.mark.parametrize(("aside", "ok"), [(0.05e-3, True), (0.15e-3, False)])
def test_at_rest_less_is_foreign(sent: Setpoints, aside: float, ok: bool):
    last = stream(sent)
    sent.rest()
    sent.judge(pose(5e-3), last + 0.02, 0.0)

    assert sent.judge(pose(5e-3 + aside), last + 0.03, 0.0).ok is ok


def test_a_setpoint_that_turned_by_itself_is_foreign(sent: Setpoints):
    last = stream(sent)

    assert sent.judge(pose(5e-3, turn=0.1), last + 0.02, 0.0).code is Code.FOREIGN_MOTION


def test_an_arm_that_was_not_ours_may_be_anywhere(sent: Setpoints):
    last = stream(sent)

    sent.forget()

    assert sent.settled and sent.judge(pose(0.3), last + 0.02, 0.0).ok
