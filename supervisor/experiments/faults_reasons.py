"""Why a fault that nobody noticed does no harm, or why nobody could notice it: what the page of the fault experiment says of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

UNEXPLAINED = "**not explained: a finding**"
# Faults that do no harm where nobody noticed them, and why to hold would be wrong.
NO_TRAJECTORY = (
    "only a motion that the robot makes by itself, here that of the jaw, can be hindered; in these phases none is under way, "
    "and the arm does all that it is told"
)
TOLERATED: Mapping[str, str] = {
    "jaw_blocked": NO_TRAJECTORY,
    "interrupt": NO_TRAJECTORY,
    "busy_pulse": "a robot is busy for a moment for many reasons, and tells so again when asked for its state: no motion of ours ends "
    "by it (2.4, trap 2), and a motion of somebody else's shows by the setpoint",
    "jaw_slips": "the arm and its jaw do as they are told: it is the tissue that is gone. What it does to a session is said "
    "[below](#where-the-session-goes-on)",
    "jaw_stale_goal": "it shows at the robot's own moves of the arm, of which the driver makes none (7.7); a jaw whose setpoint moved all "
    "the same would end the session with foreign_motion",
    "latched_error": "an old text is told to who connects later; nothing is judged by a text alone (1.1)",
}
# Faults that nobody can know of, and why.
NO_COMMAND = (
    "it shows at the next command of that arm; here none is sent to it any more, nothing is rejected or lost, and nothing moves"
)
REASONS: Mapping[str, str] = {"not_ready": NO_COMMAND, "lost_commands": NO_COMMAND, "ik_failure": NO_COMMAND}


def reasons(rows: Sequence[Mapping[str, Any]], verdict: str, why: Mapping[str, str]) -> list[str]:
    """A table of the faults that were `verdict`, with the phases and the reason; what has none is a finding."""
    lines = ["| fault | phases | why |", "| --- | --- | --- |"]
    quiet = [row for row in rows if row["verdict"] == verdict]
    for fault in dict.fromkeys(row["fault"] for row in quiet):
        phases = ", ".join(row["phase"] for row in quiet if row["fault"] == fault)
        lines.append(f"| {fault} | {phases} | {why.get(fault) or UNEXPLAINED} |")
    return lines if quiet else ["None."]
