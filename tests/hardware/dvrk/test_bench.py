"""The bench: what it refuses to start without, its monitor, the gate on top of it, and how it ends."""

import json
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

from hardware.codes import Code, InputError
from hardware.dvrk.bench import BenchDVRK
from hardware.dvrk.config import ConsoleConfig
from hardware.dvrk.deadman import ARM, HEARTBEAT, HOLD, STATE, Deadman
from hardware.dvrk.doctor import examine
from hardware.dvrk.energy import OperatorEnergy
from hardware.dvrk.local import LocalGraph
from hardware.dvrk.messages import Bool, Empty, Float64, JointState, Joy, Message, Picture, PoseStamped, String
from hardware.gate import SafetyGate
from hardware.interface import CUTTER, GRASPER, MoveStatus
from hardware.limits import Limits
from supervisor.plain import plain
from tests.mocks.robot import K, Rig, camera_info, robot_config

WIDE = Limits(workspace_lower=(-0.3, -0.3, 0.0), workspace_upper=(0.3, 0.3, 0.4))


def closed(tmp_path, **how: object) -> Rig:
    return Rig(tmp_path, opened=False, **how)


def refused(rig: Rig) -> str:
    with pytest.raises(InputError) as refusal:
        rig.bench.open()
    return str(refusal.value)


class Odd(Message):
    ROS = "geometry_msgs/TransformStamped"


# ------------------------------------------------------------ starting


def test_a_robot_in_order_is_opened_and_the_deadman_watches(tmp_path):
    rig = Rig(tmp_path)

    assert rig.bench.blockers() == []
    assert rig.bench.deadman == "watching"
    assert all(arm.operating_state().ready for arm in rig.bench.arms.values())


def test_without_the_deadman_there_is_no_session(tmp_path):
    rig = closed(tmp_path, deadman=False)

    assert "no deadman is running" in refused(rig)


def no_left_eye(rig: Rig) -> None:
    rig.robot.blind = {"left"}


def zero_k(rig: Rig) -> None:
    rig.robot.K = np.zeros((3, 3))


def teleop(rig: Rig) -> None:
    rig.robot.teleop.publish(Bool(True))


def nobody(rig: Rig) -> None:
    rig.robot.operator.publish(Joy(1.0, (0,)))


def stranger(rig: Rig) -> None:
    rig.graph.node("gui").publisher("/PSM1/move_cp", PoseStamped)


def older_robot(rig: Rig) -> None:
    rig.graph.node("old").publisher("/PSM1/measured_cp", Odd)
    rig.graph.offers["/PSM1/measured_cp"].reverse()


def no_robot(rig: Rig) -> None:
    rig.graph.offers = type(rig.graph.offers)(list, {t: o for t, o in rig.graph.offers.items() if not t.startswith("/PSM2")})


def deaf_robot(rig: Rig) -> None:
    rig.graph.listeners["/PSM2/servo_cp"].clear()


def skewed(rig: Rig) -> None:
    rig.robot.skew = 0.7


def two_robots(rig: Rig) -> None:
    rig.graph.node("second").publisher("/PSM2/measured_js", JointState)


def no_teleop_component(rig: Rig) -> None:
    rig.graph.offers["/MTML_PSM2/following"].clear()


def no_console(rig: Rig) -> None:
    rig.graph.offers["/console/teleop/enabled"].clear()


def other_arms(rig: Rig) -> None:
    rig.graph.offers["/PSM2/hold"].clear()
    rig.deadman = Deadman(rig.graph.node("dissection_deadman_7"), ["/PSM1", "/PSM3"])


def images_of_another_size(rig: Rig) -> None:
    def look() -> None:
        for eye in ("left", "right"):
            stamp = rig.robot.node.stamp()
            rig.robot.infos[eye].publish(camera_info(eye, stamp, K, (128, 96)))
            rig.robot.eyes[eye].publish(Picture(stamp, eye, np.zeros((48, 64, 3), dtype=np.uint8)))

    rig.robot.look = look  # type: ignore[method-assign]


@pytest.mark.parametrize(
    ("strike", "said"),
    [
        (no_left_eye, "no pair of images"),
        (skewed, "no pair of images"),
        (zero_k, "not calibrated"),
        (teleop, "teleoperation off"),
        (nobody, "nobody is there"),
        (stranger, "gui may also command the arm by /PSM1/move_cp"),
        (older_robot, "TransformStamped"),
        (no_robot, "nothing is published by /PSM2"),
        (deaf_robot, "/PSM2/servo_cp (nobody listens)"),
        (two_robots, "/PSM2/measured_js comes from 2 nodes at once"),
        (no_teleop_component, "/MTML_PSM2/following is not published"),
        (no_console, "/console/teleop/enabled is not published"),
        (other_arms, "the deadman does not publish /PSM2/hold; start it with the arms of robot.toml: /PSM1 /PSM2"),
        (images_of_another_size, "the left image is 64 x 48 pixels where its calibration says 128 x 96"),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_what_blocks_a_session_is_named_before_anything_moves(tmp_path, strike, said: str):
    rig = closed(tmp_path)
    strike(rig)

    assert said in refused(rig)
    assert nothing_was_sent(rig)


def nothing_was_sent(rig: Rig) -> bool:
    return all(arm.heard == [] and arm.ratio == 1.0 for arm in rig.robot.arms.values())


def test_the_deadman_is_not_armed_while_anything_else_is_in_the_way(tmp_path):
    rig = closed(tmp_path)
    asked: list[float] = []
    rig.graph.node("listener").subscribe(ARM, Empty, lambda _, received: asked.append(received))
    no_left_eye(rig)

    refused(rig)
    rig.bench.close()
    rig.wait(0.5)

    assert asked == []
    assert rig.deadman is not None and rig.deadman.state == "idle" and nothing_was_sent(rig)


def test_a_start_that_is_refused_after_the_deadman_was_armed_leaves_it_idle_and_the_arms_alone(tmp_path):
    rig = closed(tmp_path)
    rig.graph.node("listener").subscribe(ARM, Empty, lambda *_: teleop(rig))

    assert "teleoperation off" in refused(rig)
    at_once = rig.bench.deadman
    rig.bench.close()
    rig.wait(0.5)

    assert rig.deadman is not None and rig.deadman.state == at_once == "idle" and nothing_was_sent(rig)


def test_a_start_that_is_broken_off_leaves_the_deadman_idle(tmp_path):
    rig = closed(tmp_path)

    once = [KeyboardInterrupt()]

    def interrupt(state: String, _: float) -> None:
        if state.data == "watching" and once:
            raise once.pop()

    rig.graph.node("listener").subscribe(STATE, String, interrupt)
    with pytest.raises(KeyboardInterrupt):
        rig.bench.open()
    rig.bench.close()
    rig.wait(0.5)

    assert rig.deadman is not None and rig.deadman.state == "idle"


def test_a_deadman_that_still_holds_is_armed_by_a_new_session(tmp_path):
    rig = closed(tmp_path)
    asked_hold(rig)

    rig.bench.open()

    assert rig.bench.deadman == "watching"


def test_before_a_session_begins_no_motion_is_taken(tmp_path):
    rig = Rig(tmp_path)
    for arm in rig.robot.arms.values():
        arm.heard.clear()
    rig.bench.close()
    second = BenchDVRK(rig.config, rig.graph.node("second_driver"), wait=rig.wait, threaded=False)
    second.advance(0.3)

    report = second.arms[CUTTER].move_jaw(0.0).report()

    assert report.code is Code.MOVE_REJECTED and "no session has begun" in report.message


def test_a_console_that_was_never_heard_of_is_not_taken_for_one_at_rest(tmp_path):
    rig = closed(tmp_path, console=ConsoleConfig(teleops=("MTMR_PSM9",)))

    verdict = rig.bench.console.verdict()

    assert not verdict.ok and "/MTMR_PSM9/following" in verdict.message


def test_a_silent_endoscope_arm_is_named_where_the_calibration_rests_on_it(tmp_path):
    rig = closed(tmp_path)
    entry = {"name": "PSM1", "measured_cp": np.eye(4).tolist()}
    (tmp_path / "PSM1-registration-open-cv.json").write_text(json.dumps(entry))
    config = replace(rig.config, console=ConsoleConfig(endoscope_arm="ECM"))

    with pytest.raises(InputError, match="/ECM/local/measured_cp has told no valid pose"):
        BenchDVRK(config, rig.graph.node("another"), wait=rig.wait, threaded=False)


def test_a_hand_eye_file_that_is_missing_is_bad_input(tmp_path):
    rig = closed(tmp_path)
    (tmp_path / "PSM2-registration-open-cv.json").unlink()

    with pytest.raises(InputError, match="PSM2-registration"):
        BenchDVRK(rig.config, rig.graph.node("another"), wait=rig.wait, threaded=False)


# ------------------------------------------------------------ under the gate


def both_held(rig: Rig, since: dict[str, int]) -> bool:
    return all(arm.count_of("hold") > since[name] for name, arm in rig.robot.arms.items())


def holds(rig: Rig) -> dict[str, int]:
    return {name: arm.count_of("hold") for name, arm in rig.robot.arms.items()}


def fault(rig: Rig) -> None:
    rig.robot.arms[CUTTER].become("FAULT", error="PSM2: detected power loss (actuators)")


def dead_deadman(rig: Rig) -> None:
    rig.deadman = None


def asked_hold(rig: Rig) -> None:
    rig.graph.node("nurse").publisher(HOLD, Empty).publish(Empty())


def master_gone(rig: Rig) -> None:
    rig.graph.up = False


def other_tool(rig: Rig) -> None:
    rig.robot.arms[CUTTER].tools.publish(String("PROGRASP_FORCEPS:400093"))


def emergency_stop(rig: Rig) -> None:
    for name, arm in rig.robot.arms.items():
        arm.become("FAULT", error=f"{name}: detected power loss (actuators)")


def uncalibrated(rig: Rig) -> None:
    rig.robot.K = np.zeros((3, 3))


@pytest.mark.parametrize(
    ("strike", "code"),
    [
        (emergency_stop, Code.EMERGENCY_STOP),
        (uncalibrated, Code.SETUP_CHANGED),
        (fault, Code.ARM_FAULT),
        (dead_deadman, Code.DEADMAN),
        (asked_hold, Code.DEADMAN),
        (other_tool, Code.SETUP_CHANGED),
    ],
)
def test_16_what_is_past_waiting_trips_the_gate_and_holds_both_arms(tmp_path, strike, code: Code):
    rig = Rig(tmp_path)
    gate = SafetyGate(rig.bench, WIDE)
    lease = gate.grant("expose")
    start = lease.measured_cp(GRASPER).value
    handle = lease.move_cp(GRASPER, start.moved(np.array([0.02, 0, 0])))
    rig.bench.advance(0.3)
    assert handle.report().status is MoveStatus.RUNNING
    before = holds(rig)

    strike(rig)
    rig.bench.advance(0.5)

    assert gate.tripped is not None and gate.tripped.code is code
    assert not lease.alive and both_held(rig, before)
    sent = {name: arm.count_of("servo_cp") for name, arm in rig.robot.arms.items()}
    rig.bench.advance(0.5)
    assert sent == {name: arm.count_of("servo_cp") for name, arm in rig.robot.arms.items()}
    verdict = gate.check_arms()
    assert verdict.latched and not verdict.ok


def test_a_master_that_is_gone_trips_though_nothing_can_be_sent_any_more(tmp_path):
    rig = Rig(tmp_path)
    gate = SafetyGate(rig.bench, WIDE)

    master_gone(rig)
    rig.bench.advance(0.05)

    assert gate.tripped is not None and gate.tripped.code is Code.CONNECTION_LOST


def test_where_somebody_else_drives_an_arm_it_is_paused_and_the_deadman_goes_on_holding_both(tmp_path):
    rig = Rig(tmp_path)
    gate = SafetyGate(rig.bench, WIDE)
    arm = rig.robot.arms[CUTTER]

    arm.q = arm.q + np.array([0.0, 0.0, 1e-3, 0.0, 0.0, 0.0])
    rig.bench.advance(0.05)
    before = holds(rig)
    rig.bench.advance(0.5)

    assert gate.tripped is not None and gate.tripped.code is Code.FOREIGN_MOTION
    assert ("pause", None) in arm.heard and ("pause", None) not in rig.robot.arms[GRASPER].heard
    assert rig.deadman is not None and rig.deadman.state.startswith("holding")
    assert all(count > before[name] + 10 for name, count in holds(rig).items())


def test_eyes_whose_stamps_part_hold_the_session_until_they_agree(tmp_path):
    rig = Rig(tmp_path)
    gate = SafetyGate(rig.bench, WIDE)
    rig.bench.advance(0.5)

    rig.robot.skew = 0.05
    rig.bench.advance(0.5)
    during = gate.check_arms()
    rig.robot.skew = 0.0
    rig.bench.advance(0.5)

    assert during.code is Code.CAMERA_STALE and not during.latched
    assert gate.check_arms().ok


@pytest.mark.parametrize("strike", [teleop, nobody], ids=lambda value: value.__name__)
def test_what_may_pass_takes_the_lease_away_and_waits(tmp_path, strike):
    rig = Rig(tmp_path)
    gate = SafetyGate(rig.bench, WIDE)
    lease = gate.grant("expose")
    before = holds(rig)

    strike(rig)
    rig.bench.advance(0.05)

    assert not lease.alive and gate.tripped is None and both_held(rig, before)
    assert gate.check_arms().code is Code.ARM_NOT_READY


def test_whoever_appears_later_and_may_command_an_arm_ends_the_session(tmp_path):
    rig = Rig(tmp_path)
    gate = SafetyGate(rig.bench, WIDE)

    stranger(rig)
    rig.bench.advance(2.5)

    assert gate.tripped is not None and gate.tripped.code is Code.FOREIGN_MOTION


# ------------------------------------------------------------ time, figures, end


def test_time_starts_at_zero_and_advance_lets_it_pass(tmp_path):
    rig = closed(tmp_path)
    before = rig.bench.now()

    for _ in range(30):
        rig.bench.advance(1 / 30)

    assert rig.bench.now() - before == pytest.approx(1.0, abs=0.04)


def test_figures_tell_rates_and_losses_and_can_be_recorded(tmp_path):
    rig = Rig(tmp_path)
    rig.bench.advance(1.0)

    figures = rig.bench.figures()

    told = json.loads(json.dumps(plain(figures)))
    by_topic = {one["topic"]: one for one in told["topics"]}
    assert by_topic["/PSM1/measured_cp"]["rate"] == pytest.approx(100, rel=0.05)
    assert by_topic["/PSM2/jaw/measured_js"]["dropped"] == 0
    assert {"/stereo/left/image_raw", "/stereo/right/image_raw"} <= by_topic.keys()
    assert told["monitor"]["rate"] > 50


def test_the_end_is_a_hold_of_both_arms_and_an_idle_deadman(tmp_path):
    rig = Rig(tmp_path)
    before = holds(rig)

    rig.bench.close()
    rig.wait(0.5)

    assert both_held(rig, before)
    assert rig.deadman is not None and rig.deadman.state == "idle"
    rig.bench.close()


def test_an_end_without_a_farewell_makes_the_deadman_hold(tmp_path):
    rig = Rig(tmp_path)

    rig.wait(0.2)  # the monitor no longer looks, so the heart no longer beats

    assert rig.deadman is not None and rig.deadman.state.startswith("holding: the supervisor's heartbeat")


def test_a_look_that_fails_beats_no_heart_and_the_gate_still_looks(tmp_path):
    rig = Rig(tmp_path)
    looked = []
    rig.bench.observe(lambda: looked.append(1))

    def broken() -> None:
        raise RuntimeError("broken")

    rig.bench.arms[CUTTER].step = broken  # type: ignore[method-assign]
    with pytest.raises(RuntimeError):
        rig.bench.monitor()
    rig.wait(0.2)

    assert looked == [1]
    assert rig.deadman is not None and rig.deadman.state.startswith("holding")


def test_the_monitor_has_a_thread_of_its_own(tmp_path):
    graph = LocalGraph(time.monotonic)
    bench = BenchDVRK(robot_config(tmp_path), graph.node("driver"))
    names: set[str] = set()
    bench.observe(lambda: names.add(threading.current_thread().name))

    bench.advance(0.2)
    bench.close()

    assert names == {"dvrk-monitor"}
    assert not any(thread.name == "dvrk-monitor" for thread in threading.enumerate())


def test_the_age_of_the_calibration_is_told(tmp_path):
    rig = closed(tmp_path)
    written = (tmp_path / "PSM1-registration-open-cv.json").stat().st_mtime
    bench = BenchDVRK(rig.config, rig.graph.node("b"), wait=rig.wait, wall=written + 3 * 86400 + 10, threaded=False)

    assert "grasper (PSM1) hand-eye 3 days old" in bench.calibration()


# ------------------------------------------------------------ doctor and energy


def test_the_doctor_tells_what_is_there_and_moves_nothing(tmp_path):
    rig = closed(tmp_path)
    beats: list[float] = []
    rig.graph.node("listener").subscribe(HEARTBEAT, Float64, lambda _, received: beats.append(received))

    findings = {finding.name: finding for finding in examine(rig.bench)}
    rig.bench.close()

    assert findings["deadman"].ok and findings["deadman"].detail == "idle"
    assert "disabled, not homed" in findings["grasper (PSM1) state"].detail
    assert findings["endoscope"].ok and "baseline 4.0 mm" in findings["endoscope"].detail
    assert "blocks a session" not in findings
    assert nothing_was_sent(rig) and beats == []


def test_the_doctor_says_what_to_do_about_a_deadman_that_holds(tmp_path):
    rig = closed(tmp_path)
    asked_hold(rig)

    found = next(finding for finding in examine(rig.bench) if finding.name == "deadman")

    assert not found.ok and found.detail == "holding: it was asked for" and "Find out why" in found.remedy


def test_the_doctor_names_what_would_block_a_session(tmp_path):
    rig = closed(tmp_path, deadman=False)
    stranger(rig)

    findings = examine(rig.bench)

    blockers = [finding.detail for finding in findings if finding.name == "blocks a session"]
    assert any("deadman" in said for said in blockers) and any("gui" in said for said in blockers)
    assert not all(finding.ok for finding in findings if finding.required)


@pytest.mark.parametrize(("answer", "applied"), [("y", True), ("", False), (EOFError, False)])
def test_energy_counts_as_applied_only_when_the_operator_says_so(answer, applied: bool):
    asked: list[str] = []

    def ask(question: str) -> str:
        asked.append(question)
        if answer is EOFError:
            raise EOFError
        return answer

    application = OperatorEnergy(ask).apply("PSM2")
    until = time.monotonic() + 5.0
    while application.applied() is None and time.monotonic() < until:
        time.sleep(0.005)

    assert application.applied() is applied and "PSM2" in asked[0]
