"""Every fault of reference section 10 can be put in effect, shows as it would on a robot, and ends when it is cleared."""

import numpy as np
import pytest

from hardware.codes import InputError
from hardware.dvrk import messages as m
from hardware.served.faults import OF_ROBOT, ONCE, Fault
from hardware.served.node import Serving


def begun(robot, fault, arm="PSM1", duration=0.1):
    """Inject, and let some time pass; gives when it began."""
    start = robot.bench.now()
    robot.served.inject(fault, arm)
    robot.go(duration)
    return start


def test_an_arm_that_is_not_ready_rejects_without_busy(robot):
    start = begun(robot, Fault.NOT_READY)
    robot.joints("PSM1", "move_jp", [0.1, 0, 0.13, 0, 0, 0])
    robot.go(0.5)

    assert "arm not ready" in robot.newest("/PSM1/warning").data
    assert robot.since("/PSM1/operating_state", start) == []


def test_lost_commands_leave_no_trace(robot):
    start = begun(robot, Fault.LOST_COMMANDS)
    robot.joints("PSM1", "move_jp", [0.1, 0, 0.13, 0, 0, 0])
    robot.go(0.5)

    assert not robot.since("/PSM1/operating_state", start) and not robot.since("/PSM1/warning", start)


def test_inverse_kinematics_may_fail_on_any_pose(robot):
    start = begun(robot, Fault.IK_FAILURE)
    robot.shift("PSM1", "move_cp", [0, 0, -0.005])
    robot.go(0.1)

    assert "unable to solve inverse kinematics" in robot.newest("/PSM1/error").data
    assert [message.data for message in robot.since("/PSM1/goal_reached", start)] == [False]


def test_a_busy_pulse_comes_from_nowhere(robot):
    start = begun(robot, Fault.BUSY_PULSE)

    assert [message.is_busy for message in robot.since("/PSM1/operating_state", start)] == [True, False]
    assert not robot.since("/PSM1/goal_reached", start)


def test_a_move_may_end_short_of_its_goal(robot):
    robot.joints("PSM1", "move_jp", [0.2, 0, 0.14, 0, 0, 0])
    robot.go(0.3)
    start = begun(robot, Fault.INTERRUPT)

    assert [message.data for message in robot.since("/PSM1/goal_reached", start)] == [False]
    assert not robot.state("PSM1").is_busy


def test_a_dead_robot_computer_says_and_does_nothing(robot):
    robot.joints("PSM1", "move_jp", [0.2, 0, 0.16, 0, 0, 0])
    robot.go(0.3)
    start = begun(robot, Fault.SILENT, "", 0.5)
    stopped = robot.bench.arms["PSM1"].true_pose().position
    robot.command("PSM1", "enable")
    robot.go(0.5)

    for topic in ("measured_cp", "measured_js", "operating_state", "goal_reached"):
        assert not robot.since(f"/PSM1/{topic}", start + 1e-6)
    np.testing.assert_array_equal(robot.bench.arms["PSM1"].true_pose().position, stopped)


def test_a_computer_that_was_started_anew_finds_its_arms_without_power(robot):
    begun(robot, Fault.SILENT, "", 0.5)
    robot.served.clear("silent")

    assert robot.state("PSM1").state == "FAULT"


def test_frozen_values_come_with_fresh_stamps(robot):
    robot.joints("PSM1", "move_jp", [0.2, 0, 0.14, 0, 0, 0])
    robot.go(0.2)
    start = begun(robot, Fault.FROZEN, duration=0.5)

    told = robot.since("/PSM1/measured_js", start + 0.02)
    assert len({tuple(message.position) for message in told}) == 1
    assert told[-1].stamp - told[0].stamp > 0.4
    assert robot.bench.arms["PSM1"].true_pose().position[0] != 0.0


def test_the_robot_may_call_its_data_invalid(robot):
    begun(robot, Fault.STAMP_ZERO)

    cp = robot.newest("/PSM1/measured_cp")
    assert cp.stamp == 0.0 and not cp.position.any()
    assert robot.newest("/PSM1/jaw/measured_js").stamp == robot.newest("/PSM1/measured_js").stamp == 0.0
    assert robot.newest("/PSM2/measured_cp").stamp > 0.0


def test_stamps_may_stand_still(robot):
    start = begun(robot, Fault.STAMP_STALE, duration=0.3)

    assert len({message.stamp for message in robot.since("/PSM1/measured_cp", start + 0.02)}) == 1


def test_a_pose_may_hold_no_numbers(robot):
    begun(robot, Fault.NAN_POSE)

    assert np.isnan(robot.newest("/PSM1/measured_cp").position).all()
    assert np.isnan(robot.newest("/PSM1/local/measured_cp").position).all()


def test_a_quaternion_may_be_too_long(robot):
    begun(robot, Fault.NON_UNIT_QUATERNION)

    assert abs(np.linalg.norm(robot.newest("/PSM1/measured_cp").quaternion) - 1.1) < 1e-9


def test_poses_may_come_in_another_frame(robot):
    begun(robot, Fault.FRAME_ID)

    assert robot.newest("/PSM1/measured_cp").frame_id == "ECM"


def test_the_base_frame_may_jump(robot):
    before = robot.newest("/PSM1/measured_cp").position
    local = robot.newest("/PSM1/local/measured_cp").position
    begun(robot, Fault.BASE_JUMP)

    np.testing.assert_allclose(robot.newest("/PSM1/measured_cp").position - before, [5e-3, 0, 0], atol=0.1e-3)
    np.testing.assert_allclose(robot.newest("/PSM1/local/measured_cp").position, local, atol=0.1e-3)


def test_without_an_instrument_there_are_seven_actuators_and_no_pose(robot):
    begun(robot, Fault.TOOL_REMOVED)

    assert len(robot.newest("/PSM1/measured_js").position) == len(robot.newest("/PSM1/setpoint_js").position) == 7
    assert robot.newest("/PSM1/measured_js").stamp > 0.0
    assert robot.newest("/PSM1/measured_cp").stamp == 0.0
    assert robot.newest("/PSM1/tool_type").data == ""


def test_an_instrument_that_is_put_back_is_engaged_again(robot):
    begun(robot, Fault.TOOL_REMOVED)
    robot.served.clear("tool_removed", "PSM1")
    robot.go(1.0)

    assert robot.newest("/PSM1/tool_type").data == "FENESTRATED_BIPOLAR_FORCEPS:400205"
    assert robot.newest("/PSM1/measured_cp").stamp > 0.0


def test_the_client_may_emulate_a_missing_instrument(robot):
    robot.send("/PSM1/emulate_tool_present", m.Bool(False))
    robot.go(0.05)

    assert robot.newest("/PSM1/tool_type").data == ""


def test_another_instrument_may_be_told(robot):
    begun(robot, Fault.TOOL_CHANGED)
    other = robot.newest("/PSM1/tool_type").data
    robot.served.clear()

    assert other == "LARGE_NEEDLE_DRIVER:400006"
    assert robot.newest("/PSM1/tool_type").data == "FENESTRATED_BIPOLAR_FORCEPS:400205"


def test_another_instrument_may_be_mounted(robot):
    robot.send("/PSM1/set_tool_type", m.String("LARGE_NEEDLE_DRIVER:400006"))
    robot.go(0.1)
    mounted = robot.newest("/PSM1/tool_type").data
    robot.send("/PSM1/set_tool_type", m.String("SPOON:1"))
    robot.go(0.1)

    assert mounted == "LARGE_NEEDLE_DRIVER:400006"
    assert robot.newest("/PSM1/tool_type").data == "ERROR"


@pytest.mark.parametrize(
    ("fault", "text"),
    [
        (Fault.FAULT_TRACKING, "tracking error, mask (1 for error)"),
        (Fault.FAULT_POWER, "detected power loss (actuators)"),
        (Fault.FAULT_WATCHDOG, "watchdog triggered"),
    ],
)
def test_one_arm_may_fault_and_the_other_goes_on(robot, fault, text):
    for arm in ("PSM1", "PSM2"):
        robot.joints(arm, "move_jp", [0.1, 0, 0.14, 0, 0, 0])
    robot.go(0.2)
    begun(robot, fault, duration=0.2)
    stopped = robot.bench.arms["PSM1"].true_pose().position
    robot.go(0.1)

    assert (robot.state("PSM1").state, robot.state("PSM1").is_busy) == ("FAULT", False)
    assert text in robot.newest("/PSM1/error").data
    np.testing.assert_array_equal(robot.bench.arms["PSM1"].true_pose().position, stopped)
    assert robot.state("PSM2").is_busy


def test_a_fault_is_left_by_enabling_anew(robot):
    begun(robot, Fault.FAULT_POWER)
    robot.command("PSM1", "home")  # not granted in FAULT
    robot.command("PSM1", "enable")
    robot.go(0.5)

    assert (robot.state("PSM1").state, robot.state("PSM1").is_homed) == ("ENABLED", True)


def test_a_pressed_clutch_makes_the_arm_busy_and_limp(robot):
    start = begun(robot, Fault.CLUTCH)
    busy = robot.state("PSM1")
    robot.joints("PSM1", "move_jp", [0.1, 0, 0.14, 0, 0, 0])
    robot.go(0.2)
    robot.served.clear("clutch")

    assert (busy.state, busy.is_busy) == ("ENABLED", True)
    assert "arm not ready" in robot.newest("/PSM1/warning").data
    assert [message.buttons for message in robot.since("/PSM1/arm_clutch", start)] == [(1,), (0,)]
    assert not robot.state("PSM1").is_busy


def test_a_foreign_servo_moves_the_setpoint(robot):
    before = robot.newest("/PSM1/setpoint_cp").position
    begun(robot, Fault.FOREIGN_SERVO, duration=0.5)
    after = robot.newest("/PSM1/setpoint_cp").position

    np.testing.assert_allclose(after - before, [2.5e-3, 0, 0], atol=0.1e-3)


def test_a_foreign_servo_interrupts_a_move(robot):
    robot.joints("PSM1", "move_jp", [0.2, 0, 0.14, 0, 0, 0])
    robot.go(0.2)
    start = begun(robot, Fault.FOREIGN_SERVO)

    assert [message.data for message in robot.since("/PSM1/goal_reached", start)] == [False]


def test_a_blocked_jaw_stays_open_and_presses(robot):
    begun(robot, Fault.JAW_BLOCKED)
    robot.joints("PSM1", "jaw/move_jp", -0.35)
    robot.go(2.0)
    jaw = robot.newest("/PSM1/jaw/measured_js")
    robot.served.clear("jaw_blocked")
    robot.go(1.0)

    assert abs(jaw.position[0] - 0.45) < 0.01
    assert jaw.effort[0] < -0.2
    assert abs(robot.newest("/PSM1/jaw/measured_js").position[0]) < 0.01


def test_a_jaw_that_slips_loses_the_tissue_and_falls_shut(robot):
    begun(robot, Fault.JAW_BLOCKED)
    robot.joints("PSM1", "jaw/move_jp", -0.35)
    robot.go(2.0)
    released = []
    robot.bench.phantom.release = lambda: released.append(1)
    robot.served.clear("jaw_blocked")
    begun(robot, Fault.JAW_SLIPS, duration=1.0)

    assert released == [1]
    assert abs(robot.newest("/PSM1/jaw/measured_js").position[0]) < 0.01


def test_a_stale_jaw_goal_opens_a_grasp(robot):
    robot.joints("PSM1", "jaw/move_jp", 0.0)
    robot.go(1.5)
    begun(robot, Fault.JAW_STALE_GOAL)
    robot.shift("PSM1", "move_cp", [0, 0, -0.005])
    robot.go(2.0)

    assert robot.newest("/PSM1/jaw/setpoint_js").position[0] > 1.0


def test_an_old_error_waits_for_who_comes_later(robot):
    begun(robot, Fault.LATCHED_ERROR)
    heard = []
    robot.graph.node("late").subscribe("/PSM1/error", m.String, lambda x, t: heard.append(x.data))

    assert len(heard) == 1 and "yesterday" in heard[0]
    assert robot.state("PSM1").state == "ENABLED"


@pytest.mark.parametrize(("fault", "offset"), [(Fault.CLOCK_AHEAD, 5.0), (Fault.CLOCK_BEHIND, -5.0)])
def test_the_robots_clock_may_be_wrong(robot, fault, offset):
    begun(robot, fault, "")

    for topic in ("/PSM1/measured_cp", "/PSM2/measured_js"):
        assert abs(robot.newest(topic).stamp - robot.client.stamp() - offset) < 0.03


def test_the_emergency_stop_takes_power_from_both_arms(robot):
    begun(robot, Fault.EMERGENCY_STOP, "")
    stopped = [robot.state(arm).state for arm in ("PSM1", "PSM2")]
    robot.command("PSM1", "enable")
    robot.go(0.5)
    refused = robot.state("PSM1").state
    robot.served.clear("emergency_stop")
    robot.command("PSM1", "disable")
    robot.command("PSM1", "enable")
    robot.go(0.5)

    assert robot.bench.emergency_stop() is False
    assert stopped == ["FAULT", "FAULT"]
    assert refused == "FAULT" and "failed to enable power" in str([x.data for _, x in robot.heard["/PSM1/error"]])
    assert robot.state("PSM1").state == "ENABLED"


@pytest.mark.parametrize(
    ("fault", "topic", "kind", "value"),
    [
        (Fault.TELEOP_FOLLOWING, "/MTMR_PSM1/following", m.Bool, True),
        (Fault.TELEOP_ENABLED, "/console/teleop/enabled", m.Bool, True),
        (Fault.OPERATOR_ABSENT, "/console/operator_present", m.Joy, (0,)),
    ],
)
def test_the_console_may_take_over_or_be_left(robot, fault, topic, kind, value):
    robot.listen(topic, kind)
    robot.served.inject(fault)
    told = robot.newest(topic)
    robot.served.clear(fault)

    assert value == (told.buttons if kind is m.Joy else told.data)
    assert value != (robot.newest(topic).buttons if kind is m.Joy else robot.newest(topic).data)


def test_the_endoscope_may_be_moved(robot):
    robot.listen("/ECM/local/measured_cp", m.PoseStamped)
    begun(robot, Fault.ENDOSCOPE_MOVED, "")

    np.testing.assert_allclose(robot.newest("/ECM/local/measured_cp").position, [0, 0, 3e-3])


@pytest.fixture
def camera(make_rig):
    rig = make_rig(serving=Serving(pictures=10.0))
    for eye in ("left", "right"):
        rig.listen(f"/stereo/{eye}/image_raw", m.Picture)
        rig.listen(f"/stereo/{eye}/camera_info", m.CameraInfo)
    return rig


def test_one_eye_may_be_missing(camera):
    start = begun(camera, Fault.EYE_MISSING, "", 0.35)

    assert len(camera.since("/stereo/left/image_raw", start)) == 3
    assert camera.since("/stereo/right/image_raw", start) == []


def test_the_eyes_may_be_skewed(camera):
    begun(camera, Fault.SKEWED_STAMPS, "", 0.2)

    skew = camera.newest("/stereo/right/image_raw").stamp - camera.newest("/stereo/left/image_raw").stamp
    assert abs(skew - 0.05) < 1e-6


def test_the_camera_may_be_uncalibrated(camera):
    begun(camera, Fault.ZERO_K, "", 0.2)

    assert not camera.newest("/stereo/left/camera_info").K.any()
    assert not camera.newest("/stereo/right/camera_info").P.any()


def test_the_camera_may_stop(camera):
    camera.go(0.2)
    start = begun(camera, Fault.CAMERA_STOPPED, "", 0.5)

    assert camera.since("/stereo/left/image_raw", start + 1e-6) == []


# ------------------------------------------------------------ how faults are asked for


def test_another_process_injects_and_clears(robot):
    robot.listen("/dissection_stub/faults", m.String)
    told = []
    for request in ("frozen PSM1", "operator_absent", "clear frozen", "clear"):
        robot.send("/dissection_stub/inject", m.String(request))
        told.append(robot.newest("/dissection_stub/faults").data)

    assert told == ["frozen PSM1", "frozen PSM1, operator_absent", "operator_absent", "none"]


@pytest.mark.parametrize("request_text", ["frosen PSM1", "frozen PSM9", "zero_k PSM1", "", "one two three"])
def test_a_request_that_makes_no_sense_is_refused_in_words(robot, request_text):
    robot.listen("/dissection_stub/faults", m.String)
    robot.send("/dissection_stub/inject", m.String(request_text))

    assert robot.newest("/dissection_stub/faults").data.startswith("refused: ")
    assert robot.served.faults.active() == []


def test_an_unknown_fault_is_met_with_the_nearest_name(robot):
    with pytest.raises(InputError, match="did you mean frozen"):
        robot.served.inject("frosen", "PSM1")


@pytest.mark.parametrize("fault", [fault for fault in Fault if fault not in ONCE])
def test_every_lasting_fault_ends_when_all_are_cleared(robot, fault):
    robot.served.inject(fault)
    robot.go(0.05)
    robot.served.clear()
    robot.go(0.6)

    assert robot.served.faults.active() == []
    if fault not in (Fault.SILENT, Fault.EMERGENCY_STOP):
        assert all(robot.state(arm).state == "ENABLED" and not robot.state(arm).is_busy for arm in ("PSM1", "PSM2"))
        assert abs(robot.newest("/PSM1/measured_cp").stamp - robot.client.stamp()) < 0.03


def test_faults_are_sorted_into_those_of_an_arm_and_those_of_the_robot():
    assert Fault.LATCHED_ERROR in ONCE and Fault.CLOCK_AHEAD not in ONCE and Fault.JAW_BLOCKED not in ONCE
    assert Fault.CLOCK_AHEAD in OF_ROBOT and Fault.CAMERA_STOPPED in OF_ROBOT and Fault.LATCHED_ERROR not in OF_ROBOT
