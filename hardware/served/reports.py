"""What a served arm reports a hundred times per second: readings taken once, and a message for every topic that somebody hears.

Data are published whether valid or not. Invalid ones have the stamp 0, zeros for joints and the identity for poses (reference 1.2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from hardware.dvrk import kinematics
from hardware.dvrk.messages import JointState, Matrix, Message, PoseStamped, TwistStamped, WrenchStamped
from hardware.interface import Array, Pose
from hardware.served.arm import ServedArm
from hardware.served.faults import Fault, Faults
from hardware.served.motion import JAW
from hardware.served.plant import JAW_STIFFNESS

NAMES = ("yaw", "pitch", "insertion", "roll", "wrist_pitch", "wrist_yaw")
ACTUATORS = tuple(f"actuator_{number}" for number in range(1, 8))
JUMP = np.array([5e-3, 0.0, 0.0])  # [m], of a base frame that was moved
OTHER_FRAME, OTHER_TOOL = "ECM", "LARGE_NEEDLE_DRIVER:400006"


@dataclass(frozen=True)
class Readings:
    """One look at an arm. Poses (4, 4) are below the remote centre; `base` (4, 4) is where that is in the reference frame."""

    at: float  # [s], ROS time
    joints: Array
    speeds: Array
    efforts: Array
    setpoint: Array  # (7,)
    setpoint_speeds: Array
    tip: Array
    setpoint_tip: Array
    jacobian: Array
    force: Array  # (3,) [N], base axes
    jaw: float
    jaw_speed: float
    base: Array
    frame_id: str
    joints_valid: bool
    tip_valid: bool
    engaged: bool


def read(arm: ServedArm, at: float, last: Readings | None) -> Readings:
    """Look at `arm`, whose plant has measured, at ROS time `at` [s]; speeds are differences to the `last` look."""
    plant, motion = arm.plant, arm.motion
    step = at - last.at if last is not None else 0.0
    since = last if step > 1e-6 else None
    same = last is not None and np.array_equal(last.setpoint, motion.setpoint) and last.engaged == bool(arm.tool_type)
    return Readings(
        at=at,
        joints=plant.joints,
        speeds=(plant.joints - since.joints) / step if since is not None else np.zeros(6),
        efforts=-plant.jacobian[:3].T @ plant.force,  # the motors' share against what pulls at the tip
        setpoint=motion.setpoint.copy(),
        setpoint_speeds=motion.velocity.copy(),
        tip=plant.tip,
        setpoint_tip=last.setpoint_tip if same and last else kinematics.forward(plant.instrument, motion.setpoint[:JAW]),
        jacobian=plant.jacobian,
        force=plant.force,
        jaw=plant.jaw,
        jaw_speed=(plant.jaw - since.jaw) / step if since is not None else 0.0,
        base=arm.base.copy(),
        frame_id=arm.frame_id,
        joints_valid=arm.joints_valid,
        tip_valid=arm.tip_valid,
        engaged=bool(arm.tool_type),
    )


def altered(readings: Readings, frozen: Readings | None, faults: Faults, arm: str) -> Readings:
    """The readings as the faults in effect let them out; `frozen` are those from before they froze."""
    if frozen is not None and faults.on(Fault.FROZEN, arm):
        readings = replace(frozen, at=readings.at)
    if frozen is not None and faults.on(Fault.STAMP_STALE, arm):
        readings = replace(readings, at=frozen.at)
    if faults.on(Fault.STAMP_ZERO, arm):
        readings = replace(readings, joints_valid=False, tip_valid=False)
    if faults.on(Fault.FRAME_ID, arm):
        readings = replace(readings, frame_id=OTHER_FRAME)
    if faults.on(Fault.BASE_JUMP, arm):
        base = readings.base.copy()
        base[:3, 3] += JUMP
        readings = replace(readings, base=base)
    return readings


def messages(name: str, faults: Faults) -> dict[str, tuple[type[Message], Callable[[Readings], Message]]]:
    """By topic of the arm `name`: its kind, and how it is made of readings."""

    def pose(reference: bool, setpoint: bool) -> Callable[[Readings], Message]:
        def make(r: Readings) -> Message:
            if not r.tip_valid:
                return PoseStamped(0.0, _frame(r, reference), np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
            matrix = r.setpoint_tip if setpoint else r.tip
            found = _pose(r.base @ matrix if reference else matrix)
            position, quaternion = found.position, found.quaternion
            if faults.on(Fault.NAN_POSE, name):
                position = np.full(3, np.nan)
            if faults.on(Fault.NON_UNIT_QUATERNION, name):
                quaternion = 1.1 * quaternion
            return PoseStamped(r.at, _frame(r, reference), position, quaternion)

        return make

    def twist(reference: bool) -> Callable[[Readings], Message]:
        def make(r: Readings) -> Message:
            moves = r.jacobian @ r.speeds if r.tip_valid else np.zeros(6)
            turn = r.base[:3, :3] if reference else np.eye(3)
            return TwistStamped(_tip_stamp(r), _frame(r, reference), turn @ moves[:3], turn @ moves[3:])

        return make

    def base_frame(r: Readings) -> str:
        return f"{name}_base"

    def _frame(r: Readings, reference: bool) -> str:
        return r.frame_id if reference else base_frame(r)

    def body_force(r: Readings) -> Message:
        force = r.tip[:3, :3].T @ r.force if r.tip_valid else np.zeros(3)
        return WrenchStamped(_tip_stamp(r), name, force, np.zeros(3))

    def spatial_force(r: Readings) -> Message:
        force = r.force if r.tip_valid else np.zeros(3)
        return WrenchStamped(_tip_stamp(r), base_frame(r), force, np.cross(r.tip[:3, 3], force))

    return {
        "measured_js": (JointState, _measured_joints),
        "setpoint_js": (JointState, _setpoint_joints),
        "measured_cp": (PoseStamped, pose(True, False)),
        "setpoint_cp": (PoseStamped, pose(True, True)),
        "local/measured_cp": (PoseStamped, pose(False, False)),
        "local/setpoint_cp": (PoseStamped, pose(False, True)),
        "measured_cv": (TwistStamped, twist(True)),
        "local/measured_cv": (TwistStamped, twist(False)),
        "body/measured_cf": (WrenchStamped, body_force),
        "spatial/measured_cf": (WrenchStamped, spatial_force),
        "body/jacobian": (Matrix, _body_jacobian),
        "spatial/jacobian": (Matrix, _spatial_jacobian),
        "jaw/measured_js": (JointState, _measured_jaw),
        "jaw/setpoint_js": (JointState, _setpoint_jaw),
    }


# ------------------------------------------------------------ pieces


def _measured_joints(r: Readings) -> Message:
    if not r.engaged and r.joints_valid:  # no instrument: what is left are the seven actuators
        return JointState(r.at, ACTUATORS, np.append(r.joints, r.jaw), np.zeros(7), np.zeros(7))
    if not r.joints_valid:
        return JointState(0.0, NAMES, np.zeros(6), np.zeros(6), np.zeros(6))
    return JointState(r.at, NAMES, r.joints, r.speeds, r.efforts)


def _setpoint_joints(r: Readings) -> Message:
    if not r.engaged and r.joints_valid:
        return JointState(r.at, ACTUATORS, r.setpoint, r.setpoint_speeds, np.zeros(7))
    if not r.joints_valid:
        return JointState(0.0, NAMES, np.zeros(6), np.zeros(6), np.zeros(6))
    return JointState(r.at, NAMES, r.setpoint[:JAW], r.setpoint_speeds[:JAW], r.efforts)


def _measured_jaw(r: Readings) -> Message:
    if not r.tip_valid:
        return JointState(0.0, ("jaw",), np.zeros(1), np.zeros(1), np.zeros(1))
    effort = JAW_STIFFNESS * (float(r.setpoint[JAW]) - r.jaw)
    return JointState(r.at, ("jaw",), np.array([r.jaw]), np.array([r.jaw_speed]), np.array([effort]))


def _setpoint_jaw(r: Readings) -> Message:
    if not r.tip_valid:
        return JointState(0.0, ("jaw",), np.zeros(1))
    return JointState(r.at, ("jaw",), r.setpoint[JAW:].copy())


def _body_jacobian(r: Readings) -> Message:
    turn = r.tip[:3, :3].T
    return Matrix(np.vstack([turn @ r.jacobian[:3], turn @ r.jacobian[3:]]))


def _spatial_jacobian(r: Readings) -> Message:
    """Of the point of the tip that is at the remote centre."""
    angular = r.jacobian[3:]
    return Matrix(np.vstack([r.jacobian[:3] + np.cross(r.tip[:3, 3], angular.T).T, angular]))


def _tip_stamp(r: Readings) -> float:
    return r.at if r.tip_valid else 0.0


def _pose(matrix: Array) -> Pose:
    return Pose.from_matrix(matrix[:3, :3], matrix[:3, 3])
