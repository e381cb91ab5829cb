"""The page of the fault experiment: docs/faults.md, from its rows alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from supervisor.experiments.faults_reasons import REASONS, TOLERATED, UNEXPLAINED, reasons
from supervisor.experiments.faults_whole_page import whole_page

# What the robot does with its commands leaves no trace before the next one.
BY_COMMAND = ("not_ready", "lost_commands", "ik_failure")
HEAD = """\
# Faults of a robot, phase by phase

Every fault that the served stub can show (`hardware/served/faults.py`), and those of the graph itself, in every phase of a session: what
holds the arms, how soon, and how the session goes on. Written by

```
python -m supervisor.experiments.faults --json faults.json --markdown docs/faults.md
```

in which the real driver, safety gate, tree and deadman work over a graph within one process, with bench time only, so the figures are the
same each time. A session is led to a phase and split there, so each fault befalls the same moment. It is done twice: with a light
session, whose motions are those of the skills, under the same lease, but the tissue's place is known, nothing is looked at, and the
test of the grasp is left out; and with a [whole one](#whole-sessions), which is recorded, and its record read back.
**None of this ran on a robot**, and a network and a busy computer come on top; [dvrk.md](dvrk.md) has what was measured over real
processes.

- **noticed**: from the fault to the first code, in the record as in the table.
- **last command**: from the fault to the last motion command on the graph under the lease that was alive; `-`: none came after it.
- **hold**: from the fault until both arms had been told to hold; `-`: nothing was under way, and nothing was sent. A hold may come again.
- **after**: motion commands under that lease after the hold of their arm. There must be none.
- **next step**: motion commands of a later step while the fault was still there (one that happens once: until all guards were content
  again). There must be none.
- **drift**: how far a tip still went after the hold [mm]: what the robot had under way, a power cut, or somebody else.

A fault is **held** when both arms were told to hold and the step that was going on sent nothing after it; **at rest** when nothing was
under way and nothing was sent; **tolerated** when it does no harm by the rules of the robot, nobody need notice it, and the step that was
under way came to its end with code ok.

## What follows a motion that failed

A robot that swallows a command (it is not ready though it says so, the command is lost, no inverse kinematics are found) leaves no
trace of it: it goes on to say that it is enabled, homed and not busy, and only another command could tell when it obeys again. So the first
swallowed command ends the session, with `not_obeyed`: a streamed setpoint is missed after 100 ms, and judged 300 ms after the last one
was sent; a motion of the jaw after 0.5 s. Nothing is tried again. Where the fault comes while nothing is sent, the time to notice it
counts from the fault all the same.

Any other motion that failed by its own rule (it was broken off, or did not arrive) stands as a reason of its own: both arms hold, the
procedure is interrupted, and nothing is sent before the arm has been quiet for 1 s: not busy, its setpoint where it was sent, tip and jaw
beside theirs, data fresh, and no motion of anybody else's. Then the session looks again. Jaws that something keeps open are not quiet, so
they wait for a person. The second failure in a row of the same part ends the session with `not_obeyed`.

Where somebody else drives an arm, that arm is held, and then paused: a hold does not keep it from the next command, and a paused arm
takes none, from nobody. The deadman is asked to hold both arms until it is armed anew. The next session's checklist resumes the arm.
"""


SLOW = 0.3  # [s]
VERDICTS = ("held", "at rest", "tolerated", "not noticed", "not held")
# Why a fault takes longer.
TAKES: Mapping[str, str] = {
    "foreign_commands": "ours took the place of each of its commands at once, and the master is asked every 0.5 s who else may command",
    **dict.fromkeys(BY_COMMAND, "the robot went on with what it had taken before; it shows at the next command"),
    "jaw_blocked": "the jaw's motion, which may have come later, had time to its end",
}


def page(rows: Sequence[Mapping[str, Any]], whole: Sequence[Mapping[str, Any]] = ()) -> str:
    """The page in Markdown: of light sessions, `rows`, and of whole ones."""
    noticed = [row for row in rows if row["noticed"] is not None]
    bad = [row for row in rows if row["verdict"] == "not held"]
    parts = [HEAD, "## Summary", "", *_summary(rows), "", "## Not held", ""]
    if bad:
        parts += [f"- **{row['fault']}**, {row['phase']}: {_trouble(row)}" for row in bad]
    else:
        parts.append("None: where a fault was noticed, both arms held, and the step that was going on sent nothing after it.")
    again = [row for row in noticed if row["next_step"]]
    if again:
        parts += [
            "",
            "## Held, and commanded anew by the next step",
            "",
            "Against the rule, while the fault was still there:",
            "",
        ]
        parts += [
            f"- {row['fault']}, {row['phase']}: {row['next_step']} commands, {row['code']}; {row['outcome']}" for row in again
        ]
    slow = [row for row in noticed if row["held"] is not None and row["held"] > SLOW]
    if slow:
        parts += ["", "## Slow", "", f"Held later than {SLOW * 1e3:.0f} ms after the fault:", ""]
        parts += [f"- {row['fault']}, {row['phase']}: {row['held'] * 1e3:.0f} ms; {_late(row)}" for row in slow]
    moved = [row for row in noticed if row["drift"] > 1e-3]
    if moved:
        parts += [
            "",
            "## Held, and moved all the same",
            "",
            "By more than 1 mm after the hold. An arm whose clutch is pressed is limp, in somebody's hand:",
            "",
        ]
        parts += [f"- {row['fault']}, {row['phase']}: {row['drift'] * 1e3:.1f} mm, {row['outcome']}" for row in moved]
    parts += ["", "## Tolerated", "", *reasons(rows, "tolerated", TOLERATED)]
    parts += ["", "## Not noticed", "", *reasons(rows, "not noticed", REASONS)]
    for phase in dict.fromkeys(row["phase"] for row in rows):
        parts += ["", f"## {phase.capitalize()}", "", *_table([row for row in rows if row["phase"] == phase])]
    if whole:
        parts += ["", *whole_page(rows, whole)]
    return "\n".join(parts) + "\n"


def _summary(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    titles = ("phase", "faults", "held", "of these, commanded anew", *VERDICTS[1:], "slowest hold (ms)", "commands after")
    lines = [f"| {' | '.join(titles)} |", "| --- " * len(titles) + "|"]
    for phase in dict.fromkeys(row["phase"] for row in rows):
        here = [row for row in rows if row["phase"] == phase]
        counts = [sum(row["verdict"] == verdict for row in here) for verdict in VERDICTS]
        counts.insert(1, sum(row["verdict"] == "held" and row["next_step"] > 0 for row in here))
        slowest = max((row for row in here if row["verdict"] == "held"), key=lambda row: row["held"], default=None)
        what = "-" if slowest is None else f"{slowest['held'] * 1e3:.0f} ({slowest['fault']})"
        after = sum(row["after_hold"] for row in here)
        lines.append(f"| {phase} | {len(here)} | {' | '.join(map(str, counts))} | {what} | {after} |")
    return lines


def _late(row: Mapping[str, Any]) -> str:
    return TAKES.get(row["fault"], UNEXPLAINED)


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
        counts = (
            f"{row['after_hold']} | {row['next_step']} | {row['drift'] * 1e3:.1f}" if row["noticed"] is not None else "- | - | -"
        )
        lines.append(f"| {row['fault']} | {code} | {times} | {counts} | {row['outcome']} |")
    return lines
