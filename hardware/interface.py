"""What can be touched, as protocols: arms, endoscope, bench; and the small data types that cross this border.

Every pose is in the left camera frame (x right, y down, z forward), SI units throughout. The vocabulary of `Arm` is
CRTK's. The tool frame of both instruments: origin at the tool tip (for scissors: where the closed blade tips meet), z along the
shaft out of the tip (the approach direction), x the direction along which the jaws open.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from hardware.codes import Code
from hardware.verdicts import Verdict

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

GRASPER = "PSM1"
CUTTER = "PSM2"

T = TypeVar("T")


@dataclass(frozen=True)
class Stamped(Generic[T]):
    """A value with the bench time [s] at which it was measured."""

    value: T
    stamp: float


@dataclass(frozen=True)
class Pose:
    """A rigid pose: `position` (3,) [m], `quaternion` (4,) unit, order (x, y, z, w)."""

    position: Array
    quaternion: Array

    @staticmethod
    def from_matrix(rotation: Array, position: Array) -> Pose:
        """Build from a (3, 3) rotation matrix and a (3,) position [m]."""
        m = np.asarray(rotation, dtype=np.float64)
        # Shepperd's method: the largest of the four candidates keeps the division well conditioned.
        candidates = np.array([m[0, 0], m[1, 1], m[2, 2], np.trace(m)])
        i = int(np.argmax(candidates))
        q = np.empty(4)
        if i == 3:
            q[:] = (m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], 1.0 + candidates[3])
        else:
            j, k = (i + 1) % 3, (i + 2) % 3
            q[i] = 1.0 - candidates[3] + 2.0 * m[i, i]
            q[j] = m[j, i] + m[i, j]
            q[k] = m[k, i] + m[i, k]
            q[3] = m[k, j] - m[j, k]
        return Pose(np.array(position, dtype=np.float64), q / np.linalg.norm(q))

    @staticmethod
    def looking(position: Array, forward: Array, opening: Array) -> Pose:
        """Tool pose with z along `forward` (3,) and x as near as possible to `opening` (3,).

        Raises:
            ValueError: `forward` and `opening` are parallel or of zero length.
        """
        z = np.asarray(forward, dtype=np.float64)
        z = z / np.linalg.norm(z)
        x = np.asarray(opening, dtype=np.float64)
        x = x - z * (x @ z)
        norm = np.linalg.norm(x)
        if not norm > 1e-9:
            raise ValueError("the jaw opening direction must not be parallel to the shaft")
        x = x / norm
        return Pose.from_matrix(np.column_stack([x, np.cross(z, x), z]), position)

    def rotation(self) -> Array:
        """The (3, 3) rotation matrix."""
        x, y, z, w = self.quaternion
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )

    def moved(self, offset: Array) -> Pose:
        """The same orientation, shifted by `offset` (3,) [m] in the camera frame."""
        return Pose(self.position + offset, self.quaternion)

    def at(self, position: Array) -> Pose:
        """The same orientation at `position` (3,) [m]."""
        return Pose(np.array(position, dtype=np.float64), self.quaternion)

    def angle_to(self, other: Pose) -> float:
        """Rotation angle [rad] between the two orientations."""
        return float(2 * np.arccos(np.clip(abs(self.quaternion @ other.quaternion), 0.0, 1.0)))

    def is_finite(self) -> bool:
        """Whether every number is finite."""
        return bool(np.isfinite(self.position).all() and np.isfinite(self.quaternion).all())


@dataclass(frozen=True)
class CameraModel:
    """Rectified stereo pair of pinhole cameras; the right one lies `baseline` [m] along +x. Lengths in pixels."""

    width: int
    height: int
    focal: float
    cu: float
    cv: float
    baseline: float

    def project(self, points: Array) -> Array:
        """Pixels (N, 2) float64 (u, v) of `points` (N, 3) [m] in the left image."""
        p = np.asarray(points, dtype=np.float64)
        return np.stack([self.focal * p[..., 0] / p[..., 2] + self.cu, self.focal * p[..., 1] / p[..., 2] + self.cv], axis=-1)

    def unproject(self, pixels: Array, depth: Array) -> Array:
        """Points (N, 3) [m] seen at `pixels` (N, 2) of the left image at z-`depth` (N,) [m]."""
        px = np.asarray(pixels, dtype=np.float64)
        z = np.asarray(depth, dtype=np.float64)
        return np.stack([(px[..., 0] - self.cu) / self.focal * z, (px[..., 1] - self.cv) / self.focal * z, z], axis=-1)


@dataclass(frozen=True)
class Frame:
    """One image of the left eye: `image` (H, W, 3) uint8 RGB, taken at bench time `stamp` [s]."""

    sequence: int
    stamp: float
    image: Image


@dataclass(frozen=True)
class StereoFrame:
    """A left frame and the right image (H, W, 3) uint8 RGB of the same instant."""

    left: Frame
    right: Image


class OperatingState(StrEnum):
    """CRTK operating states."""

    DISABLED = "DISABLED"
    ENABLED = "ENABLED"
    PAUSED = "PAUSED"
    FAULT = "FAULT"


@dataclass(frozen=True)
class ArmState:
    """CRTK operating state of one arm, received at bench time `stamp` [s]; `error` is the robot's own text.

    `guard` is what a driver that checks more than the robot does has to say: while it is not ok, the arm is not to be moved.
    """

    state: OperatingState
    is_homed: bool
    is_busy: bool
    stamp: float
    error: str = ""
    guard: Verdict = Verdict(True)  # noqa: RUF009 - frozen

    @property
    def ready(self) -> bool:
        """ENABLED, homed, and nothing in the way."""
        return self.state is OperatingState.ENABLED and self.is_homed and self.guard.ok


class MoveStatus(StrEnum):
    """State of one commanded motion."""

    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"


@dataclass(frozen=True)
class MoveReport:
    """What became of a commanded motion: DONE only if the arm is ready, data are fresh and measured is near the goal."""

    status: MoveStatus
    code: Code = Code.OK
    message: str = ""


class MoveHandle(Protocol):
    """One commanded motion; ask `report()` at every tick."""

    def report(self) -> MoveReport:
        """The state of this motion now."""
        ...


class Arm(Protocol):
    """One patient-side manipulator with its instrument, in CRTK's words. Poses in the left camera frame."""

    @property
    def name(self) -> str:
        """`PSM1` holds the grasper, `PSM2` the scissors."""
        ...

    def operating_state(self) -> ArmState:
        """The newest operating state."""
        ...

    def state_command(self, command: str) -> None:
        """One of enable, disable, home, unhome, pause, resume; an invalid one changes nothing."""
        ...

    def measured_cp(self) -> Stamped[Pose]:
        """Pose of the tool tip as the encoders and the calibration tell it."""
        ...

    def setpoint_cp(self) -> Pose:
        """The pose the arm is told to be at now."""
        ...

    def measured_jaw(self) -> Stamped[float]:
        """Full opening angle of the jaws [rad], 0 closed."""
        ...

    def measured_cf(self) -> Stamped[Array]:
        """Estimated force on the tool tip (3,) [N]."""
        ...

    def servo_cp(self, pose: Pose) -> None:
        """Set the pose setpoint directly; the caller sends short steps."""
        ...

    def move_cp(self, pose: Pose) -> MoveHandle:
        """Go to `pose` in a straight line at the arm's own speed."""
        ...

    def move_jaw(self, angle: float) -> MoveHandle:
        """Go to the full jaw opening `angle` [rad]."""
        ...

    def hold(self) -> None:
        """Stay where the arm is now, grasp kept; ends any motion."""
        ...


class Endoscope(Protocol):
    """The stereo endoscope. Frames are produced on request; `stamp()` is cheap."""

    @property
    def camera(self) -> CameraModel:
        """Rectified intrinsics and baseline."""
        ...

    def stamp(self) -> float:
        """Bench time [s] of the newest frame."""
        ...

    def left(self) -> Frame:
        """The newest left frame."""
        ...

    def stereo(self) -> StereoFrame:
        """The newest stereo pair."""
        ...


class Bench(Protocol):
    """Everything physical. `now()` is the only clock a session knows."""

    @property
    def arms(self) -> Mapping[str, Arm]:
        """Arms by name."""
        ...

    @property
    def endoscope(self) -> Endoscope:
        """The stereo endoscope."""
        ...

    def now(self) -> float:
        """Bench time [s]."""
        ...

    def advance(self, duration: float) -> None:
        """Let `duration` [s] pass (stub: physics; robot: waiting)."""
        ...

    def observe(self, callback: Callable[[], None]) -> None:
        """Have `callback` called at every physics step (stub) or from a 100 Hz thread (robot): the gate's monitor."""
        ...

    def emergency_stop(self) -> bool:
        """Whether the emergency stop is pressed."""
        ...

    def close(self) -> None:
        """Hold both arms and let go of the hardware."""
        ...
