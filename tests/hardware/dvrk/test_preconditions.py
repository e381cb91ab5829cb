"""Each guard by itself: its verdict, its code, its sentence."""

import numpy as np
import pytest

from hardware.codes import Code
from hardware.dvrk import preconditions as must
from hardware.dvrk.config import ToleranceConfig
from hardware.dvrk.messages import Joy
from hardware.dvrk.preconditions import ConsoleReadings
from hardware.dvrk.telemetry import Received
from hardware.interface import OperatingState
from hardware.verdicts import Verdict

TOLERANCES = ToleranceConfig()


def console(**changes: object) -> ConsoleReadings:
    values: dict[str, object] = {"teleops": {"/t": False}, "operator": True, "clutches": {"/c": False}, **changes}
    return ConsoleReadings(**values)  # type: ignore[arg-type]


def test_the_worst_is_what_waiting_does_not_help_against():
    waits = Verdict(False, False, Code.ARM_NOT_READY, "a")
    ends = Verdict(False, True, Code.ARM_FAULT, "b")

    assert must.worst([must.FINE, waits, ends]) is ends
    assert must.worst([must.FINE, waits]) is waits
    assert must.worst([must.FINE]).ok


@pytest.mark.parametrize(
    ("change", "wanted", "said"),
    [
        ({"teleops": {"/t": True}}, True, "/t is true"),
        ({"teleops": {"/t": None}}, True, "/t has not said"),
        ({"operator": False}, True, "nobody is there"),
        ({"operator": None}, True, "has not told"),
        ({"clutches": {"/c": True}}, True, "/c is pressed"),
    ],
)
def test_a_console_in_use_keeps_the_arms_waiting(change: dict, wanted: bool, said: str):
    verdict = must.console_free(console(**change), wanted)

    assert not verdict.ok and not verdict.latched and verdict.code is Code.ARM_NOT_READY
    assert said in verdict.message


def test_a_console_at_rest_is_fine_and_nobody_is_missed_where_nobody_is_wanted():
    assert must.console_free(console(), True).ok
    assert must.console_free(console(operator=None), False).ok
    assert must.console_free(console(teleops={}), True).ok  # there is no console that could drive


@pytest.mark.parametrize(
    ("second", "cut"),
    [
        ((OperatingState.FAULT, "PSM2: detected power loss (actuators)"), True),
        ((OperatingState.FAULT, "PSM2: tracking error"), False),
        ((OperatingState.ENABLED, ""), False),
    ],
)
def test_an_emergency_stop_cuts_the_power_of_all_arms(second: tuple[OperatingState, str], cut: bool):
    assert must.chain_open([(OperatingState.FAULT, "PSM1: detected power loss (actuators)"), second]) is cut


@pytest.mark.parametrize(
    ("changed", "apart", "code"),
    [("", 0.025, Code.OK), ("", 0.05, Code.CAMERA_STALE), ("K is zero", 0.05, Code.SETUP_CHANGED)],
)
def test_cameras_see_as_calibrated_and_at_one_instant(changed: str, apart: float, code: Code):
    assert must.sees_as_calibrated(changed, apart, 0.02).code is code


@pytest.mark.parametrize(("shift", "turn", "ok"), [(0.1e-3, 0.0, True), (0.3e-3, 0.0, False), (0.0, 2e-3, False)])
def test_a_frame_that_moves_or_turns_ends_the_calibration(shift: float, turn: float, ok: bool):
    first, now = np.eye(4), np.eye(4)
    now[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    now[0, 3] = shift

    verdict = must.base_still(now, first, TOLERANCES)

    assert verdict.ok is ok and (ok or verdict.latched)


def test_11_topics_of_an_older_robot_are_named_with_both_types():
    found = must.kinds_as_expected({"/PSM1/measured_cp": "geometry_msgs/TransformStamped"}, {
        "/PSM1/measured_cp": "geometry_msgs/PoseStamped", "/PSM1/tool_type": "std_msgs/String",
    })  # fmt: skip

    assert "TransformStamped instead of a geometry_msgs/PoseStamped (a dVRK before 2.2" in found[0]
    assert found[1] == "/PSM1/tool_type is not published"


def test_whoever_else_may_command_an_arm_is_named():
    verdict = must.only_us({"/PSM1/servo_cp": ("us", "gui"), "/PSM1/move_cp": ()}, ("us",))

    assert verdict.code is Code.FOREIGN_MOTION and "gui may also command the arm by /PSM1/servo_cp" in verdict.message
    assert must.only_us({"/PSM1/servo_cp": ("us",)}, ("us",)).ok


@pytest.mark.parametrize(
    ("nodes", "ok"),
    [(("gui", "dissection_deadman_12_3"), True), (("lab/dissection_deadman",), True), (("gui",), False), ((), False)],
)
def test_the_deadman_must_be_able_to_hold_both_arms(nodes: tuple[str, ...], ok: bool):
    verdict = must.deadman_has({"/PSM1/hold": ("dissection_deadman_1",), "/PSM2/hold": nodes}, "dissection_deadman")

    assert verdict.ok is ok
    assert ok or (verdict.code is Code.DEADMAN and "does not publish /PSM2/hold" in verdict.message)


@pytest.mark.parametrize(("buttons", "held"), [((0,), False), ((1,), True), ((2,), False), ((), False)])
def test_a_tap_of_a_pedal_is_over(buttons: tuple[int, ...], held: bool):
    assert must.pressed(Received(Joy(1.0, buttons), 1.0, 1.0)) is held


def test_a_pedal_that_never_spoke_is_not_pressed():
    assert not must.pressed(None)
