"""One stub arm, seen through joints: setpoints go in as joints and jaw, what the encoders tell comes out likewise.

The stub arm knows poses in the camera frame alone. It is sent the pose of the joint setpoint, follows it with its own latency, speed and
errors, and its encoders' pose is turned back into joints. So whatever the stub does to the tip shows in the joints, as on a robot.
"""

from __future__ import annotations

import math

import numpy as np

from hardware.dvrk import kinematics
from hardware.dvrk.calibration import ArmFrames, as_matrix, as_pose, to_camera, vector_to_base
from hardware.dvrk.instruments import Instrument
from hardware.interface import Array
from hardware.stub.arms import StubArm

HOME = np.array([0.0, 0.0, 0.12, 0.0, 0.0, 0.0])  # [rad, m], where homing takes an arm (kinematic simulation: reference 4.1)
# What the simulated arm can follow [rad/s, m/s]: the robot's own limits are higher, but no procedure comes near them
FOLLOWS = np.array([0.3, 0.3, 0.05, 1.5, 1.5, 1.5, 2.0])
NEWTON_SHIFT, NEWTON_TURN = 2e-3, 0.1  # [m], [rad]; further away than this, joints are sought anew
WRIST_PITCH, SINGULAR = 4, 1.5  # [rad], from where on the wrist-yaw axis nears the shaft
JAW_STIFFNESS = 0.3  # [Nm/rad], motor torque by what keeps the jaw from its setpoint


class Plant:
    """Drives and measures one `StubArm`. `joints` (6,) and `jacobian` (6, 6), base frame, are those of the last `measure`."""

    def __init__(self, arm: StubArm, frames: ArmFrames, instrument: Instrument) -> None:
        self.arm, self.instrument = arm, instrument
        self._frames = frames
        self._base_from_camera = np.linalg.inv(frames.camera_from_base)
        self._tool_from_tip = np.linalg.inv(frames.tip_from_tool)
        self.joints = HOME.copy()
        self.tip = np.eye(4)  # pose of the tip below the remote centre
        self.jacobian = np.zeros((6, 6))
        self.jaw = arm.measured_jaw().value
        self.force = np.zeros(3)
        self.blocked_at = 0.0  # [rad], what lies between the jaws keeps them at least this far open
        self._sent: Array | None = None
        self._sent_jaw = arm.true_jaw()
        self.measure()

    def drive(self, joints: Array, jaw: float) -> None:
        """Send the stub arm to `joints` (6,), and its jaw to the opening `jaw` [rad]; closed jaws do not close further."""
        if self._sent is None or not np.array_equal(joints, self._sent):
            self._sent = joints.copy()
            tip = kinematics.forward(self.instrument, joints)
            self.arm.servo_cp(to_camera(self._frames, as_pose(tip)))
        wanted = max(jaw, self.blocked_at, 0.0)
        if wanted != self._sent_jaw:
            self._sent_jaw = wanted
            self.arm.move_jaw(wanted)

    def stop(self) -> None:
        """The motors lost their power: the arm stays where it is."""
        self.arm.state_command("disable")
        self._sent = None

    @property
    def stamp(self) -> float:
        """Bench time [s] of what was measured."""
        return self.arm.measured_cp().stamp

    def measure(self) -> None:
        """Read the encoders: joints by one Newton step from the last ones, which lie at most a physics step or two away."""
        self.tip = self._base_from_camera @ as_matrix(self.arm.measured_cp().value) @ self._tool_from_tip
        poses = kinematics.frames(self.instrument, self.joints)
        reached = poses[-1] @ kinematics.TIP
        self.jacobian = _jacobian(poses)
        shift = self.tip[:3, 3] - reached[:3, 3]
        turn = _rotation_vector(self.tip[:3, :3] @ reached[:3, :3].T)
        if shift @ shift < NEWTON_SHIFT**2 and turn @ turn < NEWTON_TURN**2 and abs(self.joints[WRIST_PITCH]) < SINGULAR:
            self.joints = self.joints + np.linalg.solve(self.jacobian, np.concatenate([shift, turn]))
        else:
            found = kinematics.inverse(self.instrument, self.tip, self.joints)
            if np.isfinite(found.q).all():
                self.joints = found.q
        self.jaw = self.arm.measured_jaw().value
        self.force = vector_to_base(self._frames, self.arm.measured_cf().value)

    def set_instrument(self, instrument: Instrument) -> None:
        """Take another instrument's geometry for what is mounted."""
        self.instrument = instrument
        self._sent = None
        self.measure()


def _jacobian(poses: Array) -> Array:
    """As `kinematics.jacobian`, from its `frames`, all columns at once: it is wanted a hundred times per second."""
    (x, y, z), (u, v, w) = poses[1:, :3, 2].T, (poses[-1, :3, 3] - poses[1:, :3, 3]).T
    jacobian = np.array([y * w - z * v, z * u - x * w, x * v - y * u, x, y, z])
    slide = kinematics.INSERTION
    jacobian[:3, slide], jacobian[3:, slide] = jacobian[3:, slide].copy(), 0.0
    return jacobian


def _rotation_vector(rotation: Array) -> Array:
    """Rotation vector (3,) [rad] of a rotation by less than half a turn."""
    axis = 0.5 * np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    sine = math.sqrt(axis @ axis)
    angle = math.atan2(sine, 0.5 * (rotation[0, 0] + rotation[1, 1] + rotation[2, 2] - 1.0))
    return axis if sine < 1e-9 else axis * (angle / sine)
