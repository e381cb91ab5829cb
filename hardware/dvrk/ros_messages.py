"""Our plain messages to and from the objects of ROS, the same for both versions of it.

The versions differ in how a stamp is spelt (`secs`, `nsecs`; `sec`, `nanosec`), in the letters of a camera's matrices, and in how
strictly an attribute's type is checked; all of it is decided here, by what the object has. Nothing is judged: a NaN or a quaternion
that is not of unit length goes through as it came, so that the driver can refuse it.
"""

from __future__ import annotations

import logging
import math
import threading
from array import array
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from typing import Any, TypeVar

import numpy as np

from hardware.dvrk import messages as ours
from hardware.dvrk.transport import Clock
from hardware.interface import Array

T = TypeVar("T")
M = TypeVar("M", bound=ours.Message)

log = logging.getLogger(__name__)

# How many bytes a pixel has, and where its red, green and blue are.
_RGB, _BGR = slice(0, 3), slice(2, None, -1)
ENCODINGS: Mapping[str, tuple[int, slice | list[int]]] = {
    "rgb8": (3, _RGB),
    "bgr8": (3, _BGR),
    "rgba8": (4, _RGB),
    "bgra8": (4, _BGR),
    "8UC3": (3, _BGR),  # OpenCV's order, as image_proc means it
    "mono8": (1, [0, 0, 0]),
}


def from_ros(kind: type[T], ros: Any) -> T:
    """Our message (or half of a service) of class `kind` with the content of the ROS object `ros`.

    Raises:
        ValueError: its content cannot be understood, such as an unknown image encoding.
    """
    return kind(**{field: part.read(part.at(ros)) for field, part in _LAYOUT[kind].items()})


def to_ros(message: object, ros: Any) -> Any:
    """Fill the empty ROS object `ros` with our `message`, and return it.

    Raises:
        ValueError: a field has a shape or a value that ROS cannot carry.
    """
    for field, part in _LAYOUT[type(message)].items():
        part.write(part.parent(ros), part.name, getattr(message, field))
    return ros


def receiver(topic: str, kind: type[M], callback: Callable[[M, float], None], clock: Clock) -> Callable[[Any], None]:
    """What a subscription is to call with every ROS object: `callback` gets our message and when it came, one after the other.

    What cannot be understood is dropped; the log says so once.
    """
    turn = threading.Lock()  # in ROS 1 two publishers are two threads
    puzzled = False

    def receive(ros: Any) -> None:
        nonlocal puzzled
        received = clock()
        try:
            message = from_ros(kind, ros)
        except ValueError as error:
            if not puzzled:
                log.warning("what comes over %s is dropped: %s", topic, error)
            puzzled = True
            return
        with turn:
            callback(message, received)

    return receive


@dataclass(frozen=True)
class _Part:
    """One field of ours and where it is in the ROS object: how to read it, and how to write it into its parent."""

    path: str
    read: Callable[[Any], Any]
    write: Callable[[Any, str, Any], None]

    @cached_property
    def name(self) -> str:
        return self.path.rpartition(".")[2]

    @cached_property
    def at(self) -> Callable[[Any], Any]:
        return _getter(self.path)

    @cached_property
    def parent(self) -> Callable[[Any], Any]:
        return _getter(self.path.rpartition(".")[0])


def _getter(path: str) -> Callable[[Any], Any]:
    return attrgetter(path) if path else lambda ros: ros


# ------------------------------------------------------------ stamps, numbers, texts


def _read_stamp(stamp: Any) -> float:
    if hasattr(stamp, "secs"):
        return float(stamp.secs + 1e-9 * stamp.nsecs)
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def _write_stamp(header: Any, name: str, value: float) -> None:
    if not (math.isfinite(value) and value >= 0.0):
        raise ValueError(f"the stamp of a message is {value}, and must be 0 (invalid) or a time in seconds")
    seconds, nanoseconds = divmod(round(value * 1e9), 10**9)
    stamp = getattr(header, name)
    if hasattr(stamp, "secs"):
        stamp.secs, stamp.nsecs = seconds, nanoseconds
    else:
        stamp.sec, stamp.nanosec = seconds, nanoseconds


def _read_vector(vector: Any) -> Array:
    return np.array((vector.x, vector.y, vector.z))


def _read_quaternion(quaternion: Any) -> Array:
    return np.array((quaternion.x, quaternion.y, quaternion.z, quaternion.w))


def _write_letters(letters: str) -> Callable[[Any, str, Any], None]:
    def write(parent: Any, name: str, value: Any) -> None:
        numbers = _numbers(value)
        if len(numbers) != len(letters):
            raise ValueError(f"{name} has {len(numbers)} numbers, and must have {len(letters)}")
        target = getattr(parent, name)
        for letter, number in zip(letters, numbers, strict=True):
            setattr(target, letter, number)

    return write


def _numbers(value: Any) -> list[float]:
    return [float(number) for number in np.asarray(value, np.float64).ravel()]


def _read_array(value: Sequence[float]) -> Array:
    return np.array(value, np.float64)


def _write_as(kind: Callable[[Any], Any]) -> Callable[[Any, str, Any], None]:
    return lambda parent, name, value: setattr(parent, name, kind(value))


def _scalar(name: str, kind: Callable[[Any], Any]) -> _Part:
    return _Part(name, kind, _write_as(kind))


# ------------------------------------------------------------ pictures, calibrations, matrices


def _read_picture(ros: Any) -> Any:
    if ros.encoding not in ENCODINGS:
        known = ", ".join(ENCODINGS)
        raise ValueError(
            f"the image of {ros.header.frame_id or 'a camera'} is encoded as {ros.encoding!r}; publish one of {known}"
        )
    size, order = ENCODINGS[ros.encoding]
    bytes_ = np.frombuffer(ros.data, np.uint8)
    if ros.step < ros.width * size or bytes_.size < ros.height * ros.step:
        raise ValueError(
            f"an image of {ros.width} x {ros.height} pixels in {ros.encoding} came with {bytes_.size} bytes, too few"
        )
    rows = bytes_[: ros.height * ros.step].reshape(ros.height, ros.step)
    pixels = rows[:, : ros.width * size].reshape(ros.height, ros.width, size)
    return np.array(pixels[:, :, order], order="C")  # a copy: what ROS received cannot be written


def _write_picture(ros: Any, _: str, image: Any) -> None:
    if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
        raise ValueError(f"a picture has shape {image.shape} and type {image.dtype}, and must be (H, W, 3) uint8")
    ros.height, ros.width = (int(side) for side in image.shape[:2])
    ros.encoding, ros.step = "rgb8", 3 * ros.width
    content = image.tobytes()
    # ROS 2 looks at each byte of anything but an array, which takes longer than the picture lasts.
    ros.data = content if hasattr(ros.header.stamp, "secs") else array("B", content)


def _read_matrix(ros: Any) -> Array:
    values = np.array(ros.data, np.float64)
    sides = ros.layout.dim
    if not sides:
        return values.reshape(1, -1)
    if len(sides) != 2 or sides[0].size * sides[1].size != values.size:
        raise ValueError(
            f"a matrix came with {values.size} numbers for sides {[side.size for side in sides]}; two sides are expected"
        )
    rows, columns = sides[0].size, sides[1].size
    by_columns = (sides[0].stride, sides[1].stride) == (1, rows)  # how the dVRK lays it out, other than ROS describes strides
    return values.reshape((rows, columns), order="F" if by_columns else "C")


def _write_matrix(ros: Any, _: str, value: Any) -> None:
    from std_msgs.msg import MultiArrayDimension  # of whichever version is installed

    rows, columns = value.shape
    ros.layout.dim = [MultiArrayDimension(), MultiArrayDimension()]
    for side, (label, size, stride) in zip(ros.layout.dim, (("rows", rows, 1), ("cols", columns, rows)), strict=True):
        side.label, side.size, side.stride = label, size, stride
    ros.data = [float(number) for number in value.ravel(order="F")]


def _calibration(letter: str, *shape: int) -> _Part:
    """A camera's matrix: a capital letter in ROS 1, a small one in ROS 2."""

    def of(ros: Any) -> str:
        return letter if hasattr(ros, letter) else letter.lower()

    return _Part(
        "",
        lambda ros: np.array(getattr(ros, of(ros)), np.float64).reshape(shape),
        lambda ros, _, value: setattr(ros, of(ros), _numbers(value)),
    )


# ------------------------------------------------------------ where each field is


def _texts(path: str) -> _Part:
    return _Part(path, lambda names: tuple(str(name) for name in names), _write_as(list))


def _vector(path: str) -> _Part:
    return _Part(path, _read_vector, _write_letters("xyz"))


def _quaternion(path: str) -> _Part:
    return _Part(path, _read_quaternion, _write_letters("xyzw"))


def _array(path: str) -> _Part:
    return _Part(path, _read_array, _write_as(_numbers))


def _nested(path: str, kind: type) -> _Part:
    return _Part(path, lambda ros: from_ros(kind, ros), lambda parent, name, value: to_ros(value, getattr(parent, name)))


_STAMP = _Part("header.stamp", _read_stamp, _write_stamp)
_FRAME = _scalar("header.frame_id", str)
_PLACED = {"stamp": _STAMP, "frame_id": _FRAME}

_LAYOUT: Mapping[type, Mapping[str, _Part]] = {
    ours.Empty: {},
    ours.Bool: {"data": _scalar("data", bool)},
    ours.Float64: {"data": _scalar("data", float)},
    ours.String: {"data": _scalar("data", str)},
    ours.Matrix: {"data": _Part("", _read_matrix, _write_matrix)},
    ours.Joy: {
        "stamp": _STAMP,
        "buttons": _Part("buttons", lambda pressed: tuple(int(button) for button in pressed), _write_as(list)),
    },
    ours.JointState: {
        "stamp": _STAMP,
        "name": _texts("name"),
        "position": _array("position"),
        "velocity": _array("velocity"),
        "effort": _array("effort"),
    },
    ours.PoseStamped: {**_PLACED, "position": _vector("pose.position"), "quaternion": _quaternion("pose.orientation")},
    ours.TwistStamped: {**_PLACED, "linear": _vector("twist.linear"), "angular": _vector("twist.angular")},
    ours.WrenchStamped: {**_PLACED, "force": _vector("wrench.force"), "torque": _vector("wrench.torque")},
    ours.OperatingState: {
        "stamp": _STAMP,
        "state": _scalar("state", str),
        "is_homed": _scalar("is_homed", bool),
        "is_busy": _scalar("is_busy", bool),
    },
    ours.StringStamped: {"stamp": _STAMP, "string": _scalar("string", str)},
    ours.Picture: {**_PLACED, "image": _Part("", _read_picture, _write_picture)},
    ours.CameraInfo: {
        **_PLACED,
        "width": _scalar("width", int),
        "height": _scalar("height", int),
        "distortion_model": _scalar("distortion_model", str),
        "D": _calibration("D", -1),
        "K": _calibration("K", 3, 3),
        "R": _calibration("R", 3, 3),
        "P": _calibration("P", 3, 4),
    },
    ours.Ask: {},
    ours.Pose: {"position": _vector("position"), "quaternion": _quaternion("orientation")},
    ours.AskPose: {"jp": _array("jp")},
    ours.AnswerPose: {"cp": _nested("cp", ours.Pose), "result": _scalar("result", bool), "message": _scalar("message", str)},
    ours.AskJoints: {"cp": _nested("cp", ours.Pose), "jp": _array("jp")},
    ours.AnswerJoints: {"jp": _array("jp"), "result": _scalar("result", bool), "message": _scalar("message", str)},
    ours.AnswerState: {"operating_state": _nested("operating_state", ours.OperatingState)},
    ours.AnswerTrigger: {"success": _scalar("success", bool), "message": _scalar("message", str)},
}
