"""What happened in a recorded session, put in order: who ran when, what was refused, what each attempt left."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from hardware.codes import LATCHED, Code
from hardware.interface import CUTTER
from skills.estimate.graph import EdgeState
from supervisor import topics
from supervisor.reading import Entry, SessionRecord

GUARDS = "guards"
TOGETHER = 1.0  # [s]; refusals of one kind closer than this are told as one
STOPPED = {Code.ABORTED, Code.INTERNAL_ERROR, *LATCHED}


@dataclass(frozen=True)
class Interval:
    """A node was RUNNING from `start` to `end` [s] and then `status` (RUNNING: the record ends before it did)."""

    path: str
    name: str
    start: float
    end: float
    status: str
    message: str


@dataclass(frozen=True)
class RefusedCommands:
    """`times` commands of one kind refused in a row, from `start` to `end` [s]."""

    start: float
    end: float
    holder: str
    arm: str
    command: str
    code: str
    message: str
    times: int


@dataclass(frozen=True)
class AttemptSummary:
    """One attempt: when [s], what the estimate said (None: there was none), and the truth where the bench knows it."""

    number: int
    start: float
    end: float
    attachments: int | None
    severed: int
    connected: int
    unknown: int
    estimate: str
    truth: dict[str, Any]


@dataclass(frozen=True)
class ExposureSummary:
    """One pull of the tissue, in which attempt and when [s]; `message` and `stopped_by` are empty if it never came to its end.

    `series` are values by step, of those that the record holds, None where unknown: of the controller camera, deform, opening [px^2],
    expected_tension [N], separation [SD], agreement and feasible; measured tension [N] and strain. `area` [px] of the opened cut is the
    bench's truth at the end of the attempt, where this was its last exposure.
    """

    attempt: int
    start: float
    end: float
    steps: int
    message: str
    stopped_by: str
    series: dict[str, list[float | None]]
    area: float | None


@dataclass(frozen=True)
class Ending:
    """How the session ended: `tone` good, fair or bad; a headline and a sentence."""

    tone: str
    headline: str
    sentence: str


def structure(record: SessionRecord) -> list[dict[str, Any]]:
    """All nodes the session had, in tree order: dicts with path, name, kind, depth."""
    nodes: dict[str, dict[str, Any]] = {}
    for entry in record.topic(topics.STRUCTURE):
        nodes.update({node["path"]: node for node in entry.payload["nodes"]})
    return list(nodes.values())


def leaves(record: SessionRecord) -> list[dict[str, Any]]:
    """Nodes without children, in tree order."""
    nodes = structure(record)
    parents = {node["path"].rpartition("/")[0] for node in nodes}
    return [node for node in nodes if node["path"] not in parents]


def is_guard(path: str) -> bool:
    """Whether a node belongs to the guards."""
    return GUARDS in path.split("/")[:-1]


def intervals(record: SessionRecord) -> list[Interval]:
    """When each node was running, in order of start. A node that was done within one tick has `start == end`."""
    open_since: dict[str, float] = {}
    found: list[Interval] = []
    last: dict[str, dict[str, Any]] = {}
    for entry in record.topic(topics.TREE):
        change = entry.payload
        path, status = change["path"], change["status"]
        last[path] = change
        if status == "RUNNING":
            open_since[path] = entry.stamp
            continue
        start = open_since.pop(path, None)
        if start is not None or status in ("SUCCESS", "FAILURE"):
            start = entry.stamp if start is None else start
            found.append(Interval(path, change["name"], start, entry.stamp, status, change["message"]))
    for path, start in open_since.items():
        found.append(Interval(path, last[path]["name"], start, record.end, "RUNNING", last[path]["message"]))
    return sorted(found, key=lambda i: (i.start, i.end))


def refused(record: SessionRecord) -> list[RefusedCommands]:
    """Commands that the gate refused, those of one kind in a row as one."""
    groups: list[RefusedCommands] = []
    for entry in record.topic(topics.DECISIONS):
        d = entry.payload
        if d["accepted"]:
            continue
        last = groups[-1] if groups else None
        same = last and (last.holder, last.arm, last.command, last.code) == (d["holder"], d["arm"], d["command"], d["code"])
        if last and same and entry.stamp - last.end <= TOGETHER:
            start, times = last.start, last.times + 1
            groups.pop()
        else:
            start, times = entry.stamp, 1
        groups.append(RefusedCommands(start, entry.stamp, d["holder"], d["arm"], d["command"], d["code"], d["message"], times))
    return groups


def commands_sent(record: SessionRecord) -> int:
    """How many commands the gate let through."""
    return sum(bool(entry.payload["accepted"]) for entry in record.topic(topics.DECISIONS))


def snips(record: SessionRecord, closed: float = 0.2) -> int:
    """How often the scissors were told to close to at most `closed` [rad] after they had been open."""
    count, was_open = 0, False
    for entry in record.topic(topics.DECISIONS):
        d = entry.payload
        if d["command"] != "move_jaw" or d["arm"] != CUTTER or not d["accepted"] or not d["target"]:
            continue
        if d["target"][0] <= closed:
            count += was_open
            was_open = False
        else:
            was_open = True
    return count


def attempts(record: SessionRecord) -> list[AttemptSummary]:
    """Every attempt begun, in order."""
    starts: dict[int, float] = {}
    for entry in record.topic(topics.PROGRESS):
        if entry.payload["attempt"] > 0:
            starts.setdefault(entry.payload["attempt"], entry.stamp)
    truths = {entry.payload.get("attempt"): entry.payload for entry in record.topic(topics.TRUTH)}
    numbers = sorted(starts)
    found = []
    for k, number in enumerate(numbers):
        graphs = [g.payload for g in record.topic(topics.GRAPH) if g.payload.get("attempt") == number]
        graph = graphs[-1] if graphs else None
        found.append(
            AttemptSummary(
                number=number,
                start=starts[number],
                end=starts[numbers[k + 1]] if k + 1 < len(numbers) else record.end,
                attachments=graph["attachments"] if graph else None,
                severed=_crossing(graph, EdgeState.SEVERED),
                connected=_crossing(graph, EdgeState.CONNECTED),
                unknown=_crossing(graph, EdgeState.UNKNOWN),
                estimate=graph["message"] if graph else "",
                truth=truths.get(number, {}),
            )
        )
    return found


def exposures(record: SessionRecord) -> list[ExposureSummary]:
    """Every exposure that was begun, in order; records that are older than the controller hold but their ends."""
    planned: dict[int, list[Entry]] = {}
    for entry in record.topic(topics.EXPOSURE):
        planned.setdefault(entry.payload["exposure"], []).append(entry)
    told = list(record.topic(topics.EXPOSED))
    begun = list(planned.values())
    found = []
    for k, steps in enumerate(begun):
        until = begun[k + 1][0].stamp if k + 1 < len(begun) else math.inf
        ended = next((e for e in told if steps[-1].stamp <= e.stamp < until), None)
        if ended is not None:
            told.remove(ended)
        found.append((steps, ended))
    rounds = attempts(record)
    summaries = [_exposure(steps, ended, rounds) for steps, ended in [*found, *(([], e) for e in told)]]
    summaries.sort(key=lambda s: s.end)
    last = {s.attempt: k for k, s in enumerate(summaries)}
    truths = {r.number: r.truth.get("visible_area_px") for r in rounds}
    return [replace(s, area=truths.get(s.attempt) if last[s.attempt] == k else None) for k, s in enumerate(summaries)]


def _exposure(steps: list[Entry], ended: Entry | None, rounds: list[AttemptSummary]) -> ExposureSummary:
    """One exposure from its planned steps and its end, either of which may be missing."""
    entries = [*steps, *([] if ended is None else [ended])]
    start, end = entries[0].stamp, entries[-1].stamp
    told = {} if ended is None else ended.payload
    views = [entry.payload for entry in steps]
    # What is planned when the pull already ends is not made any more.
    count = int(told.get("steps", len(views)))
    names = {"camera": "camera", "deform": "deform", "opening": "opening", "expected_tension": "tension"}
    series = {name: [view.get(key) for view in views[:count]] for name, key in names.items()}
    plan, forecast = told.get("planned") or {}, told.get("forecast") or {}
    # A step is planned before it is known how far apart it brings the hypotheses: that is seen with the next one.
    series["separation"] = forecast.get("separation") or [view.get("separation") for view in views[1 : count + 1]]
    series["agreement"] = plan.get("agreement") or []
    series["feasible"] = plan.get("feasible") or []
    series |= {name: told.get(name) or [] for name in ("tension", "strain")}
    return ExposureSummary(
        attempt=max((r.number for r in rounds if r.start <= start), default=0),
        start=start,
        end=end,
        steps=count,
        message=str(told.get("message", "")),
        stopped_by=str(told.get("stopped_by", "")),
        series={name: values for name, values in series.items() if values},
        area=None,
    )


def max_attempts(record: SessionRecord) -> int:
    """How many attempts the session was allowed, 0 if it never said."""
    return max((entry.payload["max_attempts"] for entry in record.topic(topics.PROGRESS)), default=0)


def approvals(record: SessionRecord) -> list[Entry]:
    """What the operator said yes or no to, and what became void, without the questions."""
    return [entry for entry in record.topic(topics.APPROVAL) if entry.payload.get("event") != "asked"]


def ending(record: SessionRecord) -> Ending:
    """How the session ended, told truthfully: an unclosed record says so, and a wrong belief is called one."""
    outcome = record.outcome
    code = str(outcome.get("code", ""))
    sentence = str(outcome.get("message", ""))
    if not record.closed:
        why = str(record.header.get("fault") or f"Its record ends at {record.end:.1f} s of bench time.")
        return Ending(
            "bad", "Not closed", f"The session was not closed: it was killed, lost power or its disk, or is still running. {why}"
        )
    headline = str(outcome.get("outcome") or code or "ended").replace("_", " ").capitalize()
    if code == Code.COMPLETE:
        if outcome.get("success") is False:
            return Ending(
                "fair", headline, f"{sentence.rstrip('.')}. The bench's truth disagrees: see the figures below.".lstrip(". ")
            )
        return Ending("good", headline, sentence)
    return Ending("bad" if code in STOPPED else "fair", headline, sentence)


def _crossing(graph: dict[str, Any] | None, state: EdgeState) -> int:
    """How many edges across the goal are in `state`."""
    if graph is None:
        return 0
    return sum(bool(crosses) and s == state for crosses, s in zip(graph["crosses_goal"], graph["state"], strict=True))
