"""Where an arm's base is in the left camera, and where the tip of an instrument is on the arm: the one place where frames change.

Outside the driver every pose is a tool pose in the left camera frame (`hardware.interface`); the robot speaks of its own tip frame
in its own base frame (the remote centre). Between them stand two fixed changes of frame:

    camera_from_tool = camera_from_base @ base_from_tip @ tip_from_tool

`camera_from_base` is the hand-eye calibration, from a file of dvrk_camera_registration (at 0e5b0ca). It holds only while camera
and base stand still, and only if the robot itself has no base frame set, or it would be applied twice.

`tip_from_tool` follows from the tool files. R_tip turns the last Denavit-Hartenberg frame so that the tip's x is the wrist-yaw axis
reversed (-z6), y is -x6, and z is y6, straight out of the closed jaws. Both jaws turn about that same axis, so they part along y. Our
tool frame wants z out of the tip and x along the opening: a quarter turn about z, which takes tool x to tip y. The dVRK's tip frame
lies on the axis, its z passes between the jaws, and the dVRK knows no jaw length: our origin lies `jaw_length` further along z.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from hardware.codes import InputError
from hardware.dvrk.config import ArmConfig
from hardware.interface import Array, Pose

# dVRK camera axes are x left, y up; OpenCV's x right, y down; both look along z. Its own inverse.
DVRK_AXES = np.diag([-1.0, -1.0, 1.0, 1.0])
ROUNDING = 1e-3  # how far from orthonormal a rotation may be that somebody copied by hand, with a few digits
NEAREST, FARTHEST = (
    0.01,
    0.5,
)  # [m], from the camera to a remote centre; nearer is a placeholder, further another unit or another frame


@dataclass(frozen=True)
class HandEye:
    """One arm's calibration: `camera_from_base` (4, 4), OpenCV axes [m]; `written`: file time [s since 1970]."""

    camera_from_base: Array
    reference_frame: str  # the camera's frame as the file names it; empty where it names none
    written: float

    def age(self, now: float) -> float:
        """How old [s] the calibration is at `now` [s since 1970]; below 0, a clock is wrong."""
        return now - self.written


@dataclass(frozen=True)
class ArmFrames:
    """The two fixed changes of frame of one arm, (4, 4) each."""

    camera_from_base: Array
    tip_from_tool: Array


def load_hand_eye(path: Path, arm: str, axes: str = "", endoscope: Array | None = None, asked: str = "") -> HandEye:
    """Read what dvrk_camera_registration wrote about `arm` ("PSM1").

    It writes three kinds of file. `PSM1-registration-open-cv.json` has the key base-frame and OpenCV's axes.
    `PSM1-registration-dVRK.json` has the same key without braces around it, and the dVRK's axes. With an endoscope arm, the latter
    is an entry of suj-fixed.json instead (name, measured_cp), seen from the base of that arm: then `endoscope` (4, 4), that
    arm's `local/measured_cp` at registration, is needed. Keys may have hyphens or underscores.

    Args:
        path: the file.
        arm: CRTK name of the arm that it must be about.
        axes: "open-cv" or "dvrk"; empty: as the file's name or kind says.
        endoscope: pose of the endoscope's tip in its own base, for an entry of suj-fixed.json alone.
        asked: the topic that was to tell that pose; empty where none is configured.

    Raises:
        InputError: it cannot be read, is about another arm, does not say its axes, or holds no plausible pose.
    """
    try:
        text, written = path.read_text(encoding="utf-8"), path.stat().st_mtime
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"the hand-eye file {path.name} of {arm} cannot be read: {error}") from error
    where = f"the hand-eye file {path.name} of {arm}"
    others = set(re.findall(r"PSM\d", path.name.upper())) - {arm.upper()}
    if others and re.fullmatch(r"PSM\d", arm.upper()):
        raise InputError(f"{where} bears the name of {others.pop()}; give each arm its own file")
    content, fragment = _parse(text, where)
    if "measured_cp" in content:
        matrix, frame = _from_setup_joints(content, arm, endoscope, asked, where), ""
    else:
        matrix, frame = _from_base_frame(content, where)
        if _axes(path, fragment, axes, where) == "dvrk":
            matrix = DVRK_AXES @ matrix
    distance = float(np.linalg.norm(matrix[:3, 3]))
    if not NEAREST <= distance <= FARTHEST:
        raise InputError(
            f"{where} puts the remote centre {distance:.3f} m from the camera; it must be from {NEAREST} to {FARTHEST} m (metres, "
            "and a calibration, not a placeholder)"
        )
    return HandEye(matrix, frame, written)


def arm_frames(hand_eye: HandEye, arm: ArmConfig) -> ArmFrames:
    """The changes of frame of `arm` with its instrument."""
    tip_from_tool = np.eye(4)
    tip_from_tool[:3, :3] = cv2.Rodrigues(np.array(arm.tip_rotation, dtype=np.float64))[0]
    tip_from_tool[2, 3] = arm.jaw_length
    return ArmFrames(hand_eye.camera_from_base, tip_from_tool)


def to_camera(frames: ArmFrames, tip: Pose) -> Pose:
    """The tool pose in the left camera frame, from the robot's `tip` pose in its base frame."""
    return as_pose(frames.camera_from_base @ as_matrix(tip) @ frames.tip_from_tool)


def to_base(frames: ArmFrames, tool: Pose) -> Pose:
    """The robot's tip pose in its base frame, from the `tool` pose in the left camera frame."""
    return as_pose(_inverse(frames.camera_from_base) @ as_matrix(tool) @ _inverse(frames.tip_from_tool))


def vector_to_camera(frames: ArmFrames, vector: Array) -> Array:
    """A direction, force or velocity (3,) of the base frame, along the left camera's axes."""
    turned: Array = frames.camera_from_base[:3, :3] @ vector
    return turned


def vector_to_base(frames: ArmFrames, vector: Array) -> Array:
    """A direction, force or velocity (3,) of the left camera frame, along the base's axes."""
    turned: Array = frames.camera_from_base[:3, :3].T @ vector
    return turned


def force_to_camera(frames: ArmFrames, tip: Pose, force: Array) -> Array:
    """A force (3,) [N] told along the tip's own axes (`body/measured_cf`), along the left camera's; `tip` in the base frame."""
    return vector_to_camera(frames, tip.rotation() @ force)


def as_matrix(pose: Pose) -> Array:
    """The (4, 4) matrix of a pose."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = pose.rotation(), pose.position
    return matrix


def as_pose(matrix: Array) -> Pose:
    """The pose of a rigid (4, 4) matrix."""
    return Pose.from_matrix(matrix[:3, :3], matrix[:3, 3])


# ------------------------------------------------------------ reading


def _parse(text: str, where: str) -> tuple[dict[str, Any], bool]:
    """The file's object with its keys in one style, and whether it came without braces."""
    fragment = not text.lstrip().startswith("{")
    try:
        content = json.loads("{" + text.strip().rstrip(",") + "}" if fragment else text)
    except ValueError as error:
        raise InputError(f"{where} is not what dvrk_camera_registration writes: {error}") from error
    return _snake(content), fragment


def _snake(content: dict[str, Any]) -> dict[str, Any]:
    """Write keys as dVRK 2.4 does, with underscores; earlier ones have hyphens."""
    return {key.replace("-", "_"): value for key, value in content.items()}


def _axes(path: Path, fragment: bool, told: str, where: str) -> str:
    """Which camera axes the file has. A wrong guess would mirror every motion, so nothing is guessed."""
    name = path.name.lower()
    by_name = {axes for axes, sign in (("open-cv", "open-cv"), ("open-cv", "opencv"), ("dvrk", "dvrk")) if sign in name}
    found = by_name | ({told} if told else set()) | ({"dvrk"} if fragment else set())
    if len(found) == 1:
        return found.pop()
    if found:
        raise InputError(
            f"{where} says of its axes both open-cv and dvrk, by its name, its kind or calibration_axes; rename the file or correct the key"
        )
    raise InputError(f"{where} does not say which axes it has; name it -open-cv or -dVRK, or set calibration_axes")


def _from_base_frame(content: dict[str, Any], where: str) -> tuple[Array, str]:
    inner = content.get("base_frame")
    if not isinstance(inner, dict):
        raise InputError(f"{where} holds {', '.join(content) or 'nothing'}; it must hold base-frame, or name and measured_cp")
    inner = _snake(inner)
    frame = inner.get("reference_frame", "")
    if not isinstance(frame, str):
        raise InputError(f"{where} has the reference-frame {frame!r}; it must be the camera's name")
    return _rigid(inner.get("transform"), f"the transform of {where}"), frame


def _from_setup_joints(content: dict[str, Any], arm: str, endoscope: Array | None, asked: str, where: str) -> Array:
    if content.get("name") != arm:
        raise InputError(f"{where} is about {content.get('name')!r}; it must be about {arm}")
    if endoscope is None and asked:
        raise InputError(
            f"{where} is an entry of suj-fixed.json, seen from the endoscope arm's base, and {asked} has told no valid pose; "
            "power and home that arm"
        )
    if endoscope is None:
        raise InputError(
            f"{where} is an entry of suj-fixed.json, seen from the endoscope arm's base; set endoscope_arm in [console], "
            "or use the -open-cv file"
        )
    base = _rigid(content["measured_cp"], f"measured_cp in {where}")
    tip = _rigid(endoscope, "the pose of the endoscope arm")
    camera: Array = DVRK_AXES @ _inverse(tip) @ base
    return camera


def _rigid(value: Any, what: str) -> Array:
    """A (4, 4) rigid transformation, its rotation rid of rounding."""
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.full(1, np.nan)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise InputError(f"{what} must be four rows of four finite numbers")
    if not np.array_equal(matrix[3], (0.0, 0.0, 0.0, 1.0)):
        raise InputError(f"{what} has the last row {matrix[3].tolist()}; it must be 0, 0, 0, 1")
    rotation = matrix[:3, :3]
    error = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if error > ROUNDING or np.linalg.det(rotation) < 0:
        raise InputError(
            f"{what} is no rotation: its rows must be orthonormal to {ROUNDING:g} (they are to {error:.2g}) with determinant +1 "
            f"(it is {np.linalg.det(rotation):.3f})"
        )
    u, _, vt = np.linalg.svd(rotation)
    matrix[:3, :3] = u @ vt
    return matrix


def _inverse(matrix: Array) -> Array:
    """The inverse of a rigid (4, 4)."""
    inverse = np.eye(4)
    inverse[:3, :3] = matrix[:3, :3].T
    inverse[:3, 3] = -matrix[:3, :3].T @ matrix[:3, 3]
    return inverse
