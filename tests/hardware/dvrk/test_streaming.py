"""Straight lines with limited speed, acceleration and turn."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware.dvrk.streaming import Pace, between, line, servo_line, turn, waypoints
from hardware.interface import Pose

PACE = Pace(0.02, 0.5)
coordinate = st.floats(-0.1, 0.1)


def poses() -> st.SearchStrategy[Pose]:
    def build(numbers: tuple[float, ...]) -> Pose:
        quaternion = np.array(numbers[3:]) + np.array([0.0, 0.0, 0.0, 3.0])
        return Pose(np.array(numbers[:3]), quaternion / np.linalg.norm(quaternion))

    return st.tuples(*[coordinate] * 3, *[st.floats(-1, 1)] * 4).map(build)


@settings(max_examples=60, deadline=None)
@given(poses(), poses())
def test_every_setpoint_lies_on_the_straight_line_and_none_is_too_fast(start: Pose, goal: Pose):
    path = line(start, goal, PACE)
    times = np.arange(0.0, path.duration + 0.02, 0.01)
    setpoints = [path.at(t) for t in times]
    positions = np.array([pose.position for pose in setpoints])

    way = goal.position - start.position
    off_line = np.linalg.norm(np.cross(positions - start.position, way), axis=1)
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    turns = [turn(a, b) for a, b in pairwise(setpoints)]

    assert off_line.max() <= 1e-9 * max(1.0, float(np.linalg.norm(way)))
    assert steps.max() <= PACE.linear * 0.01 * 1.001 + 1e-12
    assert max(turns) <= PACE.angular * 0.01 * 1.001 + 1e-7
    assert setpoints[-1] is goal
    assert all(abs(np.linalg.norm(pose.quaternion) - 1.0) < 1e-12 for pose in setpoints)


def test_the_arm_is_not_jerked_at_either_end():
    path = line(Pose(np.zeros(3), np.array([0, 0, 0, 1.0])), Pose(np.array([0.05, 0, 0]), np.array([0, 0, 0, 1.0])), PACE)
    speed = np.diff([path.at(t).position[0] for t in np.arange(0.0, path.duration, 0.01)]) / 0.01

    assert np.abs(np.diff(speed)).max() <= PACE.linear / PACE.ramp * 0.01 * 1.01
    assert speed[0] < 0.1 * PACE.linear and speed[-1] < 0.1 * PACE.linear


def test_a_quaternion_of_the_other_sign_is_no_turn():
    start = Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    goal = Pose(np.array([0.01, 0, 0]), np.array([0.0, 0.0, 0.0, -1.0]))

    assert max(turn(start, between(start, goal, f)) for f in (0.25, 0.5, 0.75)) < 1e-9


def test_a_servo_step_is_spread_over_the_time_until_the_next_one():
    start, goal = Pose(np.zeros(3), np.array([0, 0, 0, 1.0])), Pose(np.array([0.3e-3, 0, 0]), np.array([0, 0, 0, 1.0]))

    path = servo_line(start, goal, Pace(0.05, 1.5), 1 / 30)

    assert path.duration == pytest.approx(1 / 30, abs=1e-6)
    assert path.at(1 / 60).position[0] == pytest.approx(0.15e-3, rel=1e-3)


def test_waypoints_leave_no_part_of_the_way_unasked():
    path = line(Pose(np.zeros(3), np.array([0, 0, 0, 1.0])), Pose(np.array([0.01, 0, 0]), np.array([0, 0, 0, 1.0])), PACE)

    found = waypoints(path, 3e-3)

    gaps = np.diff([0.0, *(pose.position[0] for pose in found)])
    assert gaps.max() <= 3e-3 + 1e-12 and found[-1].position[0] == pytest.approx(0.01)
