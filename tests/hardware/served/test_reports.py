"""Telemetry (reference 1.2): rates, frames, and that every part agrees with every other."""

import numpy as np
import pytest

from hardware.dvrk import kinematics
from hardware.dvrk import messages as m
from hardware.dvrk.calibration import arm_frames, load_hand_eye, to_camera
from hardware.interface import Pose
from hardware.served.wires import EVENTS

PUBLISHED = [
    "operating_state",
    "measured_js",
    "setpoint_js",
    "measured_cp",
    "setpoint_cp",
    "measured_cv",
    "local/measured_cp",
    "local/setpoint_cp",
    "body/measured_cf",
    "spatial/measured_cf",
    "body/jacobian",
    "spatial/jacobian",
    "jaw/measured_js",
    "jaw/setpoint_js",
    "trajectory_j/ratio",
]
HEARD = [
    "state_command",
    "hold",
    "free",
    "servo_jp",
    "servo_jr",
    "servo_cp",
    "servo_jf",
    "move_jp",
    "move_jr",
    "move_cp",
    "body/servo_cf",
    "spatial/servo_cf",
    "jaw/servo_jp",
    "jaw/move_jp",
    "jaw/servo_jf",
    "body/set_cf_orientation_absolute",
    "use_gravity_compensation",
    "trajectory_j/set_ratio",
    "emulate_tool_present",
]
ANSWERED = ["forward_kinematics", "inverse_kinematics", "local/forward_kinematics"]


@pytest.mark.parametrize("arm", ["PSM1", "PSM2"])
def test_everything_that_the_upstream_client_connects_to_is_there(rig, arm):
    """Reference 4.2: its check_connections fails if one of these is missing."""
    assert [topic for topic in PUBLISHED if not rig.graph.offers[f"/{arm}/{topic}"]] == []
    assert [topic for topic in HEARD if not rig.graph.listeners[f"/{arm}/{topic}"]] == []
    assert [name for name in ANSWERED if f"/{arm}/{name}" not in rig.graph.services] == []


def test_what_is_told_on_events_is_latched():
    unlatched = {topic for topic, (_, latched) in EVENTS.items() if not latched}

    assert unlatched == {"tool_type_request", "arm_clutch"}


def test_telemetry_comes_a_hundred_times_per_second_of_bench_time(robot):
    start = robot.go(2.0)

    assert len([1 for at, _ in robot.heard["/PSM2/measured_cp"] if at > start]) == 200


def test_measured_joints_are_those_of_the_measured_pose(robot):
    robot.joints("PSM1", "move_jp", [0.1, 0.05, 0.14, 1.0, 0.4, -0.3])
    for _ in range(20):
        robot.go(0.1)
        joints = robot.newest("/PSM1/measured_js").position
        pose = robot.newest("/PSM1/local/measured_cp")
        reached = kinematics.forward(robot.config.grasper.instrument, joints)
        np.testing.assert_allclose(reached[:3, 3], pose.position, atol=2e-6)
        assert 1.0 - abs(Pose.from_matrix(reached[:3, :3], pose.position).quaternion @ pose.quaternion) < 1e-8


def test_velocities_are_those_of_the_motion(robot):
    robot.send("/PSM1/trajectory_j/set_ratio", m.Float64(0.1))
    robot.joints("PSM1", "move_jp", [0, 0, 0.18, 0, 0, 0])
    start = robot.go(1.5)
    cruising = [message for message in robot.since("/PSM1/measured_js", start + 1.2)]

    assert abs(np.mean([message.velocity[2] for message in cruising]) - 0.02) < 0.5e-3
    assert abs(robot.newest("/PSM1/setpoint_js").velocity[2] - 0.02) < 1e-9
    twists = [message.linear for message in robot.since("/PSM1/measured_cv", start + 1.2)]
    np.testing.assert_allclose(np.mean(twists, axis=0), [0, 0, -0.02], atol=0.5e-3)


def test_jacobians_are_told_in_both_frames(robot):
    robot.joints("PSM1", "move_jp", [0.1, 0.05, 0.14, 1.0, 0.4, -0.3])
    robot.go(2.5)
    joints = robot.newest("/PSM1/measured_js").position
    tool = robot.config.grasper.instrument
    tip = kinematics.forward(tool, joints)
    expected = kinematics.jacobian(tool, joints)

    body, spatial = robot.newest("/PSM1/body/jacobian").data, robot.newest("/PSM1/spatial/jacobian").data
    np.testing.assert_allclose(tip[:3, :3] @ body[:3], expected[:3], atol=1e-3)
    np.testing.assert_allclose(tip[:3, :3] @ body[3:], expected[3:], atol=1e-3)
    np.testing.assert_allclose(spatial[3:], expected[3:], atol=1e-3)
    at_tip = spatial[:3] + np.cross(spatial[3:].T, tip[:3, 3]).T
    np.testing.assert_allclose(at_tip, expected[:3], atol=1e-3)


def test_the_calibration_written_turns_reported_poses_into_what_the_camera_sees(robot):
    """The way of a client: hand-eye file, jaw length, and the pose that the robot tells."""
    robot.joints("PSM2", "move_jp", [0.1, 0.05, 0.14, 1.0, 0.4, -0.3])
    robot.go(2.5)
    arm = robot.config.cutter
    frames = arm_frames(load_hand_eye(arm.calibration, arm.name), arm)
    told = robot.newest("/PSM2/measured_cp")

    seen = to_camera(frames, Pose(told.position, told.quaternion))
    true = robot.bench.arms["PSM2"].true_pose()
    assert np.linalg.norm(seen.position - true.position) < 0.3e-3
    assert seen.angle_to(true) < 0.01


def test_the_force_of_the_tip_is_the_stubs_in_another_frame(robot):
    force = np.array([0.1, 0.2, -0.3])
    robot.served.arms["PSM1"].plant.arm._measured_cf = type(robot.bench.arms["PSM1"].measured_cf())(force, robot.bench.now())
    robot.served.arms["PSM1"].plant.measure()
    robot.served._wires["PSM1"].report(0.0)
    frames = arm_frames(load_hand_eye(robot.config.grasper.calibration, "PSM1"), robot.config.grasper)
    told, pose = robot.newest("/PSM1/body/measured_cf"), robot.newest("/PSM1/local/measured_cp")

    turned = frames.camera_from_base[:3, :3] @ Pose(pose.position, pose.quaternion).rotation() @ told.force
    np.testing.assert_allclose(turned, force, atol=1e-9)
    assert told.frame_id == "PSM1"


def test_nobody_listening_costs_no_message(make_rig):
    rig = make_rig()
    rig.client.close()
    made = []
    wires = rig.served._wires["PSM1"]
    wires._reports = [(publisher, lambda readings: made.append(1)) for publisher, _ in wires._reports]
    rig.go(0.5)

    assert made == []
