"""Joint trajectories: synchronised, limited, at rest at the end, and taken up from any velocity."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware.served.trajectory import ACCELERATION, SPEED, plan

joint = st.floats(-2.0, 2.0)
sevens = st.lists(joint, min_size=7, max_size=7).map(np.array)


@settings(max_examples=60, deadline=None)
@given(sevens, sevens, sevens, st.floats(0.05, 1.0))
def test_a_trajectory_keeps_to_its_limits_and_ends_at_the_goal(start, goal, share, ratio):
    speed, acceleration = ratio * SPEED, ratio * ACCELERATION
    velocity = 0.5 * share * speed

    trajectory = plan(start, velocity, goal, speed, acceleration)

    times = np.linspace(0.0, trajectory.duration, 400)
    positions, velocities = (np.array(rows) for rows in zip(*(trajectory.at(t) for t in times), strict=True))
    assert (np.abs(velocities) <= speed + 1e-9).all()
    steps = np.diff(velocities, axis=0) / max(times[1] - times[0], 1e-12)
    assert (np.abs(steps[:-1]) <= acceleration * (1 + 1e-6) + 1e-6).all()
    np.testing.assert_allclose(positions[0], start, atol=1e-12)
    before_end = trajectory.at(trajectory.duration - 1e-7)
    np.testing.assert_allclose(before_end[0], goal, atol=1e-5)
    np.testing.assert_allclose(before_end[1], 0.0, atol=1e-4)


def test_all_joints_arrive_together():
    goal = np.array([0.3, 0.01, 0.0, 1.0, 0.0, 0.0, 0.5])

    trajectory = plan(np.zeros(7), np.zeros(7), goal, SPEED, ACCELERATION)

    almost, _ = trajectory.at(0.97 * trajectory.duration)
    moved = goal > 0
    assert (almost[moved] < goal[moved] - 1e-7).all()


def test_the_time_is_that_of_the_slowest_joint_at_its_limits():
    goal = np.array([1.0, 0, 0, 0, 0, 0, 0])

    trajectory = plan(np.zeros(7), np.zeros(7), goal, 0.1 * SPEED, 0.1 * ACCELERATION)

    v = a = 0.1 * np.pi / 2  # ramps of 1 s each, v a ramp's peak
    assert abs(trajectory.duration - (1.0 / v + v / a)) < 1e-9


def test_a_goal_that_is_already_reached_takes_no_time():
    here = np.full(7, 0.2)

    assert plan(here, np.zeros(7), here, SPEED, ACCELERATION).duration == 0.0


def test_a_joint_too_fast_to_stop_before_its_goal_comes_back_to_it():
    velocity = np.array([1.0, 0, 0, 0, 0, 0, 0])

    trajectory = plan(np.zeros(7), velocity, np.full(7, 0.05), SPEED, ACCELERATION)

    furthest = max(trajectory.at(t)[0][0] for t in np.linspace(0, trajectory.duration, 200))
    assert furthest > 0.2
    np.testing.assert_allclose(trajectory.at(trajectory.duration)[0], 0.05)
