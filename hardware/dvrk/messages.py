"""CRTK's messages as plain data, the same for every transport: stamps in seconds, arrays as float64, quaternions (x, y, z, w).

A `stamp` of 0 means that the robot itself calls the data invalid (dVRK 2.4). `ROS` is the name of the message's type.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Generic, TypeVar

import numpy as np

from hardware.interface import Array
from hardware.interface import Image as Pixels


def _nothing() -> Array:
    return np.zeros(0)


@dataclass(frozen=True)
class Message:
    """Anything that goes over a topic."""

    ROS: ClassVar[str] = ""


@dataclass(frozen=True)
class Empty(Message):
    """A mere event, such as `hold`."""

    ROS: ClassVar[str] = "std_msgs/Empty"


@dataclass(frozen=True)
class Bool(Message):
    """Yes or no."""

    ROS: ClassVar[str] = "std_msgs/Bool"
    data: bool


@dataclass(frozen=True)
class Float64(Message):
    """One number."""

    ROS: ClassVar[str] = "std_msgs/Float64"
    data: float


@dataclass(frozen=True)
class String(Message):
    """A text, without a stamp: latched, it may be old."""

    ROS: ClassVar[str] = "std_msgs/String"
    data: str


@dataclass(frozen=True)
class Matrix(Message):
    """A (rows, columns) matrix, such as a jacobian."""

    ROS: ClassVar[str] = "std_msgs/Float64MultiArray"
    data: Array


@dataclass(frozen=True)
class Joy(Message):
    """A pedal or a button: `buttons[0]` is 0 released, 1 pressed, 2 tapped."""

    ROS: ClassVar[str] = "sensor_msgs/Joy"
    stamp: float
    buttons: tuple[int, ...]


@dataclass(frozen=True)
class JointState(Message):
    """Joint positions [rad, m], velocities and efforts [Nm, N], those that are known."""

    ROS: ClassVar[str] = "sensor_msgs/JointState"
    stamp: float
    name: tuple[str, ...]
    position: Array
    velocity: Array = field(default_factory=_nothing)
    effort: Array = field(default_factory=_nothing)


@dataclass(frozen=True)
class PoseStamped(Message):
    """`position` (3,) [m] and unit `quaternion` (4,) in the frame `frame_id`."""

    ROS: ClassVar[str] = "geometry_msgs/PoseStamped"
    stamp: float
    frame_id: str
    position: Array
    quaternion: Array


@dataclass(frozen=True)
class TwistStamped(Message):
    """`linear` (3,) [m/s] and `angular` (3,) [rad/s]."""

    ROS: ClassVar[str] = "geometry_msgs/TwistStamped"
    stamp: float
    frame_id: str
    linear: Array
    angular: Array


@dataclass(frozen=True)
class WrenchStamped(Message):
    """`force` (3,) [N] and `torque` (3,) [Nm]."""

    ROS: ClassVar[str] = "geometry_msgs/WrenchStamped"
    stamp: float
    frame_id: str
    force: Array
    torque: Array


@dataclass(frozen=True)
class OperatingState(Message):
    """One arm's state: DISABLED, ENABLED, PAUSED, FAULT or UNDEFINED. Latched and sent on events alone."""

    ROS: ClassVar[str] = "crtk_msgs/OperatingState"
    stamp: float
    state: str
    is_homed: bool
    is_busy: bool


@dataclass(frozen=True)
class StringStamped(Message):
    """A stamped text, such as a state command."""

    ROS: ClassVar[str] = "crtk_msgs/StringStamped"
    stamp: float
    string: str


@dataclass(frozen=True)
class Picture(Message):
    """One eye's `image` (H, W, 3) uint8 RGB."""

    ROS: ClassVar[str] = "sensor_msgs/Image"
    stamp: float
    frame_id: str
    image: Pixels


@dataclass(frozen=True)
class CameraInfo(Message):
    """One eye's calibration: intrinsics `K` (3, 3), distortion `D`, rectification `R` (3, 3) and projection `P` (3, 4)."""

    ROS: ClassVar[str] = "sensor_msgs/CameraInfo"
    stamp: float
    frame_id: str
    width: int
    height: int
    distortion_model: str
    D: Array
    K: Array
    R: Array
    P: Array


# ------------------------------------------------------------ services

Q = TypeVar("Q")
A = TypeVar("A")


@dataclass(frozen=True)
class Service(Generic[Q, A]):
    """A service's type: its ROS name, and what is asked and answered."""

    ros: str
    question: type[Q]
    answer: type[A]


@dataclass(frozen=True)
class Ask:
    """A question without content."""


@dataclass(frozen=True)
class Pose:
    """`position` (3,) [m] and unit `quaternion` (4,)."""

    position: Array
    quaternion: Array


@dataclass(frozen=True)
class AskPose:
    """Where the tip would be at joint positions `jp` (n,)."""

    jp: Array


@dataclass(frozen=True)
class AnswerPose:
    """The pose, and whether it could be computed."""

    cp: Pose
    result: bool
    message: str


@dataclass(frozen=True)
class AskJoints:
    """Which joint positions reach `cp`, sought from `jp` (6,)."""

    cp: Pose
    jp: Array


@dataclass(frozen=True)
class AnswerJoints:
    """The joint positions (6,), and whether they were found."""

    jp: Array
    result: bool
    message: str


@dataclass(frozen=True)
class AnswerState:
    """The operating state now."""

    operating_state: OperatingState


@dataclass(frozen=True)
class AnswerTrigger:
    """Whether it was done."""

    success: bool
    message: str


FORWARD_KINEMATICS = Service("crtk_msgs/QueryForwardKinematics", AskPose, AnswerPose)
INVERSE_KINEMATICS = Service("crtk_msgs/QueryInverseKinematics", AskJoints, AnswerJoints)
TRIGGER_STATE = Service("crtk_msgs/TriggerOperatingState", Ask, AnswerState)
TRIGGER = Service("std_srvs/Trigger", Ask, AnswerTrigger)
