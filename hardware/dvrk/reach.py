"""Whether an arm would go to exactly where it is sent: it clips, pushes and alters without a word what it cannot reach."""

from __future__ import annotations

from collections.abc import Sequence

from hardware.dvrk.arm_readings import ArmReadings
from hardware.dvrk.calibration import ArmFrames, as_matrix, to_base
from hardware.dvrk.config import ArmConfig
from hardware.dvrk.kinematics import reached
from hardware.interface import Pose


def unreachable(arm: ArmConfig, frames: ArmFrames, readings: ArmReadings, poses: Sequence[Pose]) -> str:
    """Why the arm would not go to exactly these tool poses in the camera frame, one after the other; "" when it would."""
    joints = readings.joints.good
    if joints is None or readings.base is None:
        return f"the joints of {arm.called} are not known"
    near = joints.message.position
    for pose in poses:
        if not pose.is_finite():
            return "the commanded pose is not finite"
        solution = reached(arm.instrument, as_matrix(to_base(frames, pose)), near)
        if solution.reason:
            return f"{arm.called}: {solution.reason}"
        near = solution.q
    return ""
