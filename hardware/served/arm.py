"""One served arm: what it grants, refuses, silently alters, and tells, as the dVRK would.

Nothing here knows a graph: commands come as calls, and what the arm has to say on an event goes through `say`. Numbers in brackets are
sections of reference/dvrk.md. Not thread-safe: the bench calls under its lock.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from hardware.codes import InputError
from hardware.dvrk import kinematics
from hardware.dvrk.instruments import instrument
from hardware.dvrk.messages import Bool, Empty, Float64, OperatingState, String
from hardware.interface import Array
from hardware.served.faults import FAULT_TEXTS, OLD_ERROR, Fault, Faults
from hardware.served.motion import JAW, JointMotion, Mode
from hardware.served.plant import HOME, Plant
from hardware.served.states import Delays, Doing, granted
from hardware.served.voice import Say, Voice

TRACKING = np.array([0.5, 0.5, 0.05, 0.6, 0.6, 0.6])  # [rad, m], setpoint to measured: more is a fault (6.2)
YIELDS = 0.01  # [m/s/N], how a limp arm gives way
FOREIGN = np.array([5e-3, 0.0, 0.0])  # [m/s], base frame: where to and how fast a stranger drives
BLOCKED_AT = 0.45  # [rad]


class ServedArm:
    """See the module's text. The bench calls `step` before, and `settle` after each physics step."""

    def __init__(
        self, name: str, tool_type: str, plant: Plant, frame_id: str, faults: Faults, now: Callable[[], float], delays: Delays
    ) -> None:
        self.name, self.tool_type, self.frame_id = name, "", frame_id
        self.plant, self._mounted, self._faults, self.now, self._delays = plant, tool_type, faults, now, delays
        self.motion = JointMotion(plant.instrument, plant.joints, plant.jaw)
        self.base = np.eye(4)  # from the reference frame to the remote centre
        self.doing, self.homed = Doing.DISABLED, False
        self._until = -math.inf
        self._cartesian = False
        self._stamp: Callable[[], float] = lambda: 0.0
        self._voice = Voice(name, now)
        self.flush = self._voice.flush  # says what happened
        self._tell, self._warn = self._voice.tell, self._voice.warn

    def connect(self, say: Say, stamp: Callable[[], float]) -> None:
        """Speak through `say` from now on, beginning with what is latched; `stamp` is ROS time [s]."""
        self._stamp = stamp
        self._voice.connect(say)
        self.retell()

    def retell(self) -> None:
        """Say all that is latched anew: somebody may have missed it."""
        self._tell("tool_type", String(self.tool_type))
        self._tell("desired_state", String(self.doing.value))
        self._tell_ratio()
        self._tell_state()
        self.flush()

    # ------------------------------------------------------------ state

    @property
    def busy(self) -> bool:
        """As `is_busy` says, of arm and jaw alike."""
        return self.doing.passing or self.motion.moving

    @property
    def joints_valid(self) -> bool:
        """Whether encoders are known: from homing on."""
        return self.homed

    @property
    def tip_valid(self) -> bool:
        """Whether there is a pose, and Cartesian and jaw commands are heard."""
        return self.homed and self.doing in (Doing.TOOL_ENGAGED, Doing.MANUAL, Doing.PAUSED) and bool(self.tool_type)

    def operating_state(self) -> OperatingState:
        """The message, as of now."""
        return OperatingState(self._stamp(), self.doing.state.value, self.homed, self.busy)

    def state_command(self, command: str) -> None:
        """Obey, or warn (1.1). The state is told again either way."""
        if not granted(self.doing.state, command):
            self._warn(f'state command "{command}" is not valid in state {self.doing.state}')
        elif command == "enable" and self.doing in (Doing.DISABLED, Doing.FAULT):
            self._begin(Doing.POWERING, self._delays.powering)
        elif command == "disable":
            self._power_off(Doing.DISABLED)
        elif command == "pause":
            self.motion.stay()
            self._become(Doing.PAUSED)
        elif command == "resume":
            self._become(self._rested())
        elif command == "home" and not self.homed and self.doing is Doing.ENABLED:
            self.plant.arm.state_command("home")
            self._begin(Doing.HOMING, 0.0)
        elif command == "unhome":
            self.motion.stay()
            self.plant.arm.state_command("unhome")
            self.homed = False
            self._set_tool("")
            if self.doing.state == "ENABLED":
                self._become(Doing.ENABLED)
        self._tell_state()

    def fault(self, text: str) -> None:
        """Enter FAULT: power goes off, the arm stays where it is until it is enabled anew (6.2)."""
        self._voice.error(text)
        self._power_off(Doing.FAULT)
        self._tell_state()

    # ------------------------------------------------------------ commands of motion

    def hold(self) -> None:
        """Position mode at the setpoint: a move under way ends with goal_reached false."""
        if self.homed and self.doing in (Doing.TOOL_ENGAGED, Doing.HOMED):
            self._ended(self.motion.stay())

    def relax(self, what: str) -> None:
        """`free`, or any command of effort: the whole arm goes limp, whatever part was meant (1.3)."""
        if self._ready(what, cartesian=what not in ("free", "servo_jf")):
            self._ended(self.motion.stay(Mode.EFFORT))

    def servo_jp(self, joints: Array, relative: bool = False) -> None:
        """Make joints (6,) the setpoint at once, or shift it by them."""
        if self._ready("servo_jr" if relative else "servo_jp", cartesian=False) and self._six(joints):
            self._cartesian = False
            self._ended(self.motion.servo(joints + (self.motion.setpoint[:JAW] if relative else 0.0)))

    def move_jp(self, joints: Array, relative: bool = False) -> None:
        """Set out to joints (6,), or by them."""
        if self._ready("move_jr" if relative else "move_jp", cartesian=False) and self._six(joints):
            self._cartesian = False
            self._set_out(self.motion.move(joints + (self.motion.setpoint[:JAW] if relative else 0.0)))

    def servo_cp(self, pose: Array) -> None:
        """Make what inverse kinematics gives for `pose` (4, 4), reference frame, the setpoint at once."""
        if not self._ready("servo_cp"):
            return
        if not self._enters_cartesian():
            return
        joints = self._solve(np.linalg.inv(self.base) @ pose)
        if joints is not None:
            self._ended(self.motion.servo(joints))

    def move_cp(self, pose: Array) -> None:
        """Inverse kinematics once, then a trajectory of the joints: the tip's path is no straight line (1.3)."""
        if not self._ready("move_cp"):
            return
        entered = self._enters_cartesian()
        joints = self._solve(np.linalg.inv(self.base) @ pose)
        if joints is None:
            self.motion.stay()
            self._tell("goal_reached", Bool(False))
            self._tell_state()
        elif entered:
            self._set_out(self.motion.move(joints))
        else:
            self.motion.take_goal(joints)
            self._tell_state()

    def jaw_servo_jp(self, angle: float) -> None:
        """Make `angle` [rad] the jaw's setpoint at once."""
        if self._ready("jaw/servo_jp") and self._finite(angle):
            self._ended(self.motion.servo_jaw(angle))

    def jaw_move_jp(self, angle: float) -> None:
        """Send the jaw to `angle` [rad]."""
        if self._ready("jaw/move_jp") and self._finite(angle):
            self._set_out(self.motion.move_jaw(angle))

    def set_ratio(self, ratio: float, which: str = "") -> None:
        """Scale speed and acceleration of trajectories, or `which` of them, "v" or "a"; out of ]0, 1] is ignored."""
        if not 0.0 < ratio <= 1.0:
            self._warn(f"trajectory_j/set_ratio{'_' * bool(which)}{which}: {ratio:g} is not within ]0, 1]")
            return
        self.motion.ratio_v = self.motion.ratio_v if which == "a" else ratio
        self.motion.ratio_a = self.motion.ratio_a if which == "v" else ratio
        self._tell_ratio()

    def set_base_frame(self, base: Array, frame_id: str) -> None:
        """Report and take poses in another frame from now on, of which `base` (4, 4) is the remote centre."""
        self.base, self.frame_id = base, frame_id

    def set_tool_type(self, tool_type: str) -> None:
        """Another instrument, as the operator tells; one that is not known leaves the arm without a pose."""
        try:
            mounted = instrument(tool_type)
        except InputError:
            self._warn(f"set_tool_type: {tool_type} is not a known instrument")
            self._set_tool("ERROR")
            return
        self._mounted = tool_type
        self.plant.set_instrument(mounted)
        self.motion.set_instrument(mounted)
        if self.doing is Doing.TOOL_ENGAGED:
            self._set_tool(tool_type)

    def set_tool_present(self, present: bool) -> None:
        """Take the instrument off, or put it on."""
        if self.doing not in (Doing.TOOL_ENGAGED, Doing.HOMED, Doing.ENGAGING_TOOL):
            return
        self._ended(self.motion.stay())
        if present:
            self._engage()
        else:
            self._set_tool("")
            self._become(Doing.HOMED)

    def clutch(self, pressed: bool) -> None:
        """Somebody takes the arm by hand, or lets go of it (1.4)."""
        if pressed and self.doing is Doing.TOOL_ENGAGED:
            self._ended(self.motion.stay(Mode.EFFORT))
            self._become(Doing.MANUAL)
        elif not pressed and self.doing is Doing.MANUAL:
            self.motion.stay()
            self._become(Doing.TOOL_ENGAGED)

    # ------------------------------------------------------------ what happens without a command

    def happen(self, fault: Fault) -> None:
        """One of the faults that happen once."""
        if fault in FAULT_TEXTS:
            self.fault(FAULT_TEXTS[fault])
        elif fault is Fault.BUSY_PULSE:
            state = self.operating_state()
            for busy in (True, self.busy):
                self._tell("operating_state", OperatingState(state.stamp, state.state, state.is_homed, busy))
        elif fault is Fault.INTERRUPT:
            self._ended(self.motion.stay())
        elif fault is Fault.JAW_STALE_GOAL:
            self.motion.goal[JAW] = self.plant.instrument.jaw_upper
        elif fault is Fault.LATCHED_ERROR:
            self._voice.error(OLD_ERROR)
        elif fault is Fault.JAW_SLIPS:
            self.plant.blocked_at = 0.0

    def step(self, dt: float) -> None:
        """Go on by `dt` [s]: the setpoints, and what takes its time."""
        now = self.now()
        if self.doing.passing and self.doing is not Doing.MANUAL and now >= self._until - 1e-9:
            self._go_on()
        if self.doing.state in ("ENABLED", "PAUSED"):
            if self.doing is Doing.TOOL_ENGAGED and self._faults.on(Fault.FOREIGN_SERVO, self.name):
                self._drift(FOREIGN * dt)
            if self.motion.mode is Mode.EFFORT:
                self.motion.put(self.plant.joints, self.plant.jaw)
                self._drift(YIELDS * dt * self.plant.force, Mode.EFFORT)
            if self.motion.step(dt):
                self._tell("goal_reached", Bool(True))
                self._tell_state()
            if self._faults.on(Fault.JAW_BLOCKED, self.name) and self.plant.jaw >= BLOCKED_AT:
                self.plant.blocked_at = BLOCKED_AT
            self.plant.drive(self.motion.setpoint[:JAW], float(self.motion.setpoint[JAW]))
        self.flush()

    def settle(self) -> None:
        """Look at the arm after a physics step: what it cannot follow, and what was done to the bench, is a fault."""
        if self.doing.state not in ("ENABLED", "PAUSED"):
            return
        error = np.abs(self.plant.joints - self.motion.setpoint[:JAW])
        if self.plant.arm.operating_state().state != "ENABLED":
            self.fault(FAULT_TEXTS[Fault.FAULT_POWER])
        elif self.homed and self.doing is not Doing.HOMING and (error > TRACKING).any():
            mask = ", ".join(str(int(one)) for one in error > TRACKING)
            self.fault(f"tracking error, mask (1 for error): [{mask}, 0]")
        self.flush()

    # ------------------------------------------------------------ inside

    def _go_on(self) -> None:
        """What took its time is over."""
        if self.doing is Doing.POWERING:
            self.plant.arm.state_command("enable")
            if self.plant.arm.operating_state().state != "ENABLED":
                self.fault("failed to enable power")
                return
            self.motion.put(self.plant.joints, self.plant.jaw)
            self._become(Doing.ENABLED if not self.homed else self._rested())
        elif self.doing is Doing.HOMING:
            arm = self.plant.arm.operating_state()
            if arm.is_homed and not self.motion.moving:
                if np.allclose(self.motion.setpoint[:JAW], HOME, atol=1e-6):
                    self.homed = True
                    self._engage()
                else:
                    self.motion.put(self.plant.joints, self.plant.jaw)
                    self.motion.move(HOME)
        elif self.doing is Doing.ENGAGING_TOOL:
            tool = self.plant.instrument
            if not tool.jaw_lower <= self.motion.setpoint[JAW] <= tool.jaw_upper and not self.motion.moving:
                self.motion.move_jaw(self.motion.setpoint[JAW])
            if not self.motion.moving:
                self._become(Doing.TOOL_ENGAGED)

    def _engage(self) -> None:
        """The instrument is recognised at once, and so there are six joints; poses count when its discs are engaged."""
        self._set_tool(self._mounted)
        self._begin(Doing.ENGAGING_TOOL, self._delays.engaging)

    def _rested(self) -> Doing:
        """What an arm with power and without anything to do is."""
        if not self.homed:
            return Doing.ENABLED
        return Doing.TOOL_ENGAGED if self.tool_type else Doing.HOMED

    def _begin(self, doing: Doing, takes: float) -> None:
        self._until = self.now() + takes
        self._become(doing)

    def _become(self, doing: Doing) -> None:
        self.doing = doing
        self._tell("desired_state", String(doing.value))
        self._tell_state()

    def _power_off(self, doing: Doing) -> None:
        self.motion.stay()
        self.plant.stop()
        self.motion.put(self.plant.joints, self.plant.jaw)
        self._become(doing)

    def _set_tool(self, tool_type: str) -> None:
        if tool_type != self.tool_type:
            self.tool_type = tool_type
            self._tell("tool_type", String(tool_type))
            if not tool_type:
                self._tell("tool_type_request", Empty())

    def _ready(self, what: str, cartesian: bool = True) -> bool:
        """Whether motion is granted; else it is refused with a warning now and then, and nothing more (6.6)."""
        doing = (Doing.TOOL_ENGAGED,) if cartesian else (Doing.TOOL_ENGAGED, Doing.HOMED)
        if self.homed and self.doing in doing and not self._faults.on(Fault.NOT_READY, self.name):
            return True
        self._voice.not_ready(what)
        return False

    def _six(self, joints: Array) -> bool:
        if joints.shape == (6,) and self.tool_type:
            return self._finite(joints)
        self._warn(f"a command of {joints.size} joints does not fit the arm's {6 if self.tool_type else 7}")
        return False

    def _finite(self, joints: Array | float) -> bool:
        """Nobody looks at a goal before it is executed; numbers that are not finite end in the low level's exception (7.4)."""
        if np.isfinite(joints).all():
            return True
        self.fault("IO: setpoint is not a number")
        return False

    def _enters_cartesian(self) -> bool:
        """Whether the arm stands deep enough for Cartesian motion; once it is there it stays (5)."""
        if self._cartesian or kinematics.depth(self.plant.joints) >= kinematics.ENTER_DEPTH:
            self._cartesian = True
            self._voice.deep_enough()
            return True
        self._voice.too_shallow()
        return False

    def _solve(self, pose: Array) -> Array | None:
        """Joints (6,) for a pose (4, 4) below the remote centre, altered without a word where it is too shallow."""
        found = kinematics.inverse(self.plant.instrument, pose, self.plant.joints)
        if not np.isfinite(found.q).all() or self._faults.on(Fault.IK_FAILURE, self.name):
            self._voice.error(f"unable to solve inverse kinematics ({found.reason or 'no convergence'})")
            return None
        joints = found.q.copy()
        joints[kinematics.INSERTION] = max(joints[kinematics.INSERTION], kinematics.insertion(kinematics.KEEP_DEPTH))
        return joints

    def _drift(self, shift: Array, mode: Mode = Mode.POSITION) -> None:
        """Move the setpoint by `shift` (3,) [m], base frame, as nobody commanded."""
        pose = kinematics.forward(self.plant.instrument, self.motion.setpoint[:JAW])
        pose[:3, 3] += shift
        found = kinematics.inverse(self.plant.instrument, pose, self.motion.setpoint[:JAW])
        if np.isfinite(found.q).all() and mode is Mode.POSITION:
            self._ended(self.motion.servo(found.q))
        elif np.isfinite(found.q).all():
            self.motion.setpoint[:JAW] = found.q

    def _set_out(self, ended: bool) -> None:
        """A move begins; one that it takes the place of is over, short of its goal."""
        if ended:
            self._tell("goal_reached", Bool(False))
        self._tell_state()

    def _ended(self, ended: bool) -> None:
        if ended:
            self._tell("goal_reached", Bool(False))
            self._tell_state()

    def _tell_state(self) -> None:
        self._tell("operating_state", self.operating_state())

    def _tell_ratio(self) -> None:
        motion = self.motion
        for which, ratio in (("", min(motion.ratio_v, motion.ratio_a)), ("_v", motion.ratio_v), ("_a", motion.ratio_a)):
            self._tell(f"trajectory_j/ratio{which}", Float64(ratio))
