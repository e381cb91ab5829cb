"""What is on the graph, held against what a session needs: missing topics, other types, a camera that was never calibrated."""

from __future__ import annotations

from collections.abc import Sequence

from hardware.codes import InputError
from hardware.dvrk import messages as m
from hardware.dvrk.arm import ArmDVRK
from hardware.dvrk.config import RobotConfig
from hardware.dvrk.console import Console
from hardware.dvrk.endoscope import EndoscopeDVRK
from hardware.dvrk.preconditions import kinds_as_expected
from hardware.dvrk.transport import Transport, TransportError

# What each arm must publish, by type: an older robot publishes the same names with other types, and nothing would arrive
ARM_KINDS: dict[str, type[m.Message]] = {
    "operating_state": m.OperatingState,
    "measured_js": m.JointState,
    "measured_cp": m.PoseStamped,
    "local/measured_cp": m.PoseStamped,
    "local/setpoint_cp": m.PoseStamped,
    "body/measured_cf": m.WrenchStamped,
    "goal_reached": m.Bool,
    "tool_type": m.String,
    "trajectory_j/ratio": m.Float64,
}
JAW_KINDS: dict[str, type[m.Message]] = {"jaw/measured_js": m.JointState, "jaw/setpoint_js": m.JointState}


def survey(
    config: RobotConfig, transport: Transport, arms: Sequence[ArmDVRK], endoscope: EndoscopeDVRK, console: Console
) -> list[str]:
    """What is missing or of another type, one sentence each; empty when all is there."""
    try:
        kinds = transport.kinds()
    except TransportError as error:
        return [str(error)]
    found: list[str] = []
    for arm in arms:
        expected = ARM_KINDS | (JAW_KINDS if arm.config.instrument.has_jaw else {})
        names = {config.topic(f"{arm.config.name}/{name}"): kind.ROS for name, kind in expected.items()}
        wrong = kinds_as_expected(kinds, names)
        if len(wrong) == len(names):
            wrong = [
                f"nothing is published by {config.topic(arm.config.name)}; start the robot's node, or correct its name or prefix"
            ]
        found += wrong
        if not wrong:
            found += [f"{topic} is not connected" for topic in arm.missing()]
    found += [f"{topic} is not published" for topic in [*endoscope.missing(), *console.missing()]]
    if not endoscope.missing():
        try:
            endoscope.camera  # noqa: B018 - asked for its refusal
        except InputError as error:
            found.append(str(error))
    found += endoscope.unfit()
    return found
