"""Pure geometry of the safety gate: workspace, step length and speed, distance between the tools.

Each check returns a `Refusal` or None. Positions are (3,) [m] in the left camera frame.
"""

from __future__ import annotations

import numpy as np

from hardware.codes import Code
from hardware.interface import Array, Pose
from hardware.limits import Limits
from hardware.verdicts import Refusal

ROUNDING = 1e-6  # [m] and [rad]; so that a step of exactly the limit passes
SPEED_ROUNDING = 1.01  # tick periods are not exact multiples of the physics step
UNIT = 1e-3  # how far a quaternion's length may lie from 1


def finite_pose(pose: Pose) -> Refusal | None:
    """Refuse a pose of the wrong shape, with a number that is not finite, or whose quaternion is not of unit length."""
    if np.shape(pose.position) != (3,) or np.shape(pose.quaternion) != (4,) or not pose.is_finite():
        return Refusal(Code.NOT_FINITE, "the commanded pose holds a number that is missing or not finite")
    length = float(np.linalg.norm(pose.quaternion))
    if abs(length - 1.0) > UNIT:
        return Refusal(
            Code.NOT_FINITE, f"the commanded orientation is no rotation: its quaternion has length {length:.3f} instead of 1"
        )
    return None


def inside_workspace(position: Array, limits: Limits) -> Refusal | None:
    """Refuse a tip position outside the workspace box."""
    for axis, value, low, high in zip("xyz", position, limits.workspace_lower, limits.workspace_upper, strict=True):
        if not low <= value <= high:
            return Refusal(
                Code.WORKSPACE,
                f"{axis} = {value * 1e3:.1f} mm lies outside the workspace of {low * 1e3:.0f} to {high * 1e3:.0f} mm",
            )
    return None


def step_length(target: Pose, setpoint: Pose, previous: Pose | None, limits: Limits) -> Refusal | None:
    """Refuse a servo step that is too long.

    The step counts from the previous servo command of this motion, or from the setpoint where there is none. The setpoint may lag
    behind by the arm's latency; were it not looked at, commands to an arm that does not follow would run away from it.
    """
    step = float(np.linalg.norm(target.position - (previous or setpoint).position))
    if step > limits.max_step + ROUNDING:
        return Refusal(Code.STEP_TOO_LONG, f"a step of {step * 1e3:.2f} mm exceeds the limit of {limits.max_step * 1e3:.2f} mm")
    lead = float(np.linalg.norm(target.position - setpoint.position))
    allowed = limits.max_step + limits.step_tolerance
    if lead > allowed + ROUNDING:
        return Refusal(
            Code.STEP_TOO_LONG,
            f"the target lies {lead * 1e3:.2f} mm from where the arm is told to be; {allowed * 1e3:.2f} mm is allowed",
        )
    turn = target.angle_to(setpoint)
    if turn > limits.max_turn + ROUNDING:
        return Refusal(
            Code.STEP_TOO_LONG,
            f"a turn of {np.degrees(turn):.1f} degrees exceeds the limit of {np.degrees(limits.max_turn):.1f} degrees a step",
        )
    return None


def step_speed(step: float, elapsed: float, limit: float) -> Refusal | None:
    """Refuse a servo step of `step` [m] that comes `elapsed` [s] after the last one at more than `limit` [m/s]."""
    if step <= ROUNDING or step <= limit * SPEED_ROUNDING * elapsed:
        return None
    speed = f"{step / elapsed * 1e3:.1f} mm/s" if elapsed > 0 else f"{step * 1e3:.2f} mm at one instant"
    return Refusal(Code.TOO_FAST, f"{speed} exceeds the limit of {limit * 1e3:.1f} mm/s")


def tools_apart(start: Array, target: Array, other: tuple[Array, Array], limits: Limits) -> Refusal | None:
    """Refuse a straight motion that brings the tips nearer than allowed; `other` is the line that the other tip sweeps.

    Tips that are already too near may move apart: only coming nearer than they are now is refused.
    """
    distance = segment_distance(start, target, *other)
    if distance >= limits.min_tool_distance:
        return None
    now = segment_distance(start, start, *other)
    final = segment_distance(target, target, *other)
    if distance >= now - ROUNDING and final > now + ROUNDING:
        return None
    need = limits.min_tool_distance * 1e3
    return Refusal(
        Code.TOOLS_TOO_CLOSE, f"the tool tips would come within {distance * 1e3:.1f} mm of each other; {need:.1f} mm must remain"
    )


def segment_distance(a: Array, b: Array, c: Array, d: Array) -> float:
    """Smallest distance [m] between the segments a-b and c-d, each end (3,) [m].

    Source: Ericson, Real-Time Collision Detection, section 5.1.9.
    """
    u, v, w = b - a, d - c, a - c
    uu, vv, uv, uw, vw = float(u @ u), float(v @ v), float(u @ v), float(u @ w), float(v @ w)
    tiny = 1e-18
    if uu <= tiny:
        s, t = 0.0, _clamp(vw / vv) if vv > tiny else 0.0
    elif vv <= tiny:
        s, t = _clamp(-uw / uu), 0.0
    else:
        denominator = uu * vv - uv * uv
        s = _clamp((uv * vw - uw * vv) / denominator) if denominator > tiny * uu * vv else 0.0
        t = (uv * s + vw) / vv
        if not 0.0 <= t <= 1.0:
            t = _clamp(t)
            s = _clamp((uv * t - uw) / uu)
    return float(np.linalg.norm(w + s * u - t * v))


def _clamp(value: float) -> float:
    return min(max(value, 0.0), 1.0)
