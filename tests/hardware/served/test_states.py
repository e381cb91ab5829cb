"""Operating states as in reference 1.1: what is granted, what is told, and when data count."""

import numpy as np
import pytest

from hardware.dvrk import messages as m
from hardware.interface import OperatingState
from hardware.served.states import Doing, granted

COMMANDS = ("enable", "disable", "pause", "resume", "home", "unhome")
TABLE = {
    OperatingState.DISABLED: ("enable", "disable", "unhome"),
    OperatingState.ENABLED: ("enable", "disable", "pause", "home", "unhome"),
    OperatingState.PAUSED: ("disable", "resume", "unhome"),
    OperatingState.FAULT: ("enable", "disable", "unhome"),
}


@pytest.mark.parametrize("state", TABLE)
def test_each_state_grants_what_the_table_says(state):
    assert tuple(command for command in COMMANDS if granted(state, command)) == TABLE[state]


def test_passing_states_look_as_the_dvrk_publishes_them():
    assert Doing.POWERING.state is OperatingState.DISABLED and Doing.POWERING.passing
    assert Doing.MANUAL.state is OperatingState.ENABLED and Doing.MANUAL.passing
    assert Doing.TOOL_ENGAGED.state is OperatingState.ENABLED and not Doing.TOOL_ENGAGED.passing


def test_powering_and_homing_are_busy_until_the_instrument_is_engaged(rig):
    rig.command("PSM1", "enable")
    powering = rig.state("PSM1")
    rig.go(0.5)
    enabled = rig.state("PSM1")
    rig.command("PSM1", "home")
    homing = rig.state("PSM1")
    rig.go(2.0)
    done = rig.state("PSM1")

    assert (powering.state, powering.is_busy) == ("DISABLED", True)
    assert (enabled.state, enabled.is_homed, enabled.is_busy) == ("ENABLED", False, False)
    assert (homing.state, homing.is_busy) == ("ENABLED", True)
    assert (done.state, done.is_homed, done.is_busy) == ("ENABLED", True, False)
    assert rig.newest("/PSM1/tool_type").data == "FENESTRATED_BIPOLAR_FORCEPS:400205"
    assert rig.newest("/PSM1/desired_state").data == "TOOL_ENGAGED"


def test_there_are_six_joints_before_the_arm_comes_to_rest_with_its_instrument(rig):
    """The upstream client reads them in the very moment in which homing ends."""
    rig.command("PSM1", "enable")
    rig.go(0.5)
    rig.command("PSM1", "home")
    while rig.newest("/PSM1/desired_state").data != "ENGAGING_TOOL":
        rig.go(0.01)
    rig.go(0.1)

    assert len(rig.newest("/PSM1/measured_js").position) == 6 and rig.newest("/PSM1/measured_js").stamp > 0.0
    assert rig.newest("/PSM1/measured_cp").stamp == 0.0


def test_homing_goes_to_the_dvrks_posture_and_moves_nothing_on_the_bench(rig):
    before = {name: arm.true_pose() for name, arm in rig.bench.arms.items()}

    rig.ready()

    for name, arm in rig.bench.arms.items():
        assert np.linalg.norm(arm.true_pose().position - before[name].position) < 0.3e-3
        np.testing.assert_allclose(rig.newest(f"/{name}/setpoint_js").position, [0, 0, 0.12, 0, 0, 0], atol=1e-9)


def test_home_before_enable_is_only_a_warning(rig):
    rig.command("PSM1", "home")
    rig.go(0.5)

    assert rig.state("PSM1").state == "DISABLED"
    assert '"home" is not valid in state DISABLED' in rig.newest("/PSM1/warning").data
    assert rig.newest("/PSM1/warning").data.startswith("PSM1: ")


def test_an_unknown_command_changes_nothing(robot):
    start = robot.bench.now()
    robot.command("PSM1", "explode")

    assert robot.state("PSM1").state == "ENABLED"
    assert robot.since("/PSM1/warning", start)


def test_the_state_speaks_on_events_alone_and_again_at_each_command(robot):
    start = robot.go(1.0)
    quiet = robot.since("/PSM1/operating_state", start)
    robot.command("PSM1", "home")  # homed already: nothing to do, and told again

    assert quiet == []
    assert len(robot.since("/PSM1/operating_state", robot.bench.now())) == 1
    assert not robot.state("PSM1").is_busy


def test_whoever_connects_late_hears_the_state_and_the_instrument(robot):
    heard = []
    late = robot.graph.node("late")
    late.subscribe("/PSM1/operating_state", m.OperatingState, lambda x, t: heard.append(x.state))
    late.subscribe("/PSM1/tool_type", m.String, lambda x, t: heard.append(x.data))

    assert heard == ["ENABLED", "FENESTRATED_BIPOLAR_FORCEPS:400205"]


def test_pause_stops_a_move_without_goal_reached_and_resume_restores(robot):
    robot.joints("PSM1", "move_jp", [0.2, 0, 0.14, 0, 0, 0])
    start = robot.go(0.3)
    robot.command("PSM1", "pause")
    stopped = robot.newest("/PSM1/setpoint_js").position
    robot.go(0.5)
    paused = robot.state("PSM1")
    robot.command("PSM1", "resume")
    robot.go(0.1)

    assert (paused.state, paused.is_busy) == ("PAUSED", False)
    assert robot.since("/PSM1/goal_reached", start) == []
    assert np.abs(robot.newest("/PSM1/setpoint_js").position - stopped).max() < 0.01
    assert robot.state("PSM1").state == "ENABLED"


def test_a_paused_arm_moves_for_nobody(robot):
    robot.command("PSM1", "pause")
    before = robot.newest("/PSM1/setpoint_js").position
    robot.joints("PSM1", "move_jp", [0.2, 0, 0.14, 0, 0, 0])
    robot.go(0.5)

    np.testing.assert_array_equal(robot.newest("/PSM1/setpoint_js").position, before)


def test_disable_keeps_the_homing_and_unhome_forgets_it(robot):
    robot.command("PSM1", "disable")
    disabled = robot.state("PSM1")
    robot.command("PSM1", "enable")
    robot.go(0.5)
    enabled = robot.state("PSM1")
    robot.command("PSM1", "unhome")

    assert (disabled.state, disabled.is_homed) == ("DISABLED", True)
    assert (enabled.state, enabled.is_homed, enabled.is_busy) == ("ENABLED", True, False)
    assert not robot.state("PSM1").is_homed
    assert robot.newest("/PSM1/tool_type").data == ""


def test_homing_again_brings_the_arm_back_to_its_posture(robot):
    robot.joints("PSM1", "move_jp", [0.1, 0.05, 0.14, 0.2, 0, 0])
    robot.go(2.0)
    robot.command("PSM1", "unhome")
    robot.command("PSM1", "home")
    robot.go(3.0)

    assert robot.state("PSM1").is_homed and not robot.state("PSM1").is_busy
    np.testing.assert_allclose(robot.newest("/PSM1/measured_js").position, [0, 0, 0.12, 0, 0, 0], atol=2e-3)


def test_data_are_published_from_the_start_with_stamp_zero(rig):
    start = rig.go(0.5)

    cp, js = rig.newest("/PSM1/measured_cp"), rig.newest("/PSM1/measured_js")
    assert len(rig.since("/PSM1/measured_cp", start)) >= 49
    assert cp.stamp == 0.0 and js.stamp == 0.0
    np.testing.assert_array_equal(cp.position, np.zeros(3))
    np.testing.assert_array_equal(cp.quaternion, [0, 0, 0, 1])
    np.testing.assert_array_equal(js.position, np.zeros(6))


@pytest.mark.parametrize("topic", ["measured_cp", "local/measured_cp", "setpoint_cp", "jaw/measured_js", "body/measured_cf"])
def test_stamps_count_once_the_instrument_is_engaged(robot, topic):
    assert abs(robot.newest(f"/PSM1/{topic}").stamp - robot.client.stamp()) < 0.02


def test_the_state_service_answers(robot):
    answer = robot.client.call("/PSM1/operating_state", m.TRIGGER_STATE, m.Ask(), 1.0)

    assert answer.operating_state.state == "ENABLED" and answer.operating_state.is_homed


def test_the_whole_system_is_powered_and_homed_at_once(rig):
    rig.send("/system/power_on", m.Empty())
    rig.go(0.5)
    rig.send("/system/home", m.Empty())
    rig.go(2.0)
    homed = [rig.state(arm).is_homed for arm in ("PSM1", "PSM2")]
    rig.send("/system/power_off", m.Empty())

    assert homed == [True, True]
    assert [rig.state(arm).state for arm in ("PSM1", "PSM2")] == ["DISABLED", "DISABLED"]
