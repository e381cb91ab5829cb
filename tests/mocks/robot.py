"""A scripted dVRK on a graph within one process: two arms, a stereo camera and a console that do what the test says, in its time.

No physics and no imperfections but those that a test sets: setpoints jump to where servo_cp says, measured follows at once, and the jaw
moves at a constant speed. `Rig` puts the robot, the deadman and a driver on one graph with a manual clock.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from hardware.dvrk import messages as m
from hardware.dvrk.bench import BenchDVRK
from hardware.dvrk.config import ArmConfig, ConsoleConfig, RobotConfig
from hardware.dvrk.deadman import Deadman
from hardware.dvrk.energy import Energy
from hardware.dvrk.instruments import instrument
from hardware.dvrk.kinematics import forward, inverse
from hardware.dvrk.local import LocalGraph
from hardware.interface import Array, Pose

PERIOD = 0.01  # [s]
JAW_SPEED = 2.0  # [rad/s]
K = np.array([[600.0, 0.0, 319.5], [0.0, 600.0, 239.5], [0.0, 0.0, 1.0]])
POTTS, FORCEPS = "POTTS_SCISSORS:400001", "FENESTRATED_BIPOLAR_FORCEPS:400205"


class ScriptedArm:
    """One arm. `offset`, `frozen`, `silent`, `stamp`, `corrupt`, `deaf`, `blocked_at` and the rest are the test's to set."""

    def __init__(self, robot: ScriptedRobot, name: str, tool: str) -> None:
        self.robot, self.name, self.tool = robot, name, tool
        self.state, self.homed, self.busy = "DISABLED", False, False
        self.q = np.array([0.1, -0.1, 0.14, 0.1, 0.1, -0.1])
        self.lag = np.zeros(3)  # [m], measured minus setpoint
        self.jaw = self.jaw_goal = 0.6 if tool == FORCEPS else 0.4
        self.jaw_setpoint = self.jaw
        self.blocked_at = -math.inf  # [rad], tissue keeps the jaw open by this much
        self.jaw_clip = -math.inf  # [rad], the lowest jaw setpoint that this release allows
        self.force = np.zeros(3)
        self.base = np.eye(4)
        self.frame_id = f"{name}_base"
        self.ratio = 1.0
        self.deaf = False  # servo commands and moves change nothing
        self.silent = False  # publishes nothing
        self.frozen = False  # the very same numbers, with new stamps
        self.invalid = False  # stamp 0
        self.old_stamps = False  # stamps stand still
        self.stubborn = False  # keeps its trajectory ratio
        self.count = 6  # joints
        self.break_pose = lambda position, quaternion: (position, quaternion)
        self.heard: list[tuple[str, object]] = []
        self._stamp = 0.0
        self._last: list[tuple[object, m.Message]] = []
        self._moving = False
        node = robot.node
        ns = f"/{name}"

        def out(topic: str, kind: type[m.Message], latched: bool = False):
            return node.publisher(f"{ns}/{topic}", kind, latched=latched)

        self.states = out("operating_state", m.OperatingState, True)
        self.cp, self.local = out("measured_cp", m.PoseStamped), out("local/measured_cp", m.PoseStamped)
        self.setpoint = out("local/setpoint_cp", m.PoseStamped)
        self.js = out("measured_js", m.JointState)
        self.jaw_js, self.jaw_set = out("jaw/measured_js", m.JointState), out("jaw/setpoint_js", m.JointState)
        self.cf = out("body/measured_cf", m.WrenchStamped)
        self.tools, self.ratios = out("tool_type", m.String, True), out("trajectory_j/ratio", m.Float64, True)
        self.goal_reached = out("goal_reached", m.Bool, True)
        self.errors, self.warnings = out("error", m.String, True), out("warning", m.String, True)
        self.clutch = out("arm_clutch", m.Joy)
        for topic, kind, obey in (
            ("servo_cp", m.PoseStamped, self._servo),
            ("hold", m.Empty, self._hold),
            ("state_command", m.StringStamped, self._command),
            ("trajectory_j/set_ratio", m.Float64, self._set_ratio),
            ("jaw/move_jp", m.JointState, self._move_jaw),
        ):
            node.subscribe(f"{ns}/{topic}", kind, obey)
        self.tools.publish(m.String(""))
        self.ratios.publish(m.Float64(1.0))
        self.tell()

    def count_of(self, command: str) -> int:
        """How often a command was heard."""
        return sum(name == command for name, _ in self.heard)

    def tell(self) -> None:
        """Send the operating state."""
        self.states.publish(m.OperatingState(self.robot.node.stamp(), self.state, self.homed, self.busy))

    def become(self, state: str, busy: bool = False, error: str = "") -> None:
        """Be in another state."""
        if error:
            self.errors.publish(m.String(error))
        self.state, self.busy = state, busy
        self.tell()

    def pulse(self) -> None:
        """Be busy for no time, as for somebody else's command."""
        for busy in (True, False):
            self.busy = busy
            self.tell()

    def tick(self, dt: float) -> None:
        """Move the jaw, publish everything."""
        if self._moving:
            step = JAW_SPEED * dt
            self.jaw_setpoint += min(max(self.jaw_goal - self.jaw_setpoint, -step), step)
            if abs(self.jaw_setpoint - self.jaw_goal) < 1e-9:
                self._moving, self.busy = False, False
                self.goal_reached.publish(m.Bool(True))
                self.tell()
        if not self.silent:
            self._publish()

    def _publish(self) -> None:
        node, rng = self.robot.node, self.robot.rng
        if not self.old_stamps:
            self._stamp = node.stamp()
        stamp = self._stamp if self.homed and self.state == "ENABLED" and self.tool and not self.invalid else 0.0
        if self.frozen and self._last:
            for publisher, message in self._last:
                publisher.publish(type(message)(stamp, *list(vars(message).values())[1:]))  # type: ignore[attr-defined]
            return
        tip = forward(instrument(self.tool or POTTS), self.q)
        setpoint, local, world = _message(tip, stamp, ""), _message(_shifted(tip, self.lag), stamp, ""), None
        world = _message(self.base @ _shifted(tip, self.lag), stamp, self.frame_id)
        for message in (local, world):
            position, quaternion = self.break_pose(message.position, message.quaternion)
            object.__setattr__(message, "position", position)
            object.__setattr__(message, "quaternion", quaternion)
        joints = np.concatenate([self.q, np.zeros(max(0, self.count - 6))])[: self.count]
        jaw = max(self.jaw_setpoint, self.blocked_at)
        self.jaw = jaw
        messages = [
            (self.js, m.JointState(stamp, tuple(map(str, range(self.count))), joints, np.zeros(0), rng.normal(size=self.count))),
            (self.cp, world),
            (self.local, local),
            (self.setpoint, setpoint),
            (self.cf, m.WrenchStamped(stamp, "", self.force, np.zeros(3))),
            (self.jaw_js, m.JointState(stamp, ("jaw",), np.array([jaw]))),
            (self.jaw_set, m.JointState(stamp, ("jaw",), np.array([max(self.jaw_setpoint, self.jaw_clip)]))),
        ]
        self._last = list(messages)
        for publisher, message in messages:
            publisher.publish(message)

    # ------------------------------------------------------------ what it obeys

    def _servo(self, message: m.PoseStamped, _: float) -> None:
        self.heard.append(("servo_cp", message))
        if self.deaf or self.state != "ENABLED" or not self.homed:
            return
        goal = np.linalg.inv(self.base) @ _matrix(message)
        self.q = inverse(instrument(self.tool), goal, self.q).q

    def _hold(self, _: m.Empty, __: float) -> None:
        self.heard.append(("hold", None))
        if self._moving:
            self._moving, self.busy = False, False
            self.jaw_goal = self.jaw_setpoint
            self.goal_reached.publish(m.Bool(False))
            self.tell()

    def _command(self, message: m.StringStamped, _: float) -> None:
        self.heard.append((message.string, None))
        if message.string == "enable":
            self.become("ENABLED")
        elif message.string == "disable":
            self.become("DISABLED")
        elif message.string == "home" and self.state == "ENABLED":
            self.homed = True
            self.tools.publish(m.String(self.tool))
            self.pulse()

    def _set_ratio(self, message: m.Float64, _: float) -> None:
        if not self.stubborn:
            self.ratio = message.data
            self.ratios.publish(m.Float64(message.data))

    def _move_jaw(self, message: m.JointState, _: float) -> None:
        self.heard.append(("jaw/move_jp", float(message.position[0])))
        if self.deaf:
            return
        if self.state != "ENABLED":
            self.warnings.publish(m.String(f"{self.name}: move_jp, arm not ready (1 errors)"))
            return
        self.jaw_goal = float(message.position[0])
        self._moving, self.busy = True, True
        self.tell()


class ScriptedRobot:
    """Two arms, a camera and a console on `graph`."""

    def __init__(self, graph: LocalGraph, stamps_ahead: float = 0.0) -> None:
        self.node = graph.node("dvrk", stamps_ahead)
        self.rng = np.random.default_rng(1)
        self.arms = {"PSM1": ScriptedArm(self, "PSM1", FORCEPS), "PSM2": ScriptedArm(self, "PSM2", POTTS)}
        self.teleop = self.node.publisher("/console/teleop/enabled", m.Bool, latched=True)
        self.following = self.node.publisher("/MTMR_PSM1/following", m.Bool, latched=True)
        self.operator = self.node.publisher("/console/operator_present", m.Joy, latched=True)
        self.pedal = self.node.publisher("/console/clutch", m.Joy, latched=True)
        self.teleop.publish(m.Bool(False))
        self.other = self.node.publisher("/MTML_PSM2/following", m.Bool, latched=True)
        self.following.publish(m.Bool(False))
        self.other.publish(m.Bool(False))
        self.operator.publish(m.Joy(1.0, (1,)))
        self.eyes = {eye: self.node.publisher(f"/stereo/{eye}/image_raw", m.Picture) for eye in ("left", "right")}
        self.infos = {eye: self.node.publisher(f"/stereo/{eye}/camera_info", m.CameraInfo) for eye in ("left", "right")}
        self.blind: set[str] = set()
        self.skew = 0.0  # [s]
        self.K = K
        self._ticks = 0

    def tick(self, dt: float) -> None:
        """Publish everything once; images at a third of the rate."""
        for arm in self.arms.values():
            arm.tick(dt)
        self._ticks += 1
        if self._ticks % 3 == 0:
            self.look()

    def look(self) -> None:
        """Publish a pair of images with its calibration."""
        for eye in self.eyes.keys() - self.blind:
            stamp = self.node.stamp() - (self.skew if eye == "right" else 0.0)
            self.infos[eye].publish(camera_info(eye, stamp, self.K))
            image = np.full((48, 64, 3), self._ticks % 256, dtype=np.uint8)
            self.eyes[eye].publish(m.Picture(stamp, eye, image))


class Rig:
    """Robot, deadman and driver on one graph; `clock.now` is in the test's hands and `wait` lets it pass."""

    def __init__(
        self,
        folder: Path,
        stamps_ahead: float = 0.0,
        deadman: bool = True,
        opened: bool = True,
        energy: Energy | None = None,
        **config: object,
    ) -> None:
        self.time = 50.0
        self.graph = LocalGraph(lambda: self.time)
        self.robot = ScriptedRobot(self.graph, stamps_ahead)
        self.deadman = Deadman(self.graph.node("dissection_deadman"), ["/PSM1", "/PSM2"]) if deadman else None
        self.config = robot_config(folder, **config)
        self.bench = BenchDVRK(self.config, self.graph.node("driver"), wait=self.wait, energy=energy, wall=0.0, threaded=False)
        if opened:
            self.bench.open()
            for arm in self.bench.arms.values():
                arm.state_command("enable")
                arm.state_command("home")
            self.bench.advance(0.3)

    def wait(self, duration: float) -> None:
        """Let time pass on the robot's machine, in its own steps."""
        until = self.time + duration
        while self.time < until - 1e-9:
            dt = min(PERIOD, until - self.time)
            self.time += dt
            self.robot.tick(dt)
            if self.deadman is not None:
                self.deadman.look()


def camera_info(eye: str, stamp: float, k: Array, size: tuple[int, int] = (64, 48)) -> m.CameraInfo:
    """The calibration of an ideal pair with a baseline of 4 mm."""
    p = np.hstack([k, [[-0.004 * k[0, 0] if eye == "right" else 0.0], [0.0], [0.0]]])
    return m.CameraInfo(stamp, eye, *size, "plumb_bob", np.zeros(5), k, np.eye(3), p)


def robot_config(folder: Path, **changes: object) -> RobotConfig:
    """A configuration with hand-eye files in `folder`: cameras look where the arms point."""
    for name, x in (("PSM1", -0.06), ("PSM2", 0.06)):
        turn = f"[[0, 1, 0, {x}], [1, 0, 0, 0], [0, 0, -1, 0.02], [0, 0, 0, 1]]"
        text = '{"base-frame": {"reference-frame": "camera", "transform": ' + turn + "}}"
        (folder / f"{name}-registration-open-cv.json").write_text(text)
    values: dict[str, object] = {
        "grasper": ArmConfig("PSM1", FORCEPS, folder / "PSM1-registration-open-cv.json", 0.009),
        "cutter": ArmConfig("PSM2", POTTS, folder / "PSM2-registration-open-cv.json", 0.012),
        "console": ConsoleConfig(),
        **changes,
    }
    return RobotConfig(**values)  # type: ignore[arg-type]


def _message(matrix: Array, stamp: float, frame: str) -> m.PoseStamped:
    pose = Pose.from_matrix(matrix[:3, :3], matrix[:3, 3])
    return m.PoseStamped(stamp, frame, pose.position, pose.quaternion)


def _shifted(matrix: Array, offset: Array) -> Array:
    shifted = matrix.copy()
    shifted[:3, 3] += offset
    return shifted


def _matrix(message: m.PoseStamped) -> Array:
    matrix = np.eye(4)
    matrix[:3, :3] = Pose(message.position, message.quaternion).rotation()
    matrix[:3, 3] = message.position
    return matrix
