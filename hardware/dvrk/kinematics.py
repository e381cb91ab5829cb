"""Where the tip of a Classic patient-side manipulator is, and which joints bring it there, as the dVRK itself computes it.

Poses are (4, 4) of the dVRK's tip frame in the frame of the remote centre (RCM): what the robot publishes as `local/measured_cp`.
That frame lies on the wrist-yaw axis; what lies beyond, the jaws, is a matter of `hardware.dvrk.calibration`. Joints `q` (6,) are
yaw, pitch [rad], insertion [m], roll, wrist pitch, wrist yaw [rad].

The arm obeys where it should refuse: it clips joints to their limits and pushes a shallow tip deeper, without a word. `check_pose`
tells beforehand what it would alter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from hardware.dvrk.instruments import Instrument
from hardware.interface import Array

JOINTS = ("yaw", "pitch", "insertion", "roll", "wrist pitch", "wrist yaw")
INSERTION = 2  # index of the one prismatic joint
ROLL = 3
RCM_TO_SHAFT = -0.4318  # [m], insertion 0 draws frame 3 back by this
SHAFT = 0.4162  # [m], from frame 3 to the wrist-pitch axis (frame 4)
KEEP_DEPTH = 0.045  # [m], of frame 4 beyond the RCM: the arm pushes any shallower Cartesian goal to here
ENTER_DEPTH = 0.043  # [m], the arm takes no Cartesian command while it stands shallower than this
NEAR_RCM = 1e-3  # [m], the arm's own inverse kinematics fails nearer to the RCM
# Denavit-Hartenberg parameters of yaw, pitch, insertion, roll, wrist pitch and wrist yaw; a is 0 but for the last, the instrument's
SIN_ALPHA = np.array([1.0, -1.0, 1.0, 0.0, -1.0, -1.0])
COS_ALPHA = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
THETA = np.array([1.0, -1.0, 0.0, 0.0, -1.0, -1.0]) * (math.pi / 2)  # [rad]
D = np.array([0.0, 0.0, RCM_TO_SHAFT, SHAFT, 0.0, 0.0])  # [m]
FOLDED = 1e-3  # sine of the angle at which the wrist-yaw axis points to the RCM, and roll is no longer determined
RIGID = 1e-6  # how far a rotation matrix may be from orthonormal
MARGIN = np.array([1e-3, 1e-3, 1e-4, 1e-3, 1e-3, 1e-3])  # [rad, m], kept from limits: our joints and the arm's differ in rounding

# R_tip of the tool files: what the dVRK calls the tip frame, seen from the last Denavit-Hartenberg frame
TIP = np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


class Reach(StrEnum):
    """What stands between the arm and a pose."""

    FINE = "fine"
    UNSOLVABLE = "unsolvable"  # no joints at all: not a pose, at the RCM, or the wrist folded towards it
    SHALLOW = "shallow"  # the arm would push the tip deeper
    LIMIT = "limit"  # the arm would clip joints


@dataclass(frozen=True)
class Solution:
    """Joints (6,) of a pose, not yet clipped: NaN when UNSOLVABLE. `reason` is one sentence, empty when FINE."""

    q: Array
    reach: Reach = Reach.FINE
    reason: str = ""


def frames(instrument: Instrument, q: Array) -> Array:
    """Poses (n + 1, 4, 4) of the base and of the first n Denavit-Hartenberg frames for joints `q` (n,), n at most 6.

    Modified convention (Craig), parameters of share/kinematic/PSM.json: reference/dvrk.md section 5. Each frame is
    RotX(alpha) TransX(a) RotZ(theta) TransZ(d) of the one before.
    """
    q = np.asarray(q, dtype=np.float64)
    count = len(q)
    theta, d = THETA[:count] + q, D[:count].copy()
    if count > INSERTION:
        theta[INSERTION], d[INSERTION] = THETA[INSERTION], D[INSERTION] + q[INSERTION]
    cos, sin, ca, sa = np.cos(theta), np.sin(theta), COS_ALPHA[:count], SIN_ALPHA[:count]
    links = np.zeros((count, 4, 4))
    links[:, 0, 0], links[:, 0, 1] = cos, -sin
    links[:, 1, 0], links[:, 1, 1], links[:, 1, 2], links[:, 1, 3] = ca * sin, ca * cos, -sa, -sa * d
    links[:, 2, 0], links[:, 2, 1], links[:, 2, 2], links[:, 2, 3] = sa * sin, sa * cos, ca, ca * d
    links[:, 3, 3] = 1.0
    if count == len(JOINTS):
        links[-1, 0, 3] = instrument.a6
    poses = np.empty((count + 1, 4, 4))
    poses[0] = np.eye(4)
    for joint in range(count):
        np.matmul(poses[joint], links[joint], out=poses[joint + 1])
    return poses


def forward(instrument: Instrument, q: Array) -> Array:
    """Pose (4, 4) of the tip at joints `q` (6,), in the RCM's frame: `local/measured_cp`.

    Raises:
        ValueError: `q` is not six numbers.
    """
    pose: Array = frames(instrument, _six(q))[-1] @ TIP
    return pose


def depth(q: Array) -> float:
    """How far [m] the wrist-pitch axis stands beyond the RCM at joints `q` (6,); negative: still in the cannula."""
    return float(q[INSERTION]) + RCM_TO_SHAFT + SHAFT


def insertion(frame4_depth: float) -> float:
    """The insertion [m] at which the wrist-pitch axis stands `frame4_depth` [m] beyond the RCM."""
    return frame4_depth - RCM_TO_SHAFT - SHAFT


def jacobian(instrument: Instrument, q: Array) -> Array:
    """(6, 6): linear [m/s], then angular [rad/s] velocity of the tip frame along the RCM frame's axes, by joint velocity."""
    poses = frames(instrument, _six(q))
    tip = poses[-1][:3, 3]
    columns = []
    for joint, pose in enumerate(poses[1:]):
        axis, origin = pose[:3, 2], pose[:3, 3]
        slides = joint == INSERTION
        columns.append(np.concatenate([axis, np.zeros(3)] if slides else [np.cross(axis, tip - origin), axis]))
    return np.stack(columns, axis=1)


def inverse(instrument: Instrument, pose: Array, near: Array) -> Solution:
    """Joints that bring the tip to `pose` (4, 4), with the roll, of all its turns, that is nearest to that of `near` (6,).

    Closed form. The wrist-yaw axis z6 and its point p6 are given. The wrist-pitch axis z5 is perpendicular to the shaft, which
    runs from the RCM through p4, and to z6; p6 - p4 lies in the plane of the two. So z5 is the normal of the plane through the RCM,
    p6 and z6, and all else follows. Of its two signs one folds the wrist backwards by more than a right angle.

    The arm does the same numerically, from its measured joints, and so chooses the same turn of the roll, whether it is within
    limits or not. Raises ValueError where `near` is not six finite numbers.
    """
    near = _six(near)
    if not np.isfinite(near).all():
        raise ValueError("near must be six finite numbers: the joints where the arm stands")
    if fault := _not_a_pose(pose):
        return _unsolvable(fault)
    last = np.asarray(pose, dtype=np.float64) @ TIP.T  # the Denavit-Hartenberg frame 6; TIP has no translation
    x6, z6, p6 = last[:3, 0], last[:3, 2], last[:3, 3]
    normal = _cross(p6, z6)
    distance, size = math.sqrt(p6 @ p6), math.sqrt(normal @ normal)
    if distance < NEAR_RCM:
        return _unsolvable(f"the pose lies {distance * 1e3:.1f} mm from the remote centre, where the arm cannot turn to it")
    if size < FOLDED * distance:
        return _unsolvable("the wrist would have to fold until its yaw axis points at the remote centre")
    candidates = [_joints(instrument, x6, z6, p6, sign * normal / size) for sign in (1.0, -1.0)]
    q = min(candidates, key=lambda one: abs(one[4]))
    if not math.isfinite(q[4]):
        return _unsolvable("the wrist-pitch axis would lie at the remote centre, where the arm cannot turn to it")
    q[ROLL] += math.tau * round((near[ROLL] - q[ROLL]) / math.tau)
    reach, reason = _judge(instrument, q, np.zeros(6))
    return Solution(q, reach, reason)


def clipped_by(instrument: Instrument, q: Array) -> Array:
    """How much (6,) [rad, m] of `q` (6,) the arm would silently cut off at its joint limits; 0 within them."""
    q = _six(q)
    cut: Array = q - np.clip(q, *instrument.limits())
    return cut


def reached(instrument: Instrument, pose: Array, near: Array) -> Solution:
    """Where the arm, standing at joints `near` (6,), would go when sent to `pose` (4, 4); FINE if it would go to exactly there."""
    near = _six(near)
    if not np.isfinite(near).all():
        return _unsolvable("the joints where the arm stands are not known")
    if (standing := depth(near)) < ENTER_DEPTH:
        return _unsolvable(
            f"the arm stands {standing * 1e3:.1f} mm beyond its remote centre; "
            f"insert the instrument to at least {KEEP_DEPTH * 1e3:.0f} mm before any Cartesian motion"
        )
    solution = inverse(instrument, pose, near)
    if solution.reach is not Reach.FINE:
        return solution
    return Solution(solution.q, *_judge(instrument, solution.q, MARGIN))


def check_pose(instrument: Instrument, pose: Array, near: Array) -> str:
    """Why the arm, standing at joints `near` (6,), would not go to exactly `pose` (4, 4): one sentence, empty if it would."""
    return reached(instrument, pose, near).reason


# ------------------------------------------------------------ pieces


def _cross(a: Array, b: Array) -> Array:
    """The cross product of two vectors (3,); NumPy's own takes ten times as long for so few numbers."""
    (ax, ay, az), (bx, by, bz) = a.tolist(), b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def _joints(instrument: Instrument, x6: Array, z6: Array, p6: Array, z5: Array) -> Array:
    """The joints (6,) for one sign of the wrist-pitch axis; NaN when the shaft would have no direction."""
    x5 = _cross(z6, z5)  # y5 is z6
    p4 = p6 - instrument.a6 * x5
    reach = math.sqrt(p4 @ p4)
    if reach < NEAR_RCM:
        return np.array([math.nan, math.nan, math.nan, math.nan, math.inf, math.nan])
    z4 = p4 / reach  # (sin yaw cos pitch, -sin pitch, -cos yaw cos pitch)
    yaw, pitch = math.atan2(z4[0], -z4[2]), math.atan2(-z4[1], math.hypot(z4[0], z4[2]))
    # Axes of frame 3, which has no roll yet, from yaw and pitch alone
    y3 = np.array([-math.cos(yaw), 0.0, -math.sin(yaw)])
    x3 = _cross(y3, z4)
    roll = math.atan2(-z5 @ x3, z5 @ y3)  # z5 is y4
    x4 = _cross(z5, z4)
    wrist_pitch = math.atan2(x5 @ x4, x5 @ z4)
    wrist_yaw = math.atan2(x6 @ x5, x6 @ z5)
    return np.array([yaw, pitch, insertion(reach), roll, wrist_pitch, wrist_yaw])


def _judge(instrument: Instrument, q: Array, margin: Array) -> tuple[Reach, str]:
    """What the arm would alter about `q` (6,), if `margin` (6,) must be kept."""
    if (beyond := depth(q)) < KEEP_DEPTH + margin[INSERTION]:
        return Reach.SHALLOW, (
            f"the wrist would be {beyond * 1e3:.1f} mm beyond the remote centre and the arm would push it deeper; "
            f"it must be at least {(KEEP_DEPTH + margin[INSERTION]) * 1e3:.1f} mm"
        )
    lower, upper = instrument.limits()
    outside = np.flatnonzero((q < lower + margin) | (q > upper - margin))
    if outside.size:
        return Reach.LIMIT, "the arm would clip " + ", ".join(_beyond(joint, q, lower, upper) for joint in outside.tolist())
    return Reach.FINE, ""


def _beyond(joint: int, q: Array, lower: Array, upper: Array) -> str:
    """Say that one joint would be outside or at its limits."""
    scale, unit = (1e3, "mm") if joint == INSERTION else (180.0 / math.pi, "deg")
    low, high, value = lower[joint] * scale, upper[joint] * scale, q[joint] * scale
    said = f"{JOINTS[joint]} at {value:.1f} {unit} to its limits {low:.1f} to {high:.1f}"
    turned = q[joint] - math.copysign(math.tau, q[joint])
    if joint == ROLL and lower[joint] <= turned <= upper[joint]:
        said += " (the instrument is wound up: turn it back by a full turn first)"
    return said


def _not_a_pose(pose: Array) -> str:
    """Why `pose` is no rigid pose, or nothing."""
    pose = np.asarray(pose, dtype=np.float64)
    if pose.shape != (4, 4):
        return f"a pose must be a (4, 4) matrix, not {pose.shape}"
    if not np.isfinite(pose).all():
        return "the pose holds a number that is not finite"
    rotation = pose[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > RIGID or np.linalg.det(rotation) < 0 or (pose[3] != (0, 0, 0, 1)).any():
        return "the pose is not a rigid one: its rotation must be orthonormal with determinant 1, its last row 0, 0, 0, 1"
    return ""


def _unsolvable(reason: str) -> Solution:
    return Solution(np.full(6, math.nan), Reach.UNSOLVABLE, reason)


def _six(q: Array) -> Array:
    q = np.asarray(q, dtype=np.float64)
    if q.shape != (6,):
        raise ValueError(f"there must be six joints, not shape {q.shape}: without an instrument the arm reports seven actuators")
    return q
