"""The page of the fault experiment: docs/faults.md, from its rows alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

# Faults that nobody can or need notice, in all phases or in some, and why.
NO_COMMAND = "it shows at the next command; where none is sent, nothing is rejected or lost, and nothing moves"
NO_TRAJECTORY = (
    "only a motion that the robot makes by itself, here that of the jaw, can be hindered; in these phases none is under way"
)
CLOCK = "ages are told by when a message was received; a clock that jumps ahead makes nothing look young"
REASONS: Mapping[str, str] = {
    "not_ready": NO_COMMAND,
    "lost_commands": NO_COMMAND,
    "ik_failure": NO_COMMAND,
    "frozen": "an arm at rest that tells the same numbers is what is expected; it shows when the arm is sent elsewhere",
    "foreign_servo": "the arm is not asked to hold still by its setpoint until its own motion is over",
    "jaw_blocked": NO_TRAJECTORY,
    "interrupt": NO_TRAJECTORY,
    "busy_pulse": "it is over before the next look, and nothing has moved",
    "jaw_slips": "it shows by the tension alone: to the test of the grasp, which is left out here, and to the exposure, which then "
    "ends with code ok; while tissue is cut or judged nobody looks for it",
    "jaw_stale_goal": "it shows at the robot's own moves of the arm, of which the driver makes none",
    "latched_error": "an old text is told to who connects later; nothing is judged by a text alone",
    "clock_ahead": CLOCK,
    "clock_behind": CLOCK,
    "skewed_stamps": "50 ms of skew at 30 pictures a second: the next picture of the other eye is within `max_skew`, and pairs are formed",
    "zero_k": "a calibration is read once, before the session, where an empty one is refused; what comes later is not used",
}
HEAD = """\
# Faults of a robot, phase by phase

Every fault that the served stub can show (`hardware/served/faults.py`), and those of the graph itself, in every phase of a session: what
holds the arms, how soon, and how the session goes on. Written by

```
python -m supervisor.experiments.faults --json faults.json --markdown docs/faults.md
```

in which the real driver, safety gate, tree and deadman work over a graph within one process, with bench time only, so the figures are the
same each time. The session is light: the motions are those of the skills, under the same lease, but the tissue's place is known, nothing
is looked at, and the test of the grasp is left out. It is led to a phase and split there, so each fault befalls the same moment.
**None of this ran on a robot**, and a network and a busy computer come on top; [dvrk.md](dvrk.md) has what was measured over real
processes.

- **noticed**: from the fault to the first code, in the record as in the table.
- **last command**: from the fault to the last motion command on the graph under the lease that was alive; `-`: none came after it.
- **hold**: from the fault until both arms had been told to hold; `-`: nothing was under way, and nothing was sent. A hold may come again.
- **after**: motion commands under that lease after the hold of their arm. There must be none.
- **next step**: motion commands of a later step while the fault was still there. Where a motion fails by its own rule, its step ends in
  hold and the session looks again, as it would after any motion that did not arrive; a robot that still does not obey fails that step too.
- **drift**: how far a tip still went after the hold [mm]: what the robot had under way, a power cut, or somebody else.
"""


AGAIN = """\
The fault was still there (an interrupt is over at once), and known by the failed motion alone: the session took it for a motion that
did not arrive, and its next step moved the arms again. That goes against "no command after it", and weighs most where somebody else
drove the arm:"""


def page(rows: Sequence[Mapping[str, Any]]) -> str:
    """The page in Markdown."""
    noticed = [row for row in rows if row["noticed"] is not None]
    bad = [row for row in rows if row["verdict"] == "not held"]
    parts = [HEAD, "## Summary", "", *_summary(rows), "", "## Not held", ""]
    if bad:
        parts += [f"- **{row['fault']}**, {row['phase']}: {_trouble(row)}" for row in bad]
    else:
        parts.append("None: where a fault was noticed, both arms held, and the step that was going on sent nothing after it.")
    again = [row for row in noticed if row["next_step"]]
    if again:
        parts += ["", "## Held, and commanded anew by the next step", "", AGAIN, ""]
        parts += [
            f"- {row['fault']}, {row['phase']}: {row['next_step']} commands, {row['code']}; {row['outcome']}" for row in again
        ]
    moved = [row for row in noticed if row["drift"] > 1e-3]
    if moved:
        parts += ["", "## Held, and moved all the same", "", "By more than 1 mm after the hold; a `hold` is one message:", ""]
        parts += [f"- {row['fault']}, {row['phase']}: {row['drift'] * 1e3:.1f} mm, {row['outcome']}" for row in moved]
    parts += ["", "## Not noticed", "", *_unnoticed(rows)]
    for phase in dict.fromkeys(row["phase"] for row in rows):
        parts += ["", f"## {phase.capitalize()}", "", *_table([row for row in rows if row["phase"] == phase])]
    return "\n".join(parts) + "\n"


def _summary(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    lines = [
        "| phase | faults | held | of these, commanded anew | at rest | not noticed | not held | slowest hold (ms) | commands after |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for phase in dict.fromkeys(row["phase"] for row in rows):
        here = [row for row in rows if row["phase"] == phase]
        counts = [sum(row["verdict"] == verdict for row in here) for verdict in ("held", "at rest", "not noticed", "not held")]
        counts.insert(1, sum(row["verdict"] == "held" and row["next_step"] > 0 for row in here))
        slowest = max((row for row in here if row["verdict"] == "held"), key=lambda row: row["held"], default=None)
        what = "-" if slowest is None else f"{slowest['held'] * 1e3:.0f} ({slowest['fault']})"
        after = sum(row["after_hold"] for row in here)
        lines.append(f"| {phase} | {len(here)} | {' | '.join(map(str, counts))} | {what} | {after} |")
    return lines


def _unnoticed(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    lines = ["| fault | phases | why |", "| --- | --- | --- |"]
    quiet = [row for row in rows if row["verdict"] == "not noticed"]
    for fault in dict.fromkeys(row["fault"] for row in quiet):
        phases = ", ".join(row["phase"] for row in quiet if row["fault"] == fault)
        lines.append(f"| {fault} | {phases} | {REASONS.get(fault) or '**not explained: a finding**'} |")
    return lines if quiet else ["Every fault was noticed."]


def _trouble(row: Mapping[str, Any]) -> str:
    hold = "the arms were not both told to hold" if row["held"] is None else f"held after {row['held'] * 1e3:.0f} ms"
    return f"{hold}, {row['after_hold']} commands after it; {row['message'] or 'no message'}; {row['outcome']}"


def _table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    lines = [
        "| fault | code | noticed (ms) | last command (ms) | hold (ms) | after | next step | drift (mm) | outcome |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in rows:
        keys = ("noticed", "last_command", "held") if row["noticed"] is not None else ("noticed",) * 3
        times = " | ".join("-" if row[key] is None else f"{row[key] * 1e3:.0f}" for key in keys)
        code = row["code"] or row["verdict"]
        counts = f"{row['after_hold']} | {row['next_step']} | {row['drift'] * 1e3:.1f}"
        lines.append(f"| {row['fault']} | {code} | {times} | {counts} | {row['outcome']} |")
    return lines
