"""The driver of one arm against a scripted robot: what it sends, what it refuses, and when it holds. Numbers name traps of reference 7."""

from dataclasses import replace

import numpy as np
import pytest

from hardware.codes import Code
from hardware.dvrk.kinematics import forward
from hardware.dvrk.messages import Bool, Float64, JointState, Joy, PoseStamped, String
from hardware.interface import CUTTER, GRASPER, MoveHandle, MoveReport, MoveStatus, OperatingState, Pose
from tests.mocks.robot import Rig, ScriptedArm, robot_config


@pytest.fixture
def rig(tmp_path) -> Rig:
    return Rig(tmp_path)


def robot(rig: Rig, role: str = CUTTER) -> ScriptedArm:
    return rig.robot.arms[role]


def ended(rig: Rig, handle: MoveHandle, within: float = 10.0) -> MoveReport:
    until = rig.time + within
    while handle.report().status is MoveStatus.RUNNING and rig.time < until:
        rig.bench.advance(1 / 30)
    return handle.report()


def there(rig: Rig, role: str = CUTTER) -> Pose:
    return rig.bench.arms[role].measured_cp().value


ASIDE = np.array([0.006, 0.004, -0.003])


# ------------------------------------------------------------ where the tip is


def test_the_tip_is_where_kinematics_hand_eye_and_jaw_length_put_it(rig: Rig):
    arm = robot(rig)
    camera_from_base = np.array([[0, 1, 0, 0.06], [1, 0, 0, 0], [0, 0, -1, 0.02], [0, 0, 0, 1.0]])
    tip = camera_from_base @ forward(rig.config.cutter.instrument, arm.q)

    found = there(rig)

    assert found.position == pytest.approx(tip[:3, 3] + 0.012 * tip[:3, 2], abs=1e-9)
    assert found.rotation()[:, 2] == pytest.approx(tip[:3, 2], abs=1e-9)  # out of the jaws


def test_force_comes_along_the_cameras_axes(rig: Rig):
    robot(rig).force = np.array([0.0, 0.0, 2.0])
    rig.bench.advance(0.05)

    force = rig.bench.arms[CUTTER].measured_cf()

    assert force.value == pytest.approx(2.0 * there(rig).rotation()[:, 2], abs=1e-9)
    assert 0.0 <= rig.bench.now() - force.stamp < 0.02


def test_before_the_first_good_reading_nothing_is_known(tmp_path):
    rig = Rig(tmp_path, opened=False)
    arm = rig.bench.arms[CUTTER]

    assert np.isnan(arm.measured_cp().value.position).all() and arm.measured_cp().stamp == -np.inf
    assert np.isnan(arm.setpoint_cp().position).all()
    assert np.isnan(arm.measured_jaw().value)
    assert not arm.operating_state().ready


# ------------------------------------------------------------ motions that end well


def test_a_motion_arrives_and_its_tip_never_leaves_the_straight_line(rig: Rig):
    start = there(rig)
    goal = start.moved(ASIDE)
    way = ASIDE / np.linalg.norm(ASIDE)

    handle = rig.bench.arms[CUTTER].move_cp(goal)
    seen = []
    while handle.report().status is MoveStatus.RUNNING:
        rig.bench.advance(0.01)
        seen.append(there(rig).position - start.position)

    assert handle.report().status is MoveStatus.DONE
    off = np.linalg.norm(np.array(seen) - np.outer(np.array(seen) @ way, way), axis=1)
    assert off.max() < 1e-6
    steps = np.linalg.norm(np.diff(seen, axis=0), axis=1)
    assert steps.max() <= rig.config.speeds.linear * 0.01 * 1.01
    assert there(rig).position == pytest.approx(goal.position, abs=1e-6)


def test_4_every_quaternion_sent_is_unit_and_in_the_robots_frame(rig: Rig):
    handle = rig.bench.arms[CUTTER].move_cp(there(rig).moved(ASIDE))
    ended(rig, handle)

    sent = [message for name, message in robot(rig).heard if name == "servo_cp"]
    assert len(sent) > 20
    assert all(isinstance(one, PoseStamped) and abs(np.linalg.norm(one.quaternion) - 1) < 1e-9 for one in sent)
    assert {one.frame_id for one in sent} == {"PSM2_base"}


def test_servo_steps_of_the_session_are_followed(rig: Rig):
    arm, start = rig.bench.arms[CUTTER], there(rig)

    for k in range(1, 31):
        arm.servo_cp(start.moved(np.array([0.3e-3 * k, 0, 0])))
        rig.bench.advance(1 / 30)
    rig.bench.advance(0.1)

    assert there(rig).position - start.position == pytest.approx([9e-3, 0, 0], abs=1e-6)
    assert arm.operating_state().guard.ok and not arm.operating_state().is_busy


def test_a_goal_where_the_arm_already_is_is_reached_at_once(rig: Rig):
    assert ended(rig, rig.bench.arms[CUTTER].move_cp(there(rig)), 1.0).status is MoveStatus.DONE


@pytest.mark.parametrize("angle", [0.45, 0.0])
def test_the_jaw_opens_and_closes(rig: Rig, angle: float):
    arm = rig.bench.arms[CUTTER]

    report = ended(rig, arm.move_jaw(angle))

    assert report.status is MoveStatus.DONE
    assert arm.measured_jaw().value == pytest.approx(angle, abs=1e-6)
    assert arm.operating_state().guard.ok


def test_closed_is_pressed_together(rig: Rig):
    ended(rig, rig.bench.arms[CUTTER].move_jaw(0.0))

    assert robot(rig).heard[-1] == ("jaw/move_jp", rig.config.cutter.jaw_closed)


def test_8_a_grasp_is_done_where_the_tissue_stops_the_jaws(rig: Rig):
    robot(rig, GRASPER).blocked_at = 0.12

    report = ended(rig, rig.bench.arms[GRASPER].move_jaw(0.0))

    assert report.status is MoveStatus.DONE
    assert rig.bench.arms[GRASPER].measured_jaw().value == pytest.approx(0.12)


# ------------------------------------------------------------ motions that do not


def test_8_jaws_that_something_keeps_wide_open_have_not_closed(rig: Rig):
    robot(rig, GRASPER).blocked_at = 0.4

    report = ended(rig, rig.bench.arms[GRASPER].move_jaw(0.0))

    assert report.code is Code.MOVE_NOT_REACHED and "23 degrees" in report.message


def test_5_a_jaw_whose_setpoint_was_clipped_is_told_with_both_angles(rig: Rig):
    robot(rig, GRASPER).jaw_clip = 0.15

    report = ended(rig, rig.bench.arms[GRASPER].move_jaw(0.0))

    assert report.code is Code.MOVE_NOT_REACHED
    assert "its setpoint at 9 where -20 were sent" in report.message


def test_potts_scissors_are_not_opened_beyond_their_limit(rig: Rig):
    report = rig.bench.arms[CUTTER].move_jaw(np.deg2rad(40))

    assert report.report().code is Code.MOVE_REJECTED and "30 degrees of POTTS_SCISSORS" in report.report().message
    assert robot(rig).count_of("jaw/move_jp") == 0


def test_3_a_jaw_command_that_the_robot_drops_is_rejected_within_half_a_second(rig: Rig):
    robot(rig).deaf = True
    before = rig.time

    report = ended(rig, rig.bench.arms[CUTTER].move_jaw(0.0))

    assert report.code is Code.MOVE_REJECTED
    assert rig.time - before < 0.6
    assert robot(rig).count_of("hold") >= 1
    robot(rig).deaf = False
    rig.bench.advance(3.0)
    guard = rig.bench.arms[CUTTER].operating_state().guard
    assert guard.latched and guard.code is Code.NOT_OBEYED  # nothing but another command could tell that it obeys again


def test_a_jaw_motion_that_the_robot_breaks_off_has_failed(rig: Rig):
    arm = rig.bench.arms[CUTTER]
    handle = arm.move_jaw(0.0)
    rig.bench.advance(0.05)

    robot(rig)._hold(None, 0.0)  # somebody else's hold

    assert ended(rig, handle).code is Code.MOVE_NOT_REACHED


def test_after_a_motion_that_failed_nothing_is_sent_before_the_arm_was_quiet(rig: Rig):
    arm = rig.bench.arms[CUTTER]
    arm.move_jaw(0.0)
    rig.bench.advance(0.05)
    robot(rig)._hold(None, 0.0)
    rig.bench.advance(0.1)

    early, guard = arm.move_jaw(0.0).report(), arm.operating_state().guard
    rig.bench.advance(1.2)

    assert early.code is Code.MOVE_REJECTED and guard.code is Code.MOVE_NOT_REACHED and not guard.latched
    assert ended(rig, arm.move_jaw(0.0)).status is MoveStatus.DONE


def test_a_jaw_that_something_keeps_open_waits_until_it_is_free(rig: Rig):
    arm = rig.bench.arms[CUTTER]
    robot(rig).blocked_at = 0.3
    ended(rig, arm.move_jaw(0.0))

    rig.bench.advance(3.0)
    blocked = arm.operating_state().guard
    robot(rig).blocked_at = -np.inf
    rig.bench.advance(1.5)

    assert blocked.code is Code.MOVE_NOT_REACHED and not blocked.latched and "17 degrees" in blocked.message
    assert arm.operating_state().ready


def test_the_second_motion_in_a_row_that_fails_ends_the_session(rig: Rig):
    arm = rig.bench.arms[CUTTER]
    for _ in range(2):
        arm.move_jaw(0.0)
        rig.bench.advance(0.03)
        robot(rig)._hold(None, 0.0)
        rig.bench.advance(1.5)

    guard = arm.operating_state().guard
    assert guard.latched and guard.code is Code.NOT_OBEYED and "second time in a row" in guard.message


def test_a_paused_arm_is_enabled_by_resume(rig: Rig):
    robot(rig).become("PAUSED")
    rig.bench.advance(0.05)

    rig.bench.arms[CUTTER].state_command("enable")

    assert robot(rig).heard[-1] == ("resume", None)


def test_2_a_foreign_busy_pulse_does_not_end_a_motion_early(rig: Rig):
    handle = rig.bench.arms[CUTTER].move_jaw(0.0)
    robot(rig).deaf = True
    robot(rig).pulse()
    robot(rig).busy = True
    robot(rig).tell()

    rig.bench.advance(0.1)

    assert handle.report().status is MoveStatus.RUNNING
    assert ended(rig, handle).status is MoveStatus.DONE


def test_setpoints_that_the_robot_ignores_are_a_rejected_motion_and_a_hold(rig: Rig):
    robot(rig).deaf = True
    rig.robot.arms[CUTTER].warnings.publish(String("PSM2: servo_cp, old"))
    rig.bench.advance(0.1)

    handle = rig.bench.arms[CUTTER].move_cp(there(rig).moved(ASIDE))
    rig.bench.advance(0.1)
    robot(rig).warnings.publish(String("PSM2: servo_cp, arm not ready (9 errors)"))
    report = ended(rig, handle)

    assert report.code is Code.MOVE_REJECTED and "arm not ready (9 errors)" in report.message
    assert robot(rig).heard[-1][0] == "hold"
    rig.bench.advance(0.5)
    guard = rig.bench.arms[CUTTER].operating_state().guard
    assert guard.latched and guard.code is Code.NOT_OBEYED and "arm not ready (9 errors)" in guard.message


def test_an_arm_whose_setpoint_is_still_under_way_after_a_hold_counts_as_busy(rig: Rig):
    arm = rig.bench.arms[CUTTER]
    arm.move_cp(there(rig).moved(ASIDE))
    rig.bench.advance(0.2)

    arm.hold()

    assert arm.operating_state().is_busy
    rig.bench.advance(0.05)
    assert not arm.operating_state().is_busy


def test_an_arm_that_stays_behind_ends_the_motion_long_before_the_robot_would(rig: Rig):
    handle = rig.bench.arms[CUTTER].move_cp(there(rig).moved(ASIDE))
    rig.bench.advance(0.2)

    robot(rig).lag = np.array([6e-3, 0, 0])
    report = ended(rig, handle)

    assert report.code is Code.ARM_FAULT and "6.0 mm from its setpoint" in report.message


def test_an_arm_that_comes_to_rest_beside_its_goal_has_not_reached_it(rig: Rig):
    robot(rig).lag = np.array([2e-3, 0, 0])
    rig.bench.advance(0.1)
    start = rig.bench.arms[CUTTER].setpoint_cp()

    report = ended(rig, rig.bench.arms[CUTTER].move_cp(start.moved(ASIDE)))

    assert report.code is Code.MOVE_NOT_REACHED and "2.0 mm from its goal" in report.message


def test_a_hold_ends_a_motion_and_nothing_is_sent_after_it(rig: Rig):
    arm = rig.bench.arms[CUTTER]
    handle = arm.move_cp(there(rig).moved(ASIDE))
    rig.bench.advance(0.2)

    arm.hold()
    sent = robot(rig).count_of("servo_cp")
    rig.bench.advance(1.0)

    assert handle.report().code is Code.MOVE_NOT_REACHED
    assert robot(rig).count_of("servo_cp") == sent
    assert arm.operating_state().guard.ok and not arm.operating_state().is_busy


# ------------------------------------------------------------ what is never sent


def test_6_the_jaw_waits_until_the_arm_stands_still(rig: Rig):
    arm = rig.bench.arms[CUTTER]
    tip = arm.move_cp(there(rig).moved(ASIDE))
    jaw = arm.move_jaw(0.0)

    while tip.report().status is MoveStatus.RUNNING:
        sent = robot(rig).count_of("jaw/move_jp")
        rig.bench.advance(0.01)

    assert sent == 0 and tip.report().status is MoveStatus.DONE
    assert ended(rig, jaw).status is MoveStatus.DONE


def test_6_a_jaw_that_waits_for_the_arm_is_not_commanded_after_a_hold(rig: Rig):
    arm = rig.bench.arms[CUTTER]
    arm.move_cp(there(rig).moved(ASIDE))
    jaw = arm.move_jaw(0.0)

    arm.hold()
    rig.bench.advance(1.0)

    assert jaw.report().code is Code.MOVE_NOT_REACHED
    assert robot(rig).count_of("jaw/move_jp") == 0


def test_6_the_arm_is_not_servoed_while_the_jaw_moves(rig: Rig):
    arm = rig.bench.arms[CUTTER]
    arm.move_jaw(0.0)
    rig.bench.advance(0.05)

    arm.servo_cp(there(rig).moved(np.array([0.3e-3, 0, 0])))

    rig.bench.advance(0.02)
    assert robot(rig).count_of("servo_cp") == 0
    assert "jaw of cutter (PSM2) moves" in arm.operating_state().guard.message


def test_6_a_motion_of_the_arm_waits_until_the_jaw_stands_still(rig: Rig):
    arm = rig.bench.arms[CUTTER]
    jaw = arm.move_jaw(0.0)
    tip = arm.move_cp(there(rig).moved(ASIDE))

    while jaw.report().status is MoveStatus.RUNNING:
        sent = robot(rig).count_of("servo_cp")
        rig.bench.advance(0.01)

    assert sent == 0 and jaw.report().status is MoveStatus.DONE
    assert ended(rig, tip).status is MoveStatus.DONE


def test_6_a_motion_that_waits_for_the_jaw_ends_with_it_when_that_fails(rig: Rig):
    arm = rig.bench.arms[CUTTER]
    robot(rig).deaf = True
    arm.move_jaw(0.0)
    tip = arm.move_cp(there(rig).moved(ASIDE))

    assert ended(rig, tip).code is Code.MOVE_REJECTED
    assert robot(rig).count_of("servo_cp") == 0


def test_8_no_effort_no_free_and_no_foreign_mode_is_ever_offered(rig: Rig):
    offered = {topic.removeprefix("/PSM2/") for topic, offers in rig.graph.offers.items() for o in offers if o.node == "driver"}

    assert {t for t in offered if not t.startswith("/")} == {
        "servo_cp", "hold", "state_command", "trajectory_j/set_ratio", "jaw/move_jp",
    }  # fmt: skip


def test_1_commands_are_not_latched_so_that_a_restarted_robot_obeys_none_from_before(rig: Rig):
    heard: list[object] = []
    late = rig.graph.node("restarted")
    for topic, offers in list(rig.graph.offers.items()):
        for kind in {offer.kind for offer in offers if offer.node == "driver"}:
            late.subscribe(topic, kind, lambda message, _: heard.append(message))

    assert heard == []


@pytest.mark.parametrize(
    "pose",
    [
        Pose(np.array([np.nan, 0, 0.1]), np.array([0, 0, 0, 1.0])),
        Pose(np.array([0.1, 0, 0.1]), np.array([0, 0, 0, np.nan])),
    ],
)
def test_4_a_pose_that_is_not_finite_is_not_sent(rig: Rig, pose: Pose):
    arm = rig.bench.arms[CUTTER]

    report = arm.move_cp(pose).report()
    arm.servo_cp(pose)
    rig.bench.advance(0.05)

    assert report.status is MoveStatus.FAILED
    assert robot(rig).count_of("servo_cp") == 0


def test_a_pose_that_the_arm_would_push_deeper_is_refused_with_the_reason(rig: Rig):
    shaft = there(rig).rotation()[:, 2]

    report = rig.bench.arms[CUTTER].move_cp(there(rig).moved(-0.09 * shaft)).report()

    assert report.code is Code.MOVE_REJECTED and "remote centre" in report.message
    assert robot(rig).count_of("servo_cp") == 0


def test_a_pose_whose_joints_would_be_clipped_is_refused_and_servoing_to_it_holds_the_session(rig: Rig):
    far = there(rig).moved(0.2 * there(rig).rotation()[:, 2])
    arm = rig.bench.arms[CUTTER]

    report = arm.move_cp(far).report()
    arm.servo_cp(far)
    rig.bench.advance(1 / 30)
    state = arm.operating_state()

    assert report.code is Code.MOVE_REJECTED and "clip insertion" in report.message
    assert not state.ready and state.guard.code is Code.MOVE_REJECTED and not state.guard.latched
    rig.bench.advance(0.5)
    assert arm.operating_state().ready


# ------------------------------------------------------------ what keeps the arm from moving


def foreign_servo(rig: Rig) -> None:
    node = rig.graph.node("stranger")
    tip = forward(rig.config.cutter.instrument, robot(rig).q)
    pose = Pose.from_matrix(tip[:3, :3], tip[:3, 3] + np.array([1e-3, 0, 0]))
    node.publisher("/PSM2/servo_cp", PoseStamped).publish(PoseStamped(1.0, "", pose.position, pose.quaternion))


def base_jump(rig: Rig) -> None:
    robot(rig).base = np.array([[1, 0, 0, 1e-3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])


def nan_pose(rig: Rig) -> None:
    robot(rig).break_pose = lambda p, q: (p * np.nan, q)


def short_quaternion(rig: Rig) -> None:
    robot(rig).break_pose = lambda p, q: (p, 0.5 * q)


def tool_off(rig: Rig) -> None:
    robot(rig).count, robot(rig).tool = 7, ""
    robot(rig).tools.publish(String(""))


def other_tool(rig: Rig) -> None:
    robot(rig).tools.publish(String("LARGE_NEEDLE_DRIVER:400006"))


def set_on_arm(name: str, value: object):
    def change(rig: Rig) -> None:
        setattr(robot(rig), name, value)

    change.__name__ = name
    return change


def manual(rig: Rig) -> None:
    rig.bench.advance(0.6)
    robot(rig).become("ENABLED", busy=True)


def jaw_goal(rig: Rig) -> None:
    robot(rig).jaw_setpoint = robot(rig).jaw_goal = 0.2


def teleop(rig: Rig) -> None:
    rig.robot.teleop.publish(Bool(True))


def following(rig: Rig) -> None:
    rig.robot.following.publish(Bool(True))


def nobody_there(rig: Rig) -> None:
    rig.robot.operator.publish(Joy(2.0, (0,)))


def pedal(rig: Rig) -> None:
    rig.robot.pedal.publish(Joy(2.0, (1,)))


def clutch(rig: Rig) -> None:
    robot(rig).clutch.publish(Joy(2.0, (1,)))


def fault(rig: Rig) -> None:
    robot(rig).become("FAULT", error="PSM2: tracking error, mask (1 for error): 0 1 0 0 0 0")


def paused(rig: Rig) -> None:
    robot(rig).become("PAUSED")


def two_robots(rig: Rig) -> None:
    rig.graph.node("second").publisher("/PSM2/measured_cp", PoseStamped)


def fast(rig: Rig) -> None:
    robot(rig).stubborn = True
    robot(rig).ratios.publish(Float64(1.0))


def clock_back(rig: Rig) -> None:
    rig.robot.node._ahead -= 5.0


TROUBLES = [
    (foreign_servo, Code.FOREIGN_MOTION, True, "somebody else"),
    (base_jump, Code.SETUP_CHANGED, True, "moved by 1.0 mm"),
    (set_on_arm("frame_id", "ECM"), Code.SETUP_CHANGED, True, "'ECM'"),
    (tool_off, Code.SETUP_CHANGED, True, ""),
    (other_tool, Code.SETUP_CHANGED, True, "LARGE_NEEDLE_DRIVER"),
    (two_robots, Code.SETUP_CHANGED, True, "2 nodes"),
    (jaw_goal, Code.FOREIGN_MOTION, True, "jaw's setpoint"),
    (nan_pose, Code.NOT_FINITE, False, "not finite"),
    (short_quaternion, Code.ARM_DATA_STALE, False, "length 0.5"),
    (set_on_arm("silent", True), Code.ARM_DATA_STALE, False, "ms old"),
    (set_on_arm("frozen", True), Code.ARM_DATA_STALE, False, "frozen"),
    (set_on_arm("invalid", True), Code.ARM_DATA_STALE, False, "stamp 0"),
    (set_on_arm("old_stamps", True), Code.ARM_DATA_STALE, False, "ms old"),
    (clock_back, Code.ARM_DATA_STALE, False, "old"),
    (manual, Code.ARM_NOT_READY, False, "by hand"),
    (clutch, Code.ARM_NOT_READY, False, "clutch at the arm"),
    (teleop, Code.ARM_NOT_READY, False, "teleoperation off"),
    (following, Code.ARM_NOT_READY, False, "following"),
    (nobody_there, Code.ARM_NOT_READY, False, "nobody is there"),
    (pedal, Code.ARM_NOT_READY, False, "pressed"),
    (fast, Code.ARM_NOT_READY, False, "ratio is 1"),
]
NAMES = [trouble[0].__name__ for trouble in TROUBLES]


AT_REST = [trouble for trouble in TROUBLES if trouble[3] != "frozen"]  # which tells nothing of an arm that is to stand still


@pytest.mark.parametrize(("strike", "code", "latched", "said"), AT_REST, ids=[trouble[0].__name__ for trouble in AT_REST])
def test_trouble_keeps_the_arm_from_moving_with_its_code(rig: Rig, strike, code: Code, latched: bool, said: str):
    arm = rig.bench.arms[CUTTER]
    rig.bench.advance(0.1)
    assert arm.operating_state().ready

    strike(rig)
    rig.bench.advance(0.7)

    state = arm.operating_state()
    assert not state.ready
    assert (state.guard.code, state.guard.latched) == (code, latched)
    assert said in state.guard.message
    assert arm.move_jaw(0.0).report().status is MoveStatus.FAILED
    assert arm.move_cp(there(rig)).report().status is MoveStatus.FAILED


@pytest.mark.parametrize(("strike", "code", "latched", "said"), TROUBLES, ids=NAMES)
def test_trouble_in_the_middle_of_a_motion_holds_and_nothing_is_sent_after(rig: Rig, strike, code, latched, said):
    arm = rig.bench.arms[CUTTER]
    handle = arm.move_cp(there(rig).moved(4 * ASIDE))
    rig.bench.advance(0.3)

    strike(rig)
    rig.bench.advance(0.7)
    held = max(i for i, (name, _) in enumerate(robot(rig).heard) if name == "hold")

    report = handle.report()
    assert report.status is MoveStatus.FAILED and report.code in (code, Code.MOVE_REJECTED)
    ours = [name for name, message in robot(rig).heard[held + 1 :] if name == "servo_cp" and message.stamp != 1.0]
    assert ours == []


def test_a_fault_is_told_with_the_robots_own_words_and_ends_the_motion(rig: Rig):
    arm = rig.bench.arms[CUTTER]
    handle = arm.move_cp(there(rig).moved(ASIDE))
    rig.bench.advance(0.2)

    fault(rig)
    rig.bench.advance(0.05)

    assert handle.report().code is Code.ARM_FAULT
    state = arm.operating_state()
    assert state.state is OperatingState.FAULT and "tracking error" in state.error
    sent = robot(rig).count_of("servo_cp")
    rig.bench.advance(0.3)
    assert robot(rig).count_of("servo_cp") == sent and robot(rig).heard[-1][0] == "hold"


def test_an_arm_taken_by_its_clutch_is_ours_again_when_it_is_let_go_elsewhere(rig: Rig):
    arm = rig.bench.arms[CUTTER]
    clutch(rig)
    rig.bench.advance(0.1)
    robot(rig).q = robot(rig).q + np.array([0.02, 0.01, 0.005, 0, 0, 0])
    rig.bench.advance(0.2)

    robot(rig).clutch.publish(Joy(2.0, (0,)))
    rig.bench.advance(0.7)

    assert arm.operating_state().ready
    assert ended(rig, arm.move_cp(there(rig).moved(ASIDE))).status is MoveStatus.DONE


def test_14_a_robot_whose_clock_is_seconds_off_is_driven_all_the_same(tmp_path):
    for k, ahead in enumerate((-5.0, 5.0)):
        folder = tmp_path / str(k)
        folder.mkdir()
        rig = Rig(folder, stamps_ahead=ahead)

        assert ended(rig, rig.bench.arms[CUTTER].move_cp(there(rig).moved(ASIDE))).status is MoveStatus.DONE


def test_9_a_base_frame_that_stands_still_is_taken_into_account(tmp_path):
    rig = Rig(tmp_path, opened=False)
    robot(rig).base = np.array([[0, -1, 0, 0.2], [1, 0, 0, -0.1], [0, 0, 1, 0.3], [0, 0, 0, 1.0]])
    rig.bench.open()
    arm = rig.bench.arms[CUTTER]
    arm.state_command("enable")
    arm.state_command("home")
    rig.bench.advance(0.3)
    start = there(rig)

    report = ended(rig, arm.move_cp(start.moved(ASIDE)))

    assert report.status is MoveStatus.DONE
    assert there(rig).position == pytest.approx(start.position + ASIDE, abs=1e-6)


def test_15_an_arm_without_its_instrument_does_not_count_as_homed_and_says_why(tmp_path):
    rig = Rig(tmp_path, opened=False)
    robot(rig).tool = ""
    rig.bench.open()
    arm = rig.bench.arms[CUTTER]
    arm.state_command("enable")
    arm.state_command("home")

    rig.bench.advance(0.5)

    state = arm.operating_state()
    assert robot(rig).homed and not state.is_homed
    assert "no instrument" in state.error


def test_an_instrument_that_engages_may_tell_its_name_before_its_joints(tmp_path):
    rig = Rig(tmp_path, opened=False)
    robot(rig).count = 7
    rig.bench.open()
    arm = rig.bench.arms[CUTTER]
    arm.state_command("enable")
    arm.state_command("home")
    rig.bench.advance(0.2)
    before = arm.operating_state()

    robot(rig).count = 6
    rig.bench.advance(0.2)

    assert not before.is_homed and not before.guard.latched
    assert arm.operating_state().ready


def test_a_wrong_instrument_is_told_as_soon_as_it_engages(tmp_path):
    rig = Rig(tmp_path, opened=False)
    robot(rig).tool = "PROGRASP_FORCEPS:400093"
    rig.bench.open()
    arm = rig.bench.arms[CUTTER]
    arm.state_command("enable")
    arm.state_command("home")

    rig.bench.advance(0.2)

    guard = arm.operating_state().guard
    assert guard.code is Code.SETUP_CHANGED and "PROGRASP" in guard.message


class Noiseless:
    """The currents of a robot that is simulated kinematically."""

    def normal(self, size: int) -> np.ndarray:
        return np.zeros(size)


@pytest.fixture
def simulated(rig: Rig) -> Rig:
    rig.robot.rng = Noiseless()  # type: ignore[assignment]
    rig.bench.advance(2.0)
    return rig


def test_a_simulated_robot_without_noise_may_stand_still_and_move_again(simulated: Rig):
    arm = simulated.bench.arms[CUTTER]

    assert arm.operating_state().ready
    for _ in range(2):
        assert ended(simulated, arm.move_cp(there(simulated).moved(ASIDE))).status is MoveStatus.DONE
        assert ended(simulated, arm.move_jaw(0.3)).status is MoveStatus.DONE
        assert ended(simulated, arm.move_jaw(0.0)).status is MoveStatus.DONE
        simulated.bench.advance(2.0)
        assert arm.operating_state().ready
    start = there(simulated)
    for k in range(120):  # a servo that goes 3 mm and then stays there
        arm.servo_cp(start.moved(np.array([0.1e-3 * min(k, 30), 0, 0])))
        simulated.bench.advance(1 / 30)
        assert arm.operating_state().guard.ok


@pytest.mark.parametrize("noise", [True, False])
def test_an_arm_that_freezes_while_it_is_sent_elsewhere_is_held_and_stays_so(rig: Rig, noise: bool):
    if not noise:
        rig.robot.rng = Noiseless()  # type: ignore[assignment]
    arm = rig.bench.arms[CUTTER]
    handle = arm.move_cp(there(rig).moved(4 * ASIDE))
    rig.bench.advance(0.5)

    robot(rig).frozen = True
    rig.bench.advance(0.12)
    soon = handle.report()
    rig.bench.advance(2.0)
    guard = arm.operating_state().guard
    again = arm.move_jaw(0.0).report()

    assert soon.status is MoveStatus.FAILED and again.code is Code.MOVE_REJECTED
    if noise:
        assert guard.code is Code.ARM_DATA_STALE and not guard.latched and "frozen" in guard.message
    else:  # nothing tells a frozen report from an arm that does not obey
        assert guard.code is Code.NOT_OBEYED and guard.latched


def test_joints_that_freeze_while_all_else_moves_end_the_motion_until_they_are_alive_again(rig: Rig):
    arm = rig.bench.arms[CUTTER]
    handle = arm.move_cp(there(rig).moved(4 * ASIDE))
    rig.bench.advance(0.3)
    js, still = robot(rig).js, rig.bench.arms[CUTTER].readings.joints.good.message
    robot(rig).js = type("Stuck", (), {"publish": lambda _, new: js.publish(replace(still, stamp=new.stamp))})()

    rig.bench.advance(2.0)
    guard = arm.operating_state().guard
    robot(rig).js = js
    rig.bench.advance(0.1)

    assert handle.report().code is Code.ARM_DATA_STALE and "frozen" in handle.report().message
    assert not guard.ok and arm.operating_state().ready


def test_an_old_latched_error_is_not_taken_for_the_reason_of_anything(tmp_path):
    rig = Rig(tmp_path, opened=False)
    robot(rig).errors.publish(String("PSM2: something of yesterday"))
    rig.bench.open()
    arm = rig.bench.arms[CUTTER]
    arm.state_command("enable")
    arm.state_command("home")
    rig.bench.advance(0.3)
    robot(rig).deaf = True

    report = ended(rig, arm.move_jaw(0.0))

    assert arm.operating_state().error == ""
    assert "yesterday" not in report.message


def test_the_trajectory_ratio_is_asked_for_until_the_robot_tells_it(rig: Rig):
    assert robot(rig).ratio == rig.config.speeds.ratio


def test_a_monitor_that_no_longer_looks_keeps_the_arm_from_moving(rig: Rig):
    rig.wait(0.3)

    state = rig.bench.arms[CUTTER].operating_state()

    assert not state.ready and "monitor" in state.guard.message


def test_an_unknown_state_command_is_not_sent(rig: Rig):
    before = len(robot(rig).heard)

    rig.bench.arms[CUTTER].state_command("dance")

    assert len(robot(rig).heard) == before


def test_jaw_readings_are_full_openings(rig: Rig):
    robot(rig).jaw_set.publish(JointState(rig.robot.node.stamp(), ("jaw",), np.array([0.4])))

    assert rig.bench.arms[CUTTER].measured_jaw().value == pytest.approx(0.4)


# ------------------------------------------------------------ an instrument without a jaw


class Generator:
    """Energy whose answer the test gives."""

    def __init__(self) -> None:
        self.answer: bool | None = None
        self.asked: list[str] = []

    def apply(self, arm: str) -> "Generator":
        self.asked.append(arm)
        return self

    def applied(self) -> bool | None:
        return self.answer


@pytest.fixture
def cautery(tmp_path) -> tuple[Rig, Generator]:
    spatula = "PERMANENT_CAUTERY_SPATULA:400184"
    generator = Generator()
    config = robot_config(tmp_path)
    rig = Rig(tmp_path, opened=False, energy=generator, cutter=replace(config.cutter, tool_type=spatula))
    robot(rig).tool = spatula
    rig.bench.open()
    for arm in rig.bench.arms.values():
        arm.state_command("enable")
        arm.state_command("home")
    rig.bench.advance(0.3)
    return rig, generator


@pytest.mark.parametrize(("answer", "status"), [(True, MoveStatus.DONE), (False, MoveStatus.FAILED)])
def test_closing_an_instrument_without_a_jaw_asks_for_energy_and_commands_no_jaw(cautery, answer: bool, status: MoveStatus):
    rig, generator = cautery
    arm = rig.bench.arms[CUTTER]
    opened = arm.move_jaw(0.8).report()

    handle = arm.move_jaw(0.0)
    rig.bench.advance(1.0)
    waiting = handle.report().status
    generator.answer = answer
    rig.bench.advance(0.1)

    assert opened.status is MoveStatus.DONE and waiting is MoveStatus.RUNNING
    assert handle.report().status is status
    assert generator.asked == ["PSM2"]
    assert robot(rig).count_of("jaw/move_jp") == 0 and "/PSM2/jaw/move_jp" not in {
        topic for topic, offers in rig.graph.offers.items() for offer in offers if offer.node == "driver"
    }


def test_an_answer_after_a_hold_is_no_energy(cautery):
    rig, generator = cautery
    arm = rig.bench.arms[CUTTER]
    handle = arm.move_jaw(0.0)

    arm.hold()
    generator.answer = True
    rig.bench.advance(0.1)

    assert handle.report().code is Code.MOVE_NOT_REACHED
