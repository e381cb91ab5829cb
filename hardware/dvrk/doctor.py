"""What `dissect doctor --bench dvrk` tells of a robot: what is connected, how well its data come, and what would block a session."""

from __future__ import annotations

from dataclasses import dataclass

from hardware.codes import InputError
from hardware.dvrk.arm import ArmDVRK
from hardware.dvrk.bench import BenchDVRK
from hardware.dvrk.deadman import HOLDING, IDLE, WATCHING

LISTEN = 2.0  # [s] before anything is told
RATE = 50.0  # [Hz] that telemetry should at least come with


@dataclass(frozen=True)
class Finding:
    """One line: `required` ones that are not ok block a session."""

    name: str
    ok: bool
    detail: str
    remedy: str = ""
    required: bool = True


def examine(bench: BenchDVRK) -> list[Finding]:
    """Listen for a while, then tell; commands nothing."""
    bench.advance(LISTEN)
    findings = [_deadman(bench)]
    for arm in bench.arms.values():
        findings += [_state(arm), _instrument(arm), _frame(arm), _rates(arm)]
    findings += [_calibration(bench), _camera(bench), _console(bench)]
    blockers = bench.blockers(armed=False)
    return [*findings, *(Finding("blocks a session", False, sentence) for sentence in blockers)]


def _deadman(bench: BenchDVRK) -> Finding:
    state = bench.deadman
    remedy = "" if state in (IDLE, WATCHING) else "Start it beside the robot: python -m hardware.dvrk.deadman"
    if state.startswith(HOLDING):
        remedy = "Find out why; then end it with Ctrl-C and start it anew."
    return Finding("deadman", not remedy, state or "not running", remedy)


def _state(arm: ArmDVRK) -> Finding:
    state = arm.readings.state
    if state is None:
        return Finding(
            f"{arm.config.called} state", False, "not told", "Start the robot's node, or correct the arm's name or the prefix."
        )
    message = state.message
    said = f"{message.state.lower()}, {'homed' if message.is_homed else 'not homed'}{', busy' if message.is_busy else ''}"
    # A session enables and homes by itself.
    return Finding(
        f"{arm.config.called} state", message.state != "FAULT", said, "" if message.state != "FAULT" else "Clear the fault."
    )


def _instrument(arm: ArmDVRK) -> Finding:
    found, expected = arm.readings.tool_type, arm.config.tool_type
    name = f"{arm.config.called} instrument"
    if found == expected:
        return Finding(name, True, found)
    if not found:
        return Finding(name, False, "none engaged yet", f"{expected} is expected once the arm is homed.", required=False)
    return Finding(name, False, found, f"The configuration says {expected}: change the instrument or tool_type.")


def _frame(arm: ArmDVRK) -> Finding:
    good, name = arm.readings.cp.good, f"{arm.config.called} frame"
    if good is None:
        return Finding(
            name, False, "no valid pose yet", "The robot tells one once it is enabled, homed, and holds a tool.", required=False
        )
    found = good.message.frame_id
    remedy = (
        "" if found == arm.config.frame_id else f"The configuration says {arm.config.frame_id}: correct the one that is wrong."
    )
    return Finding(name, not remedy, found or "(no name)", remedy)


def _rates(arm: ArmDVRK) -> Finding:
    figures = arm.figures()
    slowest = min(figures, key=lambda one: one.rate)
    latest = max(figures, key=lambda one: one.longest_gap)
    said = (
        f"at least {slowest.rate:.0f} Hz, longest silence {latest.longest_gap * 1e3:.0f} ms, "
        f"{sum(one.dropped for one in figures)} lost, {sum(one.invalid for one in figures)} invalid"
    )
    ok = slowest.rate >= RATE
    return Finding(
        f"{arm.config.called} data",
        ok,
        said,
        "" if ok else f"{slowest.topic} should come with {RATE:.0f} Hz or more.",
        required=False,
    )


def _calibration(bench: BenchDVRK) -> Finding:
    return Finding("calibration", True, bench.calibration())


def _camera(bench: BenchDVRK) -> Finding:
    try:
        camera = bench.endoscope.camera
    except InputError as error:
        return Finding("endoscope", False, str(error), "Start the cameras' nodes with their calibration.")
    rates = " and ".join(f"{one.rate:.0f} Hz" for one in bench.endoscope.figures())
    age = bench.now() - bench.endoscope.stamp()
    said = (
        f"{camera.width} x {camera.height}, baseline {camera.baseline * 1e3:.1f} mm, {rates}, newest pair {age * 1e3:.0f} ms old"
    )
    return Finding(
        "endoscope", age <= bench.config.camera.max_age, said, "" if age <= bench.config.camera.max_age else "No fresh pairs."
    )


def _console(bench: BenchDVRK) -> Finding:
    verdict = bench.console.verdict()
    return Finding("console", verdict.ok, verdict.message or "teleoperation off, operator as wanted")
