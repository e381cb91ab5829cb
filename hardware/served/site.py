"""Where the served robot stands: bases from which each arm's homing posture is the stub's waiting pose, and the files that say so.

A stub arm knows no base. One is made up for each arm such that the posture in which the dVRK homes, all joints 0 and 0.12 m inserted,
puts the tip exactly where the stub's instrument waits. So homing moves nothing, and the tissue lies well within reach.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from hardware.dvrk import kinematics
from hardware.dvrk.calibration import ArmFrames, HandEye, arm_frames, as_matrix
from hardware.dvrk.config import ArmConfig, RobotConfig, load_robot
from hardware.interface import CUTTER, GRASPER, Array
from hardware.served.plant import HOME
from hardware.stub.bench import StubBench

ROBOT = "robot.toml"
SCISSORS = "POTTS_SCISSORS:400001"
TEXT = """\
# The stub bench as `dissect serve-stub` publishes it, for `dissect run --bench dvrk --config {file}`. Written anew at each start.

transport = "{transport}"
prefix = "{prefix}"

[grasper]
name = "PSM1"
tool_type = "FENESTRATED_BIPOLAR_FORCEPS:400205"
calibration = "PSM1-registration-open-cv.json"
jaw_length = 0.0195

[cutter]
name = "PSM2"
tool_type = "{cutter}"
calibration = "PSM2-registration-open-cv.json"
jaw_length = 0.0110
jaw_closed = -0.2

[camera]
rig = "stereo"
rectified = true

[console]
endoscope_arm = "ECM"
setup_joints = "SUJ"
"""


def bases(bench: StubBench, config: RobotConfig) -> Mapping[str, ArmFrames]:
    """The fixed frames of each arm, by its name on the stub bench."""
    found = {}
    for role, arm in ((GRASPER, config.grasper), (CUTTER, config.cutter)):
        unplaced = arm_frames(HandEye(np.eye(4), "camera", -math.inf), arm)
        tool = as_matrix(bench.arms[role].setpoint_cp())
        homed = kinematics.forward(arm.instrument, HOME) @ unplaced.tip_from_tool
        found[role] = ArmFrames(tool @ np.linalg.inv(homed), unplaced.tip_from_tool)
    return found


def write_hand_eye(arm: ArmConfig, camera_from_base: Array) -> None:
    """Write the calibration of `arm` to where its configuration looks for it, as dvrk_camera_registration would, in OpenCV's axes."""
    content = {"base-frame": {"reference-frame": "camera", "transform": camera_from_base.tolist()}}
    arm.calibration.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def write_site(bench: StubBench, folder: Path, transport: str = "ros1", prefix: str = "", cutter: str = SCISSORS) -> RobotConfig:
    """Write the configuration of the served robot and its hand-eye files into `folder`, and read it; PSM2 holds the tool type `cutter`.

    Raises:
        InputError: `transport` or `prefix` is none, or nobody knows the instrument.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / ROBOT
    path.write_text(TEXT.format(file=ROBOT, transport=transport, prefix=prefix, cutter=cutter), encoding="utf-8")
    config = load_robot(path)
    for arm, frames in zip(config.arms, bases(bench, config).values(), strict=True):
        write_hand_eye(arm, frames.camera_from_base)
    return config
