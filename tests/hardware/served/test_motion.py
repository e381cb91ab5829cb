"""Motion as the dVRK makes it (reference 1.3, 5 and 6.6): what is executed, what is altered without a word, and what is refused."""

import numpy as np
import pytest

from hardware.dvrk import kinematics
from hardware.dvrk import messages as m
from hardware.dvrk.instruments import instrument
from tests.hardware.served.conftest import ARMS

TOOL = instrument("FENESTRATED_BIPOLAR_FORCEPS:400205")
STILL = (0.0, 0.0, 0.0, 1.0)


def setpoint(robot, arm="PSM1"):
    return robot.newest(f"/{arm}/setpoint_js").position


def reached(robot, start, arm="PSM1"):
    return [message.data for message in robot.since(f"/{arm}/goal_reached", start)]


def busy(robot, start, arm="PSM1"):
    return [message.is_busy for message in robot.since(f"/{arm}/operating_state", start)]


def test_a_move_is_busy_then_reached_then_at_rest(robot):
    goal = np.array([0.05, -0.05, 0.13, 0.3, 0.1, -0.1])
    start = robot.bench.now()
    robot.joints("PSM1", "move_jp", goal)
    robot.go(2.0)

    assert busy(robot, start) == [True, False]
    assert reached(robot, start) == [True]
    np.testing.assert_allclose(setpoint(robot), goal, atol=1e-12)
    np.testing.assert_allclose(robot.newest("/PSM1/measured_js").position, goal, atol=3e-3)


def test_the_other_arm_does_not_care(robot):
    start = robot.bench.now()
    robot.joints("PSM1", "move_jp", [0.05, 0, 0.13, 0, 0, 0])
    robot.go(1.0)

    assert busy(robot, start, "PSM2") == [] and reached(robot, start, "PSM2") == []


def test_a_move_to_where_the_arm_is_ends_almost_at_once(robot):
    start = robot.bench.now()
    robot.joints("PSM1", "move_jp", setpoint(robot))
    robot.go(0.05)

    assert busy(robot, start) == [True, False]
    assert reached(robot, start) == [True]


def test_the_ratio_scales_a_move_and_is_told(robot):
    robot.send("/PSM1/trajectory_j/set_ratio", m.Float64(0.1))
    start = robot.bench.now()
    robot.joints("PSM1", "move_jp", [0, 0, 0.14, 0, 0, 0])
    robot.go(1.8)  # 20 mm at 20 mm/s with ramps of 1 s
    on_the_way = busy(robot, start)
    robot.go(0.4)

    assert robot.newest("/PSM1/trajectory_j/ratio").data == 0.1
    assert on_the_way == [True]
    assert busy(robot, start) == [True, False]


@pytest.mark.parametrize("ratio", [0.0, -0.5, 1.5, float("nan")])
def test_a_ratio_out_of_range_is_ignored_with_a_warning(robot, ratio):
    start = robot.bench.now()
    robot.send("/PSM1/trajectory_j/set_ratio", m.Float64(ratio))

    assert robot.newest("/PSM1/trajectory_j/ratio").data == 1.0
    assert len(robot.since("/PSM1/warning", start)) == 1


def test_a_cartesian_move_reaches_its_goal(robot):
    start = robot.bench.now()
    goal = robot.shift("PSM1", "move_cp", [0.005, -0.004, -0.010])
    robot.go(2.0)

    assert reached(robot, start) == [True]
    np.testing.assert_allclose(robot.newest("/PSM1/measured_cp").position, goal, atol=0.1e-3)


def test_the_tip_of_a_cartesian_move_does_not_go_straight(robot):
    begin = robot.newest("/PSM1/setpoint_cp")
    tilt = np.array([0.5, 0.0, 0.0, 0.8660254])
    x, y, z, w = begin.quaternion
    a, _, _, d = tilt
    turned = np.array([a * w + d * x, d * y - a * z, d * z + a * y, d * w - a * x])
    goal = begin.position + np.array([0.02, 0.02, -0.02])
    start = robot.bench.now()
    robot.pose("PSM1", "move_cp", goal, turned)
    robot.go(3.0)

    path = np.array([message.position for message in robot.since("/PSM1/setpoint_cp", start)])
    along = (goal - begin.position) / np.linalg.norm(goal - begin.position)
    away = path - begin.position
    bow = np.linalg.norm(away - np.outer(away @ along, along), axis=1).max()
    assert reached(robot, start) == [True]
    assert bow > 1e-3


def test_a_goal_beyond_the_joint_limits_is_clipped_without_a_word(robot):
    start = robot.bench.now()
    robot.joints("PSM1", "move_jp", [0, 0, 0.12, 0, 2.0, 0])
    robot.go(3.0)

    assert reached(robot, start) == [True]
    assert abs(setpoint(robot)[4] - TOOL.upper[4]) < 1e-12
    assert not robot.since("/PSM1/warning", start) and not robot.since("/PSM1/error", start)


def test_a_pose_too_shallow_is_pushed_deeper_without_a_word(robot):
    robot.joints("PSM1", "move_jp", [0, 0, 0.07, 0, 0, 0])
    start = robot.go(3.0)
    robot.shift("PSM1", "move_cp", [0, 0, 0.02])
    robot.go(2.0)

    assert abs(kinematics.depth(setpoint(robot)) - kinematics.KEEP_DEPTH) < 1e-9
    assert reached(robot, start)[-1] is True
    assert not robot.since("/PSM1/warning", start) and not robot.since("/PSM1/error", start)


def test_no_servo_in_space_while_the_instrument_is_in_its_cannula(robot):
    robot.joints("PSM1", "move_jp", [0, 0, 0.04, 0, 0, 0])
    robot.go(3.0)
    before = setpoint(robot)
    start = robot.bench.now()
    for _ in range(5):
        robot.shift("PSM1", "servo_cp", [0, 0, -1e-3])
    robot.go(0.2)

    np.testing.assert_array_equal(setpoint(robot), before)
    texts = [message.data for message in robot.since("/PSM1/warning", start)]
    assert len(texts) == 1 and "inserted past the cannula" in texts[0]


def test_a_shallow_cartesian_move_depends_on_the_mode_before(robot):
    """Reference 5: after a servo, it makes the arm busy and nothing else, until a hold."""
    robot.joints("PSM1", "move_jp", [0, 0, 0.04, 0, 0, 0])
    robot.go(3.0)
    robot.joints("PSM1", "servo_jp", setpoint(robot))
    before = setpoint(robot)
    start = robot.bench.now()
    robot.shift("PSM1", "move_cp", [0, 0, -0.04])
    robot.go(1.0)
    stuck = robot.state("PSM1").is_busy
    robot.send("/PSM1/hold", m.Empty())

    np.testing.assert_array_equal(setpoint(robot), before)
    assert stuck and not robot.state("PSM1").is_busy
    assert reached(robot, start) == [False]


def test_a_pose_that_cannot_be_solved_is_an_error_without_busy(robot):
    start = robot.bench.now()
    robot.pose("PSM1", "move_cp", [0.0, 0.0, 0.0], STILL)
    robot.go(0.2)

    assert "unable to solve inverse kinematics" in robot.newest("/PSM1/error").data
    assert True not in busy(robot, start)
    assert reached(robot, start) == [False]


def test_a_servo_that_cannot_be_solved_is_an_error_and_nothing_else(robot):
    start = robot.bench.now()
    robot.pose("PSM1", "servo_cp", [0.0, 0.0, 0.0], STILL)
    robot.go(0.2)

    assert "unable to solve inverse kinematics" in robot.newest("/PSM1/error").data
    assert reached(robot, start) == [] and busy(robot, start) == []


def test_a_quaternion_is_normalised_without_a_look(robot):
    now = robot.newest("/PSM1/setpoint_cp")
    start = robot.bench.now()
    robot.pose("PSM1", "servo_cp", now.position, 3.0 * now.quaternion)
    robot.go(0.1)
    robot.pose("PSM1", "servo_cp", now.position, np.zeros(4))

    assert np.abs(setpoint(robot) - [0, 0, 0.12, 0, 0, 0]).max() < 1e-6
    assert len(robot.since("/PSM1/error", start)) == 1  # of the quaternion without length alone


def test_numbers_that_are_none_end_in_a_fault(robot):
    robot.joints("PSM1", "servo_jp", [0, np.nan, 0.12, 0, 0, 0])

    assert robot.state("PSM1").state == "FAULT"
    assert "IO" in robot.newest("/PSM1/error").data


def test_a_servo_is_executed_at_once_whatever_its_stamp_and_frame(robot):
    goal = robot.shift("PSM1", "servo_cp", [0, 0, -0.5e-3])
    robot.go(0.02)

    np.testing.assert_allclose(robot.newest("/PSM1/setpoint_cp").position, goal, atol=1e-9)


def test_a_servo_is_no_busy_motion(robot):
    start = robot.bench.now()
    robot.shift("PSM1", "servo_cp", [0, 0, -0.5e-3])
    robot.go(0.2)

    assert busy(robot, start) == []


def test_relative_commands_count_from_the_setpoint(robot):
    robot.joints("PSM1", "servo_jr", [0.001, 0, 0, 0, 0, 0])
    robot.joints("PSM1", "servo_jr", [0.001, 0, 0, 0, 0, 0])
    robot.go(0.05)
    served = setpoint(robot)[0]
    robot.joints("PSM1", "move_jr", [0, 0, 0.01, 0, 0, 0])
    robot.go(2.0)

    assert abs(served - 0.002) < 1e-9
    np.testing.assert_allclose(setpoint(robot)[:3], [0.002, 0, 0.13], atol=1e-9)


def test_a_step_too_long_to_follow_is_a_tracking_fault(robot):
    robot.joints("PSM1", "servo_jp", [0.7, 0, 0.12, 0, 0, 0])
    robot.go(0.1)

    assert robot.state("PSM1").state == "FAULT"
    assert "tracking error, mask (1 for error): [1, 0" in robot.newest("/PSM1/error").data
    assert robot.state("PSM2").state == "ENABLED"  # nobody stops the other arm (6.5)


def test_a_new_goal_takes_the_place_of_the_old_one(robot):
    robot.joints("PSM1", "move_jp", [0.2, 0, 0.14, 0, 0, 0])
    start = robot.go(0.3)
    robot.joints("PSM1", "move_jp", [0.0, 0, 0.13, 0, 0, 0])
    robot.go(2.0)

    assert reached(robot, start) == [False, True]
    np.testing.assert_allclose(setpoint(robot), [0, 0, 0.13, 0, 0, 0], atol=1e-12)


def test_hold_stops_a_move_where_its_setpoint_is(robot):
    robot.joints("PSM1", "move_jp", [0.2, 0, 0.14, 0, 0, 0])
    robot.go(0.4)
    start = robot.bench.now()
    robot.send("/PSM1/hold", m.Empty())
    held = robot.served.arms["PSM1"].motion.setpoint[:6].copy()
    robot.go(0.5)

    assert reached(robot, start) == [False]
    assert busy(robot, start) == [False]
    np.testing.assert_array_equal(setpoint(robot), held)
    np.testing.assert_allclose(robot.newest("/PSM1/measured_js").position, held, atol=3e-3)


def test_without_a_client_a_move_runs_to_its_end(robot):
    """Reference 6.3: there is no watchdog for those who command."""
    goal = np.array([0.05, 0, 0.13, 0, 0, 0])
    robot.joints("PSM1", "move_jp", goal)
    robot.client.close()
    robot.go(2.0)

    np.testing.assert_allclose(robot.served.arms["PSM1"].motion.setpoint[:6], goal, atol=1e-12)


def test_an_arm_that_is_not_ready_warns_at_most_every_two_seconds(rig):
    start = rig.bench.now()
    for _ in range(50):
        rig.joints("PSM1", "move_jp", [0, 0, 0.1, 0, 0, 0])
        rig.go(0.1)

    texts = [message.data for message in rig.since("/PSM1/warning", start)]
    assert len(texts) == 3
    assert texts[0] == "PSM1: move_jp, arm not ready (1 errors)"
    assert texts[1] == "PSM1: move_jp, arm not ready (21 errors)"
    assert not rig.since("/PSM1/goal_reached", start)


def test_a_command_of_the_wrong_size_is_refused(robot):
    start = robot.bench.now()
    robot.joints("PSM1", "move_jp", [0.1, 0.1])
    robot.go(0.1)

    assert busy(robot, start) == []
    assert len(robot.since("/PSM1/warning", start)) == 1


@pytest.mark.parametrize("topic", ["free", "servo_jf", "jaw/servo_jf", "body/servo_cf", "spatial/servo_cf"])
def test_effort_of_any_part_lets_the_whole_arm_go_limp(robot, topic):
    robot.joints("PSM1", "move_jp", [0.2, 0, 0.14, 0, 0, 0])
    robot.go(0.3)
    start = robot.bench.now()
    message = {
        "free": m.Empty(),
        "servo_jf": m.JointState(0.0, (), np.zeros(6)),
        "jaw/servo_jf": m.JointState(0.0, (), np.zeros(1)),
    }
    robot.send(f"/PSM1/{topic}", message.get(topic, m.WrenchStamped(0.0, "", np.zeros(3), np.zeros(3))))
    robot.served.arms["PSM1"].plant.force = np.zeros(3)
    robot.go(0.5)

    assert reached(robot, start) == [False]
    gap = setpoint(robot) - robot.newest("/PSM1/measured_js").position
    assert np.abs(gap).max() < 5e-3  # the setpoint goes where the arm goes


def test_goals_are_in_the_reference_frame_and_local_poses_are_not(robot):
    base = np.array([0.1, 0.2, 0.3])
    robot.send("/PSM1/set_base_frame", m.PoseStamped(0.0, "ECM", base, np.array([0.0, 0.0, 1.0, 0.0])))  # half a turn about z
    robot.go(0.05)
    here, local = robot.newest("/PSM1/measured_cp"), robot.newest("/PSM1/local/measured_cp")
    goal = robot.shift("PSM1", "move_cp", [0.005, 0.0, 0.0])
    robot.go(2.0)

    assert here.frame_id == "ECM" and local.frame_id == "PSM1_base"
    np.testing.assert_allclose(here.position, base + local.position * [-1, -1, 1], atol=1e-9)
    moved = robot.newest("/PSM1/local/setpoint_cp").position - local.position
    np.testing.assert_allclose(moved, [-0.005, 0, 0], atol=0.1e-3)
    np.testing.assert_allclose(robot.newest("/PSM1/setpoint_cp").position, goal, atol=1e-9)


def test_forward_kinematics_answers_for_any_number_of_joints_and_frame(robot):
    robot.send("/PSM1/set_base_frame", m.PoseStamped(0.0, "ECM", np.array([0.1, 0, 0]), np.array(STILL)))
    ask = m.AskPose(np.array([0.0, 0.0, 0.12, 0.0, 0.0, 0.0]))
    local = robot.client.call("/PSM1/local/forward_kinematics", m.FORWARD_KINEMATICS, ask, 1.0)
    full = robot.client.call("/PSM1/forward_kinematics", m.FORWARD_KINEMATICS, ask, 1.0)
    short = robot.client.call("/PSM1/forward_kinematics", m.FORWARD_KINEMATICS, m.AskPose(np.array([0.0, 0.0])), 1.0)
    long = robot.client.call("/PSM1/forward_kinematics", m.FORWARD_KINEMATICS, m.AskPose(np.zeros(8)), 1.0)

    np.testing.assert_allclose(local.cp.position, [0, 0, -0.1151], atol=1e-9)
    np.testing.assert_allclose(full.cp.position, [0.1, 0, -0.1151], atol=1e-9)
    assert short.result and not long.result


def test_inverse_kinematics_takes_a_local_pose_whatever_the_base_frame_is(robot):
    robot.send("/PSM1/set_base_frame", m.PoseStamped(0.0, "ECM", np.array([0.1, 0, 0]), np.array(STILL)))
    robot.go(0.05)
    local = robot.newest("/PSM1/local/setpoint_cp")
    pose = m.Pose(local.position, local.quaternion)
    found = robot.client.call("/PSM1/inverse_kinematics", m.INVERSE_KINEMATICS, m.AskJoints(pose, np.zeros(6)), 1.0)
    nowhere = m.AskJoints(m.Pose(np.zeros(3), np.array(STILL)), np.zeros(6))
    lost = robot.client.call("/PSM1/inverse_kinematics", m.INVERSE_KINEMATICS, nowhere, 1.0)

    np.testing.assert_allclose(found.jp, setpoint(robot), atol=1e-9)
    assert found.result and not lost.result and "unable to solve" in lost.message


def test_the_version_of_crtk_is_told(robot):
    assert robot.client.call("/PSM1/crtk_version", m.TRIGGER, m.Ask(), 1.0) == m.AnswerTrigger(True, "1.1.0")


def test_the_bench_sees_what_the_joints_say(robot):
    """The whole chain: joint setpoint, tip pose, camera frame, stub arm, and back through the encoders."""
    for arm in ARMS:
        robot.joints(arm, "move_jp", [0.05, -0.05, 0.13, 0.3, 0.1, -0.1])
    robot.go(2.0)

    for arm in ARMS:
        assert np.linalg.norm(robot.bench.arms[arm].true_pose().position - robot.bench.arms[arm].setpoint_cp().position) < 0.4e-3
        tool = robot.served.arms[arm].plant.instrument
        expected = kinematics.forward(tool, np.array([0.05, -0.05, 0.13, 0.3, 0.1, -0.1]))
        np.testing.assert_allclose(robot.newest(f"/{arm}/local/measured_cp").position, expected[:3, 3], atol=0.05e-3)
