"""The jaw and its traps (reference 7.5 to 7.8): it shares mode and busy with its arm, and remembers old goals."""

import numpy as np
import pytest

from hardware.dvrk import messages as m


def angle(robot, arm="PSM1"):
    return float(robot.newest(f"/{arm}/jaw/setpoint_js").position[0])


def measured(robot, arm="PSM1"):
    return float(robot.newest(f"/{arm}/jaw/measured_js").position[0])


def reached(robot, start, arm="PSM1"):
    return [message.data for message in robot.since(f"/{arm}/goal_reached", start)]


def move(robot, goal, duration=1.5, arm="PSM1"):
    robot.joints(arm, "jaw/move_jp", goal)
    return robot.go(duration)


def test_the_jaw_moves_and_makes_its_arm_busy(robot):
    start = robot.bench.now()
    move(robot, 0.3)

    states = [message.is_busy for message in robot.since("/PSM1/operating_state", start)]
    assert states == [True, False] and reached(robot, start) == [True]
    assert angle(robot) == 0.3 and abs(measured(robot) - 0.3) < 0.01


def test_homing_brings_the_jaw_within_the_instruments_limits(robot):
    assert abs(angle(robot, "PSM2") - np.radians(30)) < 1e-9  # Potts scissors; the stub begins further open


def test_a_jaw_goal_beyond_the_limits_is_clipped(robot):
    move(robot, 1.2, arm="PSM2")
    widest = angle(robot, "PSM2")
    move(robot, -1.0, arm="PSM2")

    assert abs(widest - np.radians(30)) < 1e-9
    assert abs(angle(robot, "PSM2") + 0.698132) < 1e-5


def test_a_jaw_that_presses_stays_closed_and_tells_its_effort(robot):
    move(robot, -0.35)

    jaw = robot.newest("/PSM1/jaw/measured_js")
    assert abs(jaw.position[0]) < 0.01 and jaw.effort[0] < -0.05


def test_a_servo_command_ends_the_jaws_move(robot):
    robot.joints("PSM1", "jaw/move_jp", 0.0)
    robot.go(0.1)
    start = robot.bench.now()
    robot.shift("PSM1", "servo_cp", [0, 0, 0])
    stopped = robot.served.arms["PSM1"].motion.setpoint[6]
    robot.go(0.5)

    assert reached(robot, start) == [False]
    assert not robot.state("PSM1").is_busy
    assert angle(robot) == stopped > 0.1


def test_a_jaw_between_servo_commands_only_crawls(robot):
    before = angle(robot)
    for _ in range(30):
        robot.shift("PSM1", "servo_cp", [0, 0, 0])
        robot.joints("PSM1", "jaw/move_jp", 0.0)
        robot.go(1 / 120)

    assert before - angle(robot) < 0.1  # at full speed it would have been shut


def test_a_move_of_the_arm_takes_the_jaw_along_to_its_old_goal(robot):
    move(robot, 0.6)
    for target in np.linspace(0.6, -0.1, 40):
        robot.joints("PSM1", "jaw/servo_jp", target)
        robot.go(1 / 60)
    closed = angle(robot)
    robot.shift("PSM1", "move_cp", [0, 0, -0.005])
    robot.go(2.0)

    assert abs(closed + 0.1) < 1e-9
    assert abs(angle(robot) - 0.6) < 1e-9


def test_a_jaw_moved_to_where_it_is_forgets_the_old_goal(robot):
    move(robot, 0.6)
    for target in np.linspace(0.6, 0.0, 40):
        robot.joints("PSM1", "jaw/servo_jp", target)
        robot.go(1 / 60)
    move(robot, 0.0, 0.1)
    robot.shift("PSM1", "move_cp", [0, 0, -0.005])
    robot.go(2.0)

    assert angle(robot) == 0.0


def test_a_servoed_jaw_is_not_clipped(robot):
    for target in np.linspace(angle(robot, "PSM2"), 0.7, 10):
        robot.joints("PSM2", "jaw/servo_jp", target)
        robot.go(1 / 60)

    assert angle(robot, "PSM2") == 0.7


def test_a_jaw_move_leaves_the_arm_where_it_was_servoed_to(robot):
    robot.joints("PSM1", "move_jp", [0, 0, 0.13, 0, 0, 0])
    robot.go(1.5)
    robot.shift("PSM1", "servo_cp", [0.5e-3, 0, 0])
    robot.go(0.1)
    before = robot.newest("/PSM1/setpoint_js").position
    move(robot, 0.2)

    np.testing.assert_allclose(robot.newest("/PSM1/setpoint_js").position, before, atol=1e-12)


def test_closing_forceps_on_tissue_grasps_it_and_shows_a_pull(robot):
    goal = robot.bench.scene.goal.grasp
    rest = robot.bench.phantom.mesh.rest
    height = robot.bench.phantom.positions[np.argmin(np.linalg.norm(rest - goal, axis=1)), 2]
    target = robot.bench.to_camera(np.array([[*goal, height - 0.5e-3]]))[0]
    way = target - robot.bench.arms["PSM1"].setpoint_cp().position
    plant = robot.served.arms["PSM1"].plant
    turn = plant._frames.camera_from_base[:3, :3]
    robot.shift("PSM1", "move_cp", turn.T @ way)
    robot.go(3.0)
    move(robot, -0.35, 2.0)
    robot.shift("PSM1", "move_cp", turn.T @ np.array([0.0, 0.0, -8e-3]))
    robot.go(2.0)

    assert robot.bench.phantom.grip is not None
    assert np.linalg.norm(robot.newest("/PSM1/body/measured_cf").force) > 0.15


@pytest.mark.parametrize("topic", ["jaw/move_jp", "jaw/servo_jp"])
def test_a_jaw_command_without_a_number_is_a_fault(robot, topic):
    robot.send(f"/PSM1/{topic}", m.JointState(0.0, (), np.array([np.nan])))

    assert robot.state("PSM1").state == "FAULT"
