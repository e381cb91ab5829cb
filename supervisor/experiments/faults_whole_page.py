"""The part of docs/faults.md about whole sessions: what their records say, and where they went another way than the light ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from supervisor.experiments.faults_reasons import REASONS, TOLERATED, UNEXPLAINED, reasons
from supervisor.experiments.faults_watch import GOES_ON

Rows = Sequence[Mapping[str, Any]]

SOON = 0.1  # [s] by which two sessions may notice apart and still be called the same
HEAD = """\
## Whole sessions

The same faults, with the session of `dissect run` on a small sheet of silicone: tree, guards, recorder, and the real skills, which see the
served pictures, track, plan, cut, pull (along the goal's normal) and judge. Without a fault it ends `complete`. The record of each is its
own and is read back from its file. A session of its own, never split, gives the same row to the last digit (a test holds it to that).

- **noticed**, **held**: as above, by bench time.
- **after**: motion commands of any step that went out later than the fault was noticed, while it lasted. There must be none.
- **recorded**: the code of the outcome, as `session.json` has it. `aborted` is a session that waited, and was interrupted by its user
  when enough was seen: after the fault was cleared and the arms were given to the next step, or stayed held for 2.5 s. One that goes on
  is followed to its end.
- **coded**: where in the record the code that was noticed stands.

The estimate of this short goal would be made within one tick, and the session over two ticks later, before most faults can show. So it is
told 1 s later here, as on a robot, where it is made beside the ticks. Tissue that slips from the jaws (jaw_slips) is always that of the
grasper; in the phase of the grasp it slips as the test of the grasp begins, when it is held.
"""

SLIPPED = """\
Tissue that slips out is no fault of the robot: arm and jaw do as they are told. It shows by the tissue. In a pull the tension falls, and
the pull ends by `grasp_slipped`; while cutting, the goal springs out of sight, and the session looks again. Lost in the test of the
grasp it is noticed by the mean force after each test pull (15 of 600 empty grasps pass), and the tissue is grasped anew. **Lost in the
retraction it is not noticed**: a pull knows of a slip only after 0.5 N.
Then, and after a slip while cutting, slack tissue is cut and the empty jaws are pulled all the way, in each attempt that is left. What
does not open is not called severed, so such a session errs to the safe side: it ends `attempts_used`, with one strand left or none."""


def whole_page(light: Rows, whole: Rows) -> list[str]:
    """Its lines: a summary, what went another way than in the `light` session, and a table for each phase."""
    left_out = dict.fromkeys(row["fault"] for row in light if row["fault"] not in {one["fault"] for one in whole})
    told = ["", f"Not run with a whole session: {', '.join(left_out)}."] if left_out else []
    lines = [*HEAD.splitlines(), *told, "", *_summary(whole), "", "### Without a code in the record", "", *_uncoded(whole)]
    lines += ["", "### Where the session goes on", "", *_going_on(whole), "", *SLIPPED.splitlines()]
    lines += ["", "### Not noticed in a whole session", "", *reasons(whole, "not noticed", REASONS)]
    lines += ["", "### Unlike the light session", "", *_unlike(light, whole)]
    for phase in dict.fromkeys(row["phase"] for row in whole):
        lines += ["", f"### Whole: {phase}", "", *_table([row for row in whole if row["phase"] == phase])]
    return lines


def _summary(rows: Rows) -> list[str]:
    titles = (
        "phase",
        "faults",
        "held",
        "at rest",
        "tolerated",
        "not noticed",
        "not held",
        "slowest hold (ms)",
        "after",
        "no code",
    )
    lines = [f"| {' | '.join(titles)} |", "| --- " * len(titles) + "|"]
    for phase in dict.fromkeys(row["phase"] for row in rows):
        here = [row for row in rows if row["phase"] == phase]
        counts = [sum(row["verdict"] == verdict for row in here) for verdict in titles[2:7]]
        slowest = max(
            (row for row in here if row["held"] and row["verdict"] == "held"), key=lambda row: row["held"], default=None
        )
        what = "-" if slowest is None else f"{slowest['held'] * 1e3:.0f} ({slowest['fault']})"
        after = sum(row["after_noticed"] for row in here)
        uncoded = sum(row["noticed"] is not None and not row["coded"] for row in here)
        lines.append(f"| {phase} | {len(here)} | {' | '.join(map(str, counts))} | {what} | {after} | {uncoded} |")
    return lines


def _uncoded(rows: Rows) -> list[str]:
    bare = [row for row in rows if row["noticed"] is not None and not row["coded"]]
    if not bare:
        return ["None."]
    lines = []
    for phase in dict.fromkeys(row["phase"] for row in bare):
        said = [f"{row['fault']} ({row['code']})" for row in bare if row["phase"] == phase]
        lines.append(f"- {phase}: {', '.join(said)}")
    return lines


def _going_on(rows: Rows) -> list[str]:
    """What came of faults that nobody noticed, or that only ended a step: the same ends in one line."""
    lines = [
        "| fault | phases | verdict | later pulls ended by | session | strands left | why it is tolerated |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    ends: dict[tuple[str, ...], list[str]] = {}
    for row in rows:
        if row["verdict"] in ("tolerated", "not noticed") or row["outcome"].startswith(GOES_ON):
            verdict = row["verdict"] + (f", {row['code']}" if row["code"] else "")
            pulls = ", ".join(row["exposures"]) or "-"
            end = (row["fault"], verdict, pulls, row["recorded"], str(row["attachments"]))
            ends.setdefault(end, []).append(row["phase"])
    for (fault, verdict, pulls, recorded, left), phases in sorted(ends.items(), key=lambda one: one[0][0]):
        why = _why(fault) if verdict == "tolerated" else "-"
        lines.append(f"| {fault} | {', '.join(phases)} | {verdict} | {pulls} | {recorded} | {left} | {why} |")
    return lines


def _why(fault: str) -> str:
    return "below" if fault == "jaw_slips" else TOLERATED.get(fault, UNEXPLAINED)


def _unlike(light: Rows, whole: Rows) -> list[str]:
    others = {(row["fault"], row["phase"]): row for row in light}
    lines = []
    for row in whole:
        other = others.get((row["fault"], row["phase"]))
        if other is not None and (said := _differences(other, row)):
            lines.append(f"- {row['fault']}, {row['phase']}: {said}")
    return lines or ["Nothing: the same codes and verdicts, the same ends, and the same times to a tenth of a second."]


def _differences(light: Mapping[str, Any], whole: Mapping[str, Any]) -> str:
    found = []
    for name in ("verdict", "code"):
        if light[name] != whole[name]:
            found.append(f"{name} {whole[name] or 'none'}, light {light[name] or 'none'}")
    quiet = {"tolerated", "not noticed"}
    if light["outcome"] != whole["outcome"] and not {light["verdict"], whole["verdict"]} <= quiet:
        found.append(f"{whole['outcome']}; light {light['outcome']}")
    if light["noticed"] is not None and whole["noticed"] is not None and abs(light["noticed"] - whole["noticed"]) > SOON:
        found.append(f"noticed after {whole['noticed'] * 1e3:.0f} ms, light {light['noticed'] * 1e3:.0f} ms")
    return "; ".join(found)


def _table(rows: Rows) -> list[str]:
    titles = ("fault", "code", "noticed (ms)", "held (ms)", "after", "session", "recorded", "coded")
    lines = [f"| {' | '.join(titles)} |", "| --- " * len(titles) + "|"]
    for row in rows:
        noticed = row["noticed"] is not None
        times = [f"{row[key] * 1e3:.0f}" if noticed and row[key] is not None else "-" for key in ("noticed", "held")]
        cells = [row["fault"], row["code"] or row["verdict"], *times, f"{row['after_noticed']}" if noticed else "-"]
        coded = ", ".join(topic.strip("/") for topic in row["coded"]) if noticed else "-"
        cells += [row["outcome"], row["recorded"] + ("" if row["closed"] else " (not closed)"), coded or "**no**"]
        lines.append(f"| {' | '.join(cells)} |")
    return lines
