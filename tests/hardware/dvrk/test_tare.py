"""What the grasper's force estimate tells at rest is taken off; never what may be the pull of tissue."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hardware.codes import Code
from hardware.dvrk.config import ToleranceConfig
from hardware.dvrk.kinematics import forward
from hardware.dvrk.tare import SPAN
from hardware.interface import CUTTER, GRASPER, Pose
from tests.mocks.robot import Rig, ScriptedArm

WEIGHT = np.array([0.3, -0.2, 0.8])  # [N], tip axes
PULL = np.array([0.2, 0.0, 0.5])


def started(folder: Path, prepare: Callable[[ScriptedArm], None] = lambda arm: None, wait: float = 1.0, **config: object) -> Rig:
    """A session whose grasper tells `WEIGHT` from the first, `wait` [s] after it was homed."""
    rig = Rig(folder, opened=False, **config)
    for arm in rig.robot.arms.values():
        arm.force = WEIGHT
    prepare(rig.robot.arms[GRASPER])
    rig.bench.open()
    for arm in rig.bench.arms.values():
        arm.state_command("enable")
        arm.state_command("home")
    rig.bench.advance(wait)
    return rig


def force(rig: Rig, role: str = GRASPER) -> np.ndarray:
    return rig.bench.arms[role].measured_cf().value


def test_what_the_grasper_tells_at_rest_is_taken_off(tmp_path: Path):
    rig = started(tmp_path)
    at_rest = force(rig)

    rig.robot.arms[GRASPER].force = WEIGHT + PULL
    rig.bench.advance(0.1)

    assert at_rest == pytest.approx(np.zeros(3), abs=1e-9)
    assert force(rig) == pytest.approx(tip_axes(rig) @ PULL, abs=1e-9)


def test_weight_stays_taken_off_where_the_tip_turns(tmp_path: Path):
    rig = started(tmp_path)
    arm = rig.bench.arms[GRASPER]
    start = arm.measured_cp().value
    weight = tip_axes(rig) @ WEIGHT  # along the camera's axes, which do not turn

    handle = arm.move_cp(Pose.from_matrix(start.rotation() @ _about_x(0.3), start.position))
    rig.bench.advance(3.0)
    rig.robot.arms[GRASPER].force = tip_axes(rig).T @ weight
    rig.bench.advance(0.1)

    assert handle.report().status == "done"
    assert force(rig) == pytest.approx(np.zeros(3), abs=1e-6)


def test_the_scissors_are_not_tared_as_nobody_asks_them_for_tension(tmp_path: Path):
    rig = started(tmp_path)

    assert np.linalg.norm(force(rig, CUTTER)) == pytest.approx(np.linalg.norm(WEIGHT))


def _closed(arm: ScriptedArm) -> None:
    arm.jaw = arm.jaw_goal = arm.jaw_setpoint = 0.05


def _barely_open(arm: ScriptedArm) -> None:
    arm.blocked_at, arm.jaw_setpoint, arm.jaw_goal = 0.2, 0.0, 0.0


@pytest.mark.parametrize("held", [_closed, _barely_open])
def test_jaws_that_may_hold_tissue_take_nothing_off(tmp_path: Path, held: Callable[[ScriptedArm], None]):
    rig = started(tmp_path, held)

    assert np.linalg.norm(force(rig)) == pytest.approx(np.linalg.norm(WEIGHT))
    assert rig.bench.figures()["force_at_rest"] is None


def test_an_arm_that_is_not_still_takes_nothing_off_until_it_is(tmp_path: Path):
    rig = started(tmp_path, wait=0.02)
    arm = rig.robot.arms[GRASPER]

    for k in range(round(2.0 * SPAN / 0.01)):
        arm.lag = np.array([0.0, 0.0, 0.5e-3 * (-1) ** (k // 10)])
        rig.bench.advance(0.01)
        assert rig.bench.figures()["force_at_rest"] is None
    rig.bench.advance(1.5 * SPAN)

    assert np.linalg.norm(rig.bench.figures()["force_at_rest"]) == pytest.approx(np.linalg.norm(WEIGHT))


def test_once_the_first_motion_began_nothing_is_taken_off_any_more(tmp_path: Path):
    rig = started(tmp_path, wait=0.5 * SPAN)
    arm = rig.bench.arms[GRASPER]

    arm.move_cp(arm.measured_cp().value.moved(np.array([1e-3, 0.0, 0.0])))
    rig.bench.advance(3.0)

    assert rig.bench.figures()["force_at_rest"] is None


def test_what_was_taken_off_stays_the_same_when_tissue_pulls(tmp_path: Path):
    rig = started(tmp_path)
    before = rig.bench.figures()["force_at_rest"]

    rig.robot.arms[GRASPER].force = WEIGHT + 3.0 * PULL
    rig.bench.advance(2.0)

    assert np.array_equal(rig.bench.figures()["force_at_rest"], before)


def test_an_estimate_that_tells_too_much_at_rest_holds_the_arms_until_it_does_not(tmp_path: Path):
    rig = started(tmp_path, tolerances=ToleranceConfig(force_at_rest=0.5))
    arm = rig.bench.arms[GRASPER]
    guard = arm.operating_state().guard

    assert not guard.ok and not guard.latched and guard.code is Code.ARM_NOT_READY
    assert "grasper (PSM1) tells a force of 0.9 N at rest with its jaws open, more than 0.5 N" in guard.message
    assert arm.move_cp(arm.measured_cp().value).report().status == "failed"

    rig.robot.arms[GRASPER].force = 0.3 * WEIGHT
    rig.bench.advance(3.0 * SPAN)

    assert arm.operating_state().guard.ok
    assert force(rig) == pytest.approx(np.zeros(3), abs=1e-9)


def test_a_robot_that_tells_no_force_is_not_tared_by_nothing(tmp_path: Path):
    rig = started(tmp_path, lambda arm: setattr(arm, "force", np.full(3, np.nan)))

    assert np.isnan(force(rig)).all()
    assert rig.bench.figures()["force_at_rest"] is None


def tip_axes(rig: Rig) -> np.ndarray:
    """The dVRK's own tip frame, in which it tells forces, along the camera's axes."""
    camera_from_base = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    return camera_from_base @ forward(rig.config.grasper.instrument, rig.robot.arms[GRASPER].q)[:3, :3]


def _about_x(angle: float) -> np.ndarray:
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]])
