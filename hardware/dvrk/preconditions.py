"""What must hold for an arm to be moved by us, and go on holding: pure functions of the readings, each with a code and a sentence.

They are asked before each command and at every look of the monitor. A latched verdict is one that the procedure cannot outlive:
what was calibrated, mounted or agreed on is no longer so, and a person must look. The others may pass by themselves.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hardware.codes import Code
from hardware.dvrk.arm_readings import ArmReadings
from hardware.dvrk.config import ArmConfig, RateConfig, RobotConfig, ToleranceConfig
from hardware.dvrk.messages import JointState, Joy
from hardware.dvrk.telemetry import Received, Sample
from hardware.interface import Array, OperatingState
from hardware.verdicts import Verdict

FINE = Verdict(True)
RATIO_ROUNDING = 1e-6
FROZEN_WITHIN = 0.08  # [s] in which numbers that cannot stand still are called frozen
TELLING = 2e-3  # [rad, m] by which an arm should have moved by the speed it tells
ZERO = np.zeros(1)
LEAST_TURN = 1e-6  # [rad]; an arc cosine near 1 is no finer
BUSY_GRACE = 0.5  # [s] after a command of ours in which a busy arm is nobody else's doing
MOVING_TOPICS = (
    "servo_jp",
    "servo_jr",
    "servo_jf",
    "servo_cp",
    "servo_cr",
    "servo_cs",
    "servo_cv",
    "move_jp",
    "move_jr",
    "move_cp",
)
FORCING_TOPICS = ("body/servo_cf", "spatial/servo_cf", "jaw/servo_jp", "jaw/servo_jf", "jaw/move_jp", "free", "set_base_frame")


def worst(verdicts: Iterable[Verdict]) -> Verdict:
    """The first latched one, or else the first that is not ok."""
    bad = [verdict for verdict in verdicts if not verdict.ok]
    return next((verdict for verdict in bad if verdict.latched), bad[0] if bad else FINE)


def _wait(code: Code, message: str) -> Verdict:
    return Verdict(False, False, code, message)


def _end(code: Code, message: str) -> Verdict:
    return Verdict(False, True, code, message)


# ------------------------------------------------------------ data


def data_fresh(readings: ArmReadings, now: float, rates: RateConfig, with_jaw: bool) -> Verdict:
    """Every reading that motion rests on is valid, and young by the time it was received."""
    for name, sample in readings.streams(with_jaw).items():
        if sample.good is None and not sample.problem:
            return _wait(Code.ARM_DATA_STALE, f"{name} was never received")
        if sample.problem:
            code = Code.NOT_FINITE if "finite" in sample.problem else Code.ARM_DATA_STALE
            return _wait(code, f"{name}: {sample.problem}")
        if not sample.fresh(now, rates.stale):
            return _wait(Code.ARM_DATA_STALE, f"{name} is {_age(sample, now)} old; {rates.stale * 1e3:.0f} ms are allowed")
    return FINE


def encoders_alive(readings: ArmReadings, sent_away: float, now: float, rates: RateConfig, with_jaw: bool) -> Verdict:
    """The very same numbers, however fresh, come from no live arm: where they never stood still before, or tell of a speed.

    Nor do they for long where the arm was sent elsewhere, at `sent_away` [s]. Of an arm at rest without noise nothing is concluded: a
    simulated one has none.
    """
    since = readings.joints.unchanged_since
    if since < sent_away < now - rates.frozen:
        said = (
            f"measured_js has told the very same numbers for {now - since:.1f} s though the arm was sent elsewhere: it is frozen"
        )
        return _wait(Code.ARM_DATA_STALE, said)
    for name, sample in readings.streams(with_jaw).items():
        if sample.good is None or not now - sample.unchanged_since > FROZEN_WITHIN:
            continue
        still = sample.good.received - sample.unchanged_since  # silence is no repetition
        way = still * float(np.max(np.abs(getattr(sample.good.message, "velocity", ZERO)), initial=0.0))
        if still > FROZEN_WITHIN and (sample.noisy or way > TELLING):
            told = "though it never did so before" if sample.noisy else "and a speed with them"
            said = f"{name} has told the very same numbers for {still * 1e3:.0f} ms, {told}: it is frozen"
            return _wait(Code.ARM_DATA_STALE, said)
    return FINE


def tracks_setpoint(readings: ArmReadings, tolerances: ToleranceConfig) -> Verdict:
    """The arm is near where it is told to be; the robot itself lets 5 cm pass."""
    if readings.local.good is None or readings.setpoint.good is None:
        return FINE  # data_fresh says so
    measured, setpoint = readings.local.good.message, readings.setpoint.good.message
    error = float(np.linalg.norm(measured.position - setpoint.position))
    if error > tolerances.tracking:
        limit = tolerances.tracking * 1e3
        return _end(Code.ARM_FAULT, f"the tip is {error * 1e3:.1f} mm from its setpoint; {limit:.1f} mm are allowed")
    angle = 2.0 * math.acos(min(abs(float(measured.quaternion @ setpoint.quaternion)), 1.0))
    if angle > tolerances.tracking_rotation:
        limit = math.degrees(tolerances.tracking_rotation)
        return _end(
            Code.ARM_FAULT, f"the tip is turned {math.degrees(angle):.0f} degrees from its setpoint; {limit:.0f} are allowed"
        )
    return FINE


def stands_beside(readings: ArmReadings, tolerances: ToleranceConfig, name: str) -> str:
    """Why an arm at rest does not stand where it is told to be, "" where it does."""
    if readings.local.good is None or readings.setpoint.good is None:
        return f"{name} does not say where it is"
    error = float(np.linalg.norm(readings.local.good.message.position - readings.setpoint.good.message.position))
    return "" if error <= tolerances.position else f"{name} stands {error * 1e3:.1f} mm beside its setpoint"


# ------------------------------------------------------------ what was mounted and calibrated


def tool_as_configured(readings: ArmReadings, arm: ArmConfig) -> Verdict:
    """The instrument that the configuration names is on the arm, and engaged."""
    joints = readings.joints
    if "joints" in joints.problem:
        return _end(Code.SETUP_CHANGED, f"the instrument is off: {joints.problem}")
    return tool_as_told(readings, arm)


def tool_as_told(readings: ArmReadings, arm: ArmConfig) -> Verdict:
    """Likewise by its name alone. While an instrument engages, its latched name may come before the first six joints do."""
    if readings.tool_type is None:
        return _wait(Code.ARM_NOT_READY, f"the robot has not told its tool_type; {arm.tool_type} is expected")
    if readings.tool_type != arm.tool_type:
        found = repr(readings.tool_type) if readings.tool_type else "no instrument"
        return _end(Code.SETUP_CHANGED, f"the arm holds {found} where the configuration says {arm.tool_type!r}")
    return FINE


def frame_as_configured(readings: ArmReadings, arm: ArmConfig) -> Verdict:
    """Poses come in the frame that the configuration names: goals are read in it, whatever our headers say."""
    found = None if readings.cp.good is None else readings.cp.good.message.frame_id
    if found is None or found == arm.frame_id:
        return FINE
    return _end(Code.SETUP_CHANGED, f"measured_cp comes in the frame {found!r} where the configuration says {arm.frame_id!r}")


def base_still(
    base: Array | None, first: Array | None, tolerances: ToleranceConfig, what: str = "the arm's base frame"
) -> Verdict:
    """A frame (4, 4) that the calibration rests on is where it was; it moves with set-up joints and endoscope."""
    if base is None or first is None:
        return FINE
    shift, turn = _shift_and_turn(base, first)
    # An angle moves the tip, at most 0.25 m away, by as much as a shift would.
    if shift <= tolerances.frame_shift and turn * 0.25 <= max(tolerances.frame_shift, 1e-4):
        return FINE
    return _end(
        Code.SETUP_CHANGED,
        f"{what} moved by {shift * 1e3:.1f} mm and {math.degrees(turn):.2f} degrees: the calibration no longer holds",
    )


def shifted(base: Array | None, first: Array | None) -> float:
    """By how much a frame (4, 4) that moved shifts a tip in it, at most [m]; 0 while it is not known."""
    if base is None or first is None:
        return 0.0
    shift, turn = _shift_and_turn(base, first)
    return shift + 0.25 * (turn if turn > LEAST_TURN else 0.0)


def slow_enough(readings: ArmReadings, ratio: float) -> Verdict:
    """The robot's own trajectories run at the configured share of their speed, or slower."""
    if readings.ratio is None:
        return _wait(Code.ARM_NOT_READY, f"the robot has not told its trajectory ratio; {ratio:g} is wanted")
    if readings.ratio <= ratio + RATIO_ROUNDING:
        return FINE
    return _wait(Code.ARM_NOT_READY, f"the trajectory ratio is {readings.ratio:g}; {ratio:g} is wanted")


# ------------------------------------------------------------ who else moves the arm


def nobody_holds_it(readings: ArmReadings, now: float, ours: bool, last_command: float) -> Verdict:
    """The arm's clutch is not pressed, and it is not busy with anything but our own motion (`ours`)."""
    if readings.pressed:
        return _wait(Code.ARM_NOT_READY, "somebody presses the clutch at the arm")
    if readings.busy and not ours and now - last_command > BUSY_GRACE:
        return _wait(
            Code.ARM_NOT_READY, "the arm is busy without a command of ours: somebody moves it by hand or by another program"
        )
    return FINE


def jaw_ours(setpoint: Sample[JointState], commanded: float | None, tolerances: ToleranceConfig) -> Verdict:
    """The jaw's setpoint is where it was sent, `commanded` [rad]; a stale goal of the robot may open a grasp."""
    if commanded is None or setpoint.good is None:
        return FINE
    found = float(setpoint.good.message.position[0])
    if abs(found - commanded) <= tolerances.jaw:
        return FINE
    return _end(
        Code.FOREIGN_MOTION,
        f"the jaw's setpoint is {math.degrees(found):.0f} degrees where {math.degrees(commanded):.0f} were sent",
    )


@dataclass(frozen=True)
class ConsoleReadings:
    """The surgeon's console as last heard of. A name maps to True, False, or None where it has not spoken yet."""

    teleops: Mapping[str, bool | None]  # enabled or following, by topic
    operator: bool | None
    clutches: Mapping[str, bool]  # pressed, by topic


def console_free(console: ConsoleReadings, operator_wanted: bool) -> Verdict:
    """Teleoperation is off and follows nothing, no clutch is pressed, and the operator is there where that is wanted."""
    for topic, on in console.teleops.items():
        if on is None:
            return _wait(Code.ARM_NOT_READY, f"{topic} has not said whether teleoperation is on; switch it off at the console")
        if on:
            return _wait(Code.ARM_NOT_READY, f"{topic} is true: switch teleoperation off, or two masters move the arm")
    for topic, pressed in console.clutches.items():
        if pressed:
            return _wait(Code.ARM_NOT_READY, f"{topic} is pressed")
    if operator_wanted and not console.operator:
        said = "has not told whether anybody is there" if console.operator is None else "says that nobody is there"
        return _wait(Code.ARM_NOT_READY, f"the console {said}; an operator must be present while arms move")
    return FINE


def only_us(publishers: Mapping[str, Sequence[str]], us: Sequence[str]) -> Verdict:
    """Nobody else can command the arm; `publishers` are the nodes by command topic. The robot obeys whoever speaks."""
    for topic, nodes in publishers.items():
        others = [node for node in nodes if node not in us]
        if others:
            return _end(Code.FOREIGN_MOTION, f"{', '.join(others)} may also command the arm by {topic}; stop it first")
    return FINE


def chain_open(arms: Sequence[tuple[OperatingState, str]]) -> bool:
    """Whether all arms lost their power at once, by state and the robot's text: the emergency stop cuts that of all (6.4)."""
    return all(state is OperatingState.FAULT and "power" in error.lower() for state, error in arms)


def one_source(sources: Mapping[str, int]) -> Verdict:
    """One node alone reports for the arm; `sources` are the publishers by telemetry topic."""
    for topic, count in sources.items():
        if count > 1:
            return _end(Code.SETUP_CHANGED, f"{topic} comes from {count} nodes at once; stop all but the robot's")
    return FINE


def sees_as_calibrated(changed: str, apart: float, skew: float) -> Verdict:
    """The cameras see by the calibration that the session began with, and the eyes' stamps, `apart` [s], still tell of one instant.

    Grabbers are not synchronised; but stamps that part by more than the `skew` [s] allowed, and half of it for what the graph takes,
    join images of two instants.
    """
    if changed:
        return _end(Code.SETUP_CHANGED, changed)
    if apart > 1.5 * skew:
        said = f"the stamps of the two eyes are {apart * 1e3:.0f} ms apart though their images arrive together"
        return _wait(Code.CAMERA_STALE, said)
    return FINE


# ------------------------------------------------------------ the graph


def connected(alive: bool) -> Verdict:
    """The graph answers: connections outlive its master, but then nobody new is found, and nobody may join to hold the arms."""
    return (
        FINE if alive else _end(Code.CONNECTION_LOST, "the graph does not answer any more: its master is gone or was restarted")
    )


def deadman_watches(what_is_wrong: str) -> Verdict:
    """The deadman beside the robot is there and watches."""
    return _end(Code.DEADMAN, what_is_wrong) if what_is_wrong else FINE


def deadman_has(holders: Mapping[str, Sequence[str]], deadman: str) -> Verdict:
    """The node `deadman` can hold all our arms; `holders` are the nodes by hold topic. What it watches is told on its command line."""
    for topic, nodes in holders.items():
        if not any(node.rpartition("/")[2].startswith(deadman) for node in nodes):
            arms = " ".join(one.removesuffix("/hold") for one in holders)
            return _end(Code.DEADMAN, f"the deadman does not publish {topic}; start it with the arms of robot.toml: {arms}")
    return FINE


def kinds_as_expected(kinds: Mapping[str, str], expected: Mapping[str, str]) -> list[str]:
    """Sentences for the topics that are missing or of another type: an older robot speaks another language."""
    found = []
    for topic, kind in expected.items():
        if topic not in kinds:
            found.append(f"{topic} is not published")
        elif kinds[topic] != kind:
            older = " (a dVRK before 2.2 speaks so; update it)" if "TransformStamped" in kinds[topic] else ""
            found.append(f"{topic} is a {kinds[topic]} instead of a {kind}{older}")
    return found


def command_topics(config: RobotConfig, arm: ArmConfig) -> list[str]:
    """Every topic by which an arm can be moved."""
    return [config.topic(f"{arm.name}/{name}") for name in (*MOVING_TOPICS, *FORCING_TOPICS)]


def pressed(joy: Received[Joy] | None) -> bool:
    """Whether a pedal or button is held down; 2 is a quick tap that is over."""
    return joy is not None and bool(joy.message.buttons) and joy.message.buttons[0] == 1


def _shift_and_turn(base: Array, first: Array) -> tuple[float, float]:
    shift = float(np.linalg.norm(base[:3, 3] - first[:3, 3]))
    return shift, math.acos(min(max((float(np.trace(base[:3, :3].T @ first[:3, :3])) - 1.0) / 2.0, -1.0), 1.0))


def _age(sample: Sample[Any], now: float) -> str:
    age = now - sample.good.taken if sample.good is not None else math.inf
    return f"{age * 1e3:.0f} ms" if age < 1.0 else f"{age:.1f} s"


def distance_to_path(point: Array, path: Array) -> float:
    """From `point` (3,) to the polyline `path` (N, 3) [m]."""
    if len(path) == 1:
        return float(np.linalg.norm(point - path[0]))
    start, step = path[:-1], np.diff(path, axis=0)
    along = np.einsum("ij,ij->i", point - start, step) / np.maximum(np.einsum("ij,ij->i", step, step), 1e-18)
    nearest = start + np.clip(along, 0.0, 1.0)[:, None] * step
    return float(np.linalg.norm(point - nearest, axis=1).min())
