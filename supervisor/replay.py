"""A recorded session as a time line for the terminal: one line for each thing that happened, in bench time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rich.text import Text

from supervisor import topics
from supervisor.history import attempts, commands_sent, ending, is_guard, leaves, max_attempts, refused
from supervisor.palette import STATUS, STATUS_SIGN
from supervisor.reading import SessionRecord

TONES = {"good": "bold #2e8b57", "fair": "bold #c98a1b", "bad": "bold #c8372d"}


@dataclass(frozen=True)
class _Line:
    """One line at bench time `stamp` [s]; `order` keeps causes before effects at one stamp."""

    stamp: float
    order: int
    text: Text


def timeline(record: SessionRecord) -> list[Text]:
    """Tell the session line by line: what it was, what happened, how it ended (or that it was never closed)."""
    lines = sorted([*_tree(record), *_refusals(record), *_events(record)], key=lambda line: (line.stamp, line.order))
    stamped = [Text.assemble((f"{line.stamp:8.2f} s  ", "dim"), line.text) for line in lines]
    return [*_heading(record), Text(""), *stamped, Text(""), *_ending(record)]


def _heading(record: SessionRecord) -> list[Text]:
    h = record.header
    about = [f"{key} {h[key]}" for key in ("bench", "scene", "agent", "exposure", "seed") if h.get(key) is not None]
    return [Text.assemble(("Session ", "bold"), (record.folder.resolve().name, "bold"), ("   " + ", ".join(about), "dim"))]


def _tree(record: SessionRecord) -> list[_Line]:
    """Changes of status of the root and the leaves; a guard's only when it does not hold or holds again."""
    leaf_paths = {node["path"] for node in leaves(record)}
    lines = []
    for entry in record.topic(topics.TREE):
        change = entry.payload
        path, status = change["path"], change["status"]
        at_root = "/" not in path
        routine_guard = is_guard(path) and "INVALID" in (status, change["old"]) and status != "FAILURE"
        cleared = status == "INVALID" and change["old"] != "RUNNING"
        if not (at_root or path in leaf_paths) or routine_guard or cleared:
            continue
        order = 3 if status == "RUNNING" else 2  # what ends does so before what it makes way for
        said = "interrupted" if status == "INVALID" else status.lower()
        text = Text.assemble(
            (f"{STATUS_SIGN.get(status, '?')} ", STATUS.get(status, "")),
            (change["name"], "bold" if at_root else ""),
            (f" {said}", STATUS.get(status, "")),
            (f"  {change['message']}" if change["message"] else "", "dim"),
        )
        lines.append(_Line(entry.stamp, order, text))
    return lines


def _refusals(record: SessionRecord) -> list[_Line]:
    lines = []
    for r in refused(record):
        times = "" if r.times == 1 else f" {r.times} times until {r.end:.2f} s"
        text = Text.assemble(("✋ ", "#c98a1b"), (f"{r.arm} {r.command} refused{times}", "#c98a1b"), f" ({r.code}): {r.message}")
        lines.append(_Line(r.start, 4, text))
    return lines


def _events(record: SessionRecord) -> list[_Line]:
    """Attempts, approvals, interruptions, estimates, plans, the truth where the bench knows it, and the session's own log."""
    most = max_attempts(record)
    lines = [_Line(a.start, 0, Text(f"── attempt {a.number} of {most} ──", style="bold")) for a in attempts(record)]
    lines += [_Line(entry.stamp, 1, Text(f"✎ {_approval(entry.payload)}")) for entry in record.topic(topics.APPROVAL)]
    for entry in record.topic(topics.INTERRUPTION):
        lines.append(_Line(entry.stamp, 1, Text("⚠ interrupted: what was known is looked at again", style="#c98a1b")))
    for entry in record.topic(topics.RECOVERY):
        p = entry.payload
        lines.append(
            _Line(entry.stamp, 5, Text(f"↻ after {p.get('code')} in {p.get('step')}: {p.get('recovery')}", style="#c98a1b"))
        )
    for entry in record.topic(topics.PLAN):
        lines.append(_Line(entry.stamp, 5, Text(f"✂ plan: {entry.payload.get('message', '')}")))
    for entry in record.topic(topics.GRAPH):
        p = entry.payload
        left = "attachments unknown" if p["attachments"] is None else _count(p["attachments"], "attachment") + " left"
        lines.append(_Line(entry.stamp, 5, Text(f"◈ estimate: {left}. {p['message']}")))
    for entry in record.topic(topics.TRUTH):
        p = entry.payload
        said = [f"{_count(p['attachments'], 'attachment')} left"] if p.get("attachments") is not None else []
        if p.get("effective_cut_ratio") is not None:
            said.append(f"{100 * p['effective_cut_ratio']:.0f} % of the goal severed")
        if p.get("length_deviation_m") is not None:
            said.append(f"deviation {1e3 * p['length_deviation_m']:.1f} mm")
        lines.append(_Line(entry.stamp, 6, Text("◇ truth of the bench: " + ", ".join(said), style="dim")))
    lines += [_Line(entry.stamp, 7, Text(entry.payload["text"], style="dim")) for entry in record.topic(topics.LOG)]
    return lines


def _approval(p: dict[str, Any]) -> str:
    """Say what became of one question to the operator."""
    what = f"{p.get('kind', 'goal')} {p.get('goal_id', '?')}"
    why = str(p.get("comment") or p.get("message") or "")
    match p.get("event", "approved"):
        case "asked":
            return f"the operator is asked for {what}: {p.get('reason', '')}"
        case "approved":
            return f"{what} approved by {p.get('by', '?')}" + (f": {why}" if why else "")
        case "refused":
            return f"{what} refused by {p.get('by', '?')}" + (f": {why}" if why else "")
        case event:
            return f"{what} {event}" + (f": {why}" if why else "")


def _ending(record: SessionRecord) -> list[Text]:
    """The outcome, the sums, and plainly whether the session was closed."""
    end = ending(record)
    number = len(attempts(record))
    times = sum(r.times for r in refused(record))
    sums = (
        f"{_count(number, 'attempt')}, {commands_sent(record)} commands sent, {times} refused, {record.end:.1f} s of bench time"
    )
    lines = [Text.assemble((end.headline, TONES[end.tone]), (f"  {end.sentence}", "")), Text(sums, style="dim")]
    if not record.closed:
        what = (
            "all that was flushed before is shown"
            if not record.whole
            else "its record is whole, but its last page was not written"
        )
        lines.append(Text(f"NOT CLOSED: {what}. Go on with `dissect resume`.", style=TONES["bad"]))
    return lines


def _count(number: int, noun: str) -> str:
    return f"{number or 'no'} {noun}" + ("" if number == 1 else "s")
