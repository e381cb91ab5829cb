"""What a lab writes down about its robot: a TOML file, read into frozen dataclasses of the same shape.

Every table below is a table of the file; docs/robot.toml explains all keys. Nothing here talks to the robot: whether what is
written is true is asked of the graph by the driver's preconditions.
"""

from __future__ import annotations

import difflib
import math
import re
import tomllib
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from hardware.codes import InputError
from hardware.dvrk.instruments import Instrument, instrument
from hardware.limits import Limits

C = TypeVar("C")
TRANSPORTS = ("ros1", "ros2")
FARTHEST = 0.3  # [m], of the workspace from the camera
AXES = ("", "open-cv", "dvrk")
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z][A-Za-z0-9_]*)*")


def _within(default: float, low: float, high: float) -> Any:
    """A number that must lie from `low` to `high`."""
    return field(default=default, metadata={"low": low, "high": high})


def _named(default: str, optional: bool = False) -> Any:
    """A ROS name without a leading slash; `optional`: or nothing at all."""
    return field(default=default, metadata={"name": True, "optional": optional})


class _Checked:
    """Holds each field against what its metadata ask for."""

    def __post_init__(self) -> None:
        for item in fields(self):  # type: ignore[arg-type]
            value, rule = getattr(self, item.name), item.metadata
            if "low" in rule and not rule["low"] <= value <= rule["high"]:  # NaN fails too
                raise InputError(f"{item.name} is {value}; it must lie from {rule['low']:g} to {rule['high']:g}")
            if rule.get("name") and not (NAME.fullmatch(value) or (rule["optional"] and not value)):
                raise InputError(f"{item.name} is {value!r}; it must be a name of letters, digits and _, such as PSM1")


@dataclass(frozen=True)
class ArmConfig(_Checked):
    """One arm, and the instrument that it is expected to hold.

    `name` is what CRTK calls the arm; what it does in the session, its `role`, follows from the table it stands in (grasper or cutter).
    `tip_rotation` turns the dVRK's tip frame into our tool frame: see `hardware.dvrk.calibration`.
    """

    name: str = field(metadata={"name": True, "optional": False})
    tool_type: str
    calibration: Path  # hand-eye file; relative to the folder of the configuration
    # [m], from the wrist-yaw axis to the tip: the dVRK does not know of it
    jaw_length: float = field(metadata={"low": 0.0, "high": 0.04})
    frame_id: str = ""  # that measured_cp must come in; nothing: NAME_base, the robot's own base frame being the identity
    calibration_axes: str = ""  # open-cv or dvrk; nothing: as the name of the file says
    tip_rotation: tuple[float, ...] = (0.0, 0.0, math.pi / 2)  # [rad], rotation vector
    jaw_zero: float = _within(0.0, -0.35, 0.35)  # [rad], what the robot measures where the jaws just meet
    jaw_closed: float = _within(-0.35, -0.7, 0.0)  # [rad], what to command for a firm closing: below jaw_zero is torque
    role: str = field(default="", metadata={"told": True})  # no key of the file

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.frame_id:
            object.__setattr__(self, "frame_id", f"{self.name}_base")
        if len(self.tip_rotation) != 3 or not math.hypot(*self.tip_rotation) <= math.pi + 1e-9:
            raise InputError(f"tip_rotation is {self.tip_rotation}; it must be three numbers of a rotation by at most pi [rad]")
        if self.calibration_axes not in AXES:
            raise InputError(f"calibration_axes is {self.calibration_axes!r}; it must be 'open-cv' or 'dvrk', or be left out")
        tool = self.instrument
        if tool.has_jaw and not tool.jaw_lower <= self.jaw_closed <= self.jaw_zero:
            raise InputError(
                f"jaw_closed is {self.jaw_closed}; it must lie from {tool.jaw_lower:.3f}, the limit of {tool.name}, "
                f"to jaw_zero, {self.jaw_zero}"
            )

    @property
    def called(self) -> str:
        """What people are told of: what the arm does and what CRTK calls it, such as "grasper (PSM1)"."""
        return f"{self.role} ({self.name})" if self.role else self.name

    @property
    def instrument(self) -> Instrument:
        """Geometry and limits of the expected instrument."""
        return instrument(self.tool_type)


@dataclass(frozen=True)
class CameraConfig(_Checked):
    """The stereo endoscope: topics `<rig>/left/image_raw` and so on."""

    rig: str = _named("stereo")
    rectified: bool = False  # True: take image_rect_color as it comes; False: take image_raw and rectify by camera_info
    max_skew: float = _within(0.020, 0.0, 0.1)  # [s], between the eyes: the grabbers are not synchronised
    max_age: float = _within(0.2, 0.02, 1.0)  # [s], of a pair that is looked at


@dataclass(frozen=True)
class ConsoleConfig(_Checked):
    """Who else may move the arms, and what must stand still for the calibration to hold."""

    system: str = _named("system")  # namespace of power and homing; "console" before dVRK 2.4
    console: str = _named("console", optional=True)  # namespace of operator and teleoperation; nothing: none
    teleops: tuple[str, ...] = ("MTMR_PSM1", "MTML_PSM2")  # teleoperation components, none of which may be following
    operator_presence: bool = True  # True: somebody must be at the console while arms move
    endoscope_arm: str = _named("", optional=True)  # CRTK name of the arm that holds the endoscope; nothing: a fixed mount
    setup_joints: str = _named("", optional=True)  # namespace of the set-up joints ("SUJ"); nothing: fixed bases
    # Topic (sensor_msgs/Joy) of a stop button, beside the hardware chain that there must be anyway; nothing: none
    emergency_stop: str = _named("", optional=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in self.teleops:
            if not NAME.fullmatch(name):
                raise InputError(f"teleops holds {name!r}; it must hold names of teleoperation components, such as MTMR_PSM1")
        if self.operator_presence and not self.console:
            raise InputError("operator_presence is true without a console to tell it; name the console, or set it to false")


@dataclass(frozen=True)
class ToleranceConfig(_Checked):
    """How near measured must come to commanded, and how far anything may drift without a command."""

    # At the end of a motion, in `samples` measurements in a row. A closing on tissue ends where the tissue stops it.
    position: float = _within(1.0e-3, 1e-4, 5e-3)  # [m]
    rotation: float = _within(0.05, 5e-3, 0.2)  # [rad]
    jaw: float = _within(0.10, 0.01, 0.35)  # [rad]
    samples: int = field(default=3, metadata={"low": 1, "high": 50})
    # [N], what the grasper may tell at rest with its jaws open; it is taken off. More: it touches something
    force_at_rest: float = _within(2.0, 0.1, 10.0)
    # Setpoint to measured while moving: more is a fault. The robot itself allows 5 cm and 30 degrees.
    tracking: float = _within(5.0e-3, 1e-3, 2e-2)  # [m]
    tracking_rotation: float = _within(0.25, 0.02, 0.6)  # [rad]
    # Without a command of ours: a setpoint that moves is somebody else's, a base or an endoscope that moves ends the calibration.
    foreign: float = _within(0.5e-3, 1e-4, 5e-3)  # [m]
    frame_shift: float = _within(0.2e-3, 1e-5, 2e-3)  # [m]


@dataclass(frozen=True)
class SpeedConfig(_Checked):
    """How fast we move the arms. Streamed motion keeps to the speeds, joint trajectories to the ratio."""

    ratio: float = _within(0.1, 0.02, 0.3)  # of the robot's trajectory speed and acceleration
    linear: float = _within(0.02, 1e-3, 0.05)  # [m/s], of the tip
    angular: float = _within(0.5, 0.02, 1.5)  # [rad/s]


@dataclass(frozen=True)
class RateConfig(_Checked):
    """How often things happen, and how long nothing may happen."""

    monitor: float = _within(100.0, 50.0, 200.0)  # [Hz], guards, and setpoints while streaming
    stale: float = _within(0.1, 0.02, 0.5)  # [s], telemetry older than this by receive time is no basis for motion
    # [s], joints that did not change at all this long after the arm was sent elsewhere come from no live encoder
    frozen: float = _within(0.5, 0.1, 5.0)
    busy_within: float = _within(0.5, 0.1, 2.0)  # [s], a move that has not made the arm busy by then was rejected
    connect_within: float = _within(5.0, 0.5, 60.0)  # [s], for topics and the deadman at start-up

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.frozen <= self.stale:
            raise InputError(f"frozen is {self.frozen}; it must be longer than stale, {self.stale}")


def _limit(name: str, low: float, high: float) -> Any:
    """One of the gate's limits: a number from `low` to `high`, the gate's own where it is left out."""
    return _within(getattr(Limits, name), low, high)


@dataclass(frozen=True)
class LimitsConfig(_Checked):
    """Those limits of the safety gate that are a matter of the table and the phantom; see `hardware.limits`."""

    # Box that the tool tips may not leave [m], left camera frame
    workspace_lower: tuple[float, ...] = Limits.workspace_lower
    workspace_upper: tuple[float, ...] = Limits.workspace_upper
    max_speed: float = _limit("max_speed", 1e-3, 20e-3)  # [m/s], near tissue
    max_loaded_speed: float = _limit("max_loaded_speed", 0.5e-3, 10e-3)  # [m/s], with tissue in the grasp under load
    min_tool_distance: float = _limit("min_tool_distance", 1e-3, 20e-3)  # [m]
    # By motor currents: guards against the worst, no measurement
    tension_warn: float = _limit("tension_warn", 0.1, 10.0)  # [N]
    tension_stop: float = _limit("tension_stop", 0.1, 10.0)  # [N], pulling further is refused
    tension_abort: float = _limit("tension_abort", 0.1, 12.0)  # [N], trips

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("workspace_lower", "workspace_upper"):
            box = getattr(self, name)
            if len(box) != 3 or not all(abs(side) <= FARTHEST for side in box):
                raise InputError(f"{name} is {list(box)}; it must be three numbers [m], none beyond {FARTHEST:g}")
        self.limits()

    def limits(self) -> Limits:
        """All limits of the gate, with these among them.

        Raises:
            InputError: two of them contradict each other.
        """
        return Limits(**{item.name: getattr(self, item.name) for item in fields(self)})


@dataclass(frozen=True)
class RobotConfig(_Checked):
    """One robot: two arms, a stereo endoscope, and the graph on which they are found.

    Raises:
        InputError: a value is out of range or contradicts another one.
    """

    grasper: ArmConfig
    cutter: ArmConfig
    transport: str = "ros1"
    prefix: str = ""  # namespace in front of all of the robot's topics, such as "/dvrk"; nothing: they are at the root
    camera: CameraConfig = field(default_factory=CameraConfig)
    console: ConsoleConfig = field(default_factory=ConsoleConfig)
    tolerances: ToleranceConfig = field(default_factory=ToleranceConfig)
    speeds: SpeedConfig = field(default_factory=SpeedConfig)
    rates: RateConfig = field(default_factory=RateConfig)
    limits: LimitsConfig = field(default_factory=LimitsConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        for role in ("grasper", "cutter"):
            object.__setattr__(self, role, replace(getattr(self, role), role=role))
        if self.transport not in TRANSPORTS:
            raise InputError(f"transport is {self.transport!r}; it must be one of {', '.join(TRANSPORTS)}")
        if self.prefix and not (self.prefix[0] == "/" and NAME.fullmatch(self.prefix[1:])):
            raise InputError(
                f"prefix is {self.prefix!r}; it must begin with a slash and not end with one, such as /dvrk, or be left out"
            )
        if self.grasper.name == self.cutter.name:
            raise InputError(f"grasper and cutter are both {self.grasper.name}; they must be two arms")
        if not self.grasper.instrument.has_jaw:
            raise InputError(f"the grasper's tool_type is {self.grasper.tool_type}, which has no jaw; it must be forceps")

    @property
    def arms(self) -> tuple[ArmConfig, ArmConfig]:
        """Grasper and cutter."""
        return self.grasper, self.cutter

    def topic(self, name: str) -> str:
        """The absolute name of a topic, of "PSM1/measured_cp" for one."""
        return f"{self.prefix}/{name}"


def load_robot(path: Path) -> RobotConfig:
    """Read a robot's configuration; paths in it are relative to its own folder.

    Raises:
        InputError: the file cannot be read, a key is unknown or missing, or a value is of the wrong type or out of range; the sentence
            names the key and what would be right.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"the robot's configuration {path.name} cannot be read: {error}") from error
    return _from_table(RobotConfig, table, path.name, path.parent)


def _from_table(kind: type[C], table: dict[str, Any], where: str, folder: Path) -> C:
    """A frozen dataclass from a TOML table."""
    hints = get_type_hints(kind)
    known = {item.name: item for item in fields(kind) if not item.metadata.get("told")}  # type: ignore[arg-type]
    for key in table.keys() - known.keys():
        near = difflib.get_close_matches(key, known, 1)
        hint = f"did you mean {near[0]!r}?" if near else f"known keys are {', '.join(known)}"
        raise InputError(f"{where}: the key {key!r} is unknown; {hint}")
    missing = [key for key, item in known.items() if key not in table and item.default is item.default_factory is MISSING]
    if missing:
        raise InputError(f"{where}: the key {missing[0]!r} is missing")
    values = {key: _value(hints[key], value, f"{where}: {key}", folder) for key, value in table.items()}
    try:
        return kind(**values)
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def _value(hint: Any, value: Any, where: str, folder: Path) -> Any:
    """One value, of the type that its field asks for."""
    if is_dataclass(hint):
        if not isinstance(value, dict):
            raise InputError(f"{where} must be a table of keys, not {value!r}")
        return _from_table(hint, value, where, folder)  # type: ignore[arg-type]
    if get_origin(hint) is tuple:
        if not isinstance(value, list):
            raise InputError(f"{where} must be a list, not {value!r}")
        return tuple(_value(get_args(hint)[0], one, where, folder) for one in value)
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    wanted, said = _WANTED[hint]
    # To Python, true is a whole number; to people it is not.
    if not isinstance(value, wanted) or (isinstance(value, bool) and wanted is not bool):
        raise InputError(f"{where} must be {said}, not {value!r}")
    if wanted is float and not math.isfinite(value):
        raise InputError(f"{where} must be {said}, not {value!r}")
    return folder / value if hint is Path else value


_WANTED: dict[Any, tuple[Any, str]] = {
    float: (float, "a finite number"),
    int: (int, "a whole number"),
    bool: (bool, "true or false"),
    str: (str, "text in quotes"),
    Path: (str, "a path in quotes"),
}
