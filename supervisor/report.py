"""`report.html`: one file that tells a session to a person, on screen and on paper; no scripts, nothing beside it."""

from __future__ import annotations

import html
import math
import string
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from hardware.codes import InputError
from hardware.interface import Image
from hardware.limits import Limits
from supervisor import topics
from supervisor.charts import Mark, Trace, figures, overlay, time_line
from supervisor.history import (
    AttemptSummary,
    approvals,
    attempts,
    commands_sent,
    ending,
    intervals,
    is_guard,
    leaves,
    max_attempts,
    refused,
    snips,
)
from supervisor.palette import CONNECTED, GOAL, GRASP, SEVERED, UNKNOWN
from supervisor.reading import Entry, SessionRecord, read
from supervisor.report_exposure import section as exposure_section

REPORT_FILE = "report.html"
TEMPLATE = Path(__file__).with_name("report.html")
TRUTH_COLOUR, ESTIMATE_COLOUR, HARM_COLOUR = "#3f7cac", "#b6c2cc", "#b0574f"
MAX_ROWS = 40  # of the table of refusals


def write_report(folder: Path) -> Path:
    """Write `report.html` into the session's folder, closed or not, and return its path.

    Raises:
        InputError: there is no readable session in `folder`, or the report cannot be written there.
    """
    path = Path(folder) / REPORT_FILE
    page = render(read(folder))
    try:
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise InputError(f"The report cannot be written to {path}: {error.strerror or error}.") from error
    return path


def render(record: SessionRecord) -> str:
    """Make the page."""
    header = record.header
    end = ending(record)
    about = [f"{key} {header[key]}" for key in ("bench", "scene", "agent", "exposure", "seed") if header.get(key) is not None]
    started = f"Started {header['started']}. " if header.get("started") else ""
    template = string.Template(TEMPLATE.read_text(encoding="utf-8"))
    return template.substitute(
        title=f"Dissection session {_safe(record.folder.resolve().name)}",
        about=_safe(" · ".join(about)),
        tone=end.tone,
        headline=_safe(end.headline),
        sentence=_safe(end.sentence),
        facts=_facts(record),
        pictures=_pictures(record),
        attempts=_attempts(attempts(record)),
        exposures=exposure_section(record),
        timeline=_time_line(record),
        refused=_refused(record),
        approvals=_approvals(record),
        settings=_settings(header),
        footer=_safe(f"{started}Record: session.mcap, {'closed' if record.closed else 'not closed'}."),
    )


def _facts(record: SessionRecord) -> str:
    outcome, header = record.outcome, record.header
    rounds = attempts(record)
    estimated = rounds[-1].attachments if rounds else None
    limits = header.get("limits") or {}
    signals = record.topic(topics.SIGNALS)
    deviation = outcome.get("length_deviation_m")
    facts = [("Attempts", f"{len(rounds)}", f"of {max_attempts(record)}")]
    if outcome.get("attachments") is not None:
        facts.append(("Attachments left", f"{outcome['attachments']}", ""))
    facts.append(("Estimated left", "unknown" if estimated is None else f"{estimated}", ""))
    if deviation is not None:
        facts.append(("Length deviation", f"{1e3 * deviation:.2f} mm", ""))
    if outcome.get("success") is not None:
        facts.append(("Success", "yes" if outcome["success"] else "no", "as in the paper"))
    facts += [
        ("Snips", f"{snips(record)}", ""),
        ("Commands sent", f"{commands_sent(record)}", f"{sum(r.times for r in refused(record))} refused"),
        ("Most tension", *_most(signals, "tension", 1.0, "N", limits.get("tension_stop"))),
        ("Most strain", *_most(signals, "strain", 100.0, "%", limits.get("strain_stop"))),
        ("Bench time", f"{record.end:.1f} s", f"{outcome['wall_s']:.0f} s on the wall" if outcome.get("wall_s") else ""),
    ]
    return "".join(f"<div><dt>{_safe(n)}</dt><dd>{_safe(v)} <small>{_safe(s)}</small></dd></div>" for n, v, s in facts)


def _most(signals: Sequence[Entry], key: str, scale: float, unit: str, limit: float | None) -> tuple[str, str]:
    values = [entry.payload[key] for entry in signals if entry.payload.get(key) is not None]
    said = f"{scale * max(values):.3g} {unit}" if values else "not known"
    return said, f"limit {scale * limit:g} {unit}" if limit else ""


def _pictures(record: SessionRecord) -> str:
    """First and last image with the goal, and the image of each estimate with its edges."""
    wanted = _wanted_pictures(record)
    if not wanted:
        return "<h2>Images</h2><p class='note'>No image was recorded.</p>"
    found: dict[float, Image] = dict(record.images({stamp for stamp, *_ in wanted}))
    shown = []
    for stamp, caption, goal, graph in wanted:
        if stamp in found:
            svg = overlay(found[stamp], goal, graph, caption)
            shown.append(f"<figure>{svg}<figcaption>{_safe(caption)}</figcaption></figure>")
    return f"<h2>Before, between and after</h2><div class='pictures'>{''.join(shown)}</div>{_legend()}"


def _wanted_pictures(record: SessionRecord) -> list[tuple[float, str, dict[str, Any] | None, dict[str, Any] | None]]:
    """Stamp, caption, goal and graph of each picture to show."""
    stamps = record.image_stamps
    if not stamps:
        return []
    goals = record.topic(topics.GOAL)
    graphs = record.topic(topics.GRAPH)
    first_goal = goals[0].payload if goals else None
    wanted: list[tuple[float, str, dict[str, Any] | None, dict[str, Any] | None]] = [
        (stamps[0], f"At {stamps[0]:.1f} s: the first image, with the goal and the grasp point.", first_goal, None)
    ]
    for graph in graphs:
        at = max((s for s in stamps if s <= graph.stamp + 1e-6), default=stamps[0])
        number = graph.payload.get("attempt")
        caption = f"Attempt {number}, estimate at {graph.stamp:.1f} s: {graph.payload['message']}."
        wanted.append((at, caption.replace("..", "."), _nearest(goals, at), graph.payload))
    # After the last image nothing is tracked any more, and stale edges on tissue that has moved would mislead.
    goal = goals[-1] if goals else None
    shown = goal.payload if goal is not None and abs(goal.stamp - stamps[-1]) <= 0.5 else None
    wanted.append((stamps[-1], f"At {stamps[-1]:.1f} s: the last image.", shown, None))
    return wanted


def _nearest(entries: Sequence[Entry], stamp: float) -> dict[str, Any] | None:
    """Give the payload nearest in time, if there is any within a second."""
    near = min(entries, key=lambda entry: abs(entry.stamp - stamp), default=None)
    return near.payload if near is not None and abs(near.stamp - stamp) <= 1.0 else None


def _legend() -> str:
    items = [
        ("", GOAL, "goal"),
        ("ring", GRASP, "grasp point"),
        ("", CONNECTED, "edge still connected"),
        ("", SEVERED, "edge severed"),
        ("dashed", UNKNOWN, "edge unknown, never taken for severed"),
    ]
    spans = "".join(
        f"<span><i class='{kind}' style='border-color:{colour}'></i>{_safe(said)}</span>" for kind, colour, said in items
    )
    return f"<p class='legend'>{spans}<span>Thin: edges that do not cross the goal.</span></p>"


def _attempts(rounds: Sequence[AttemptSummary]) -> str:
    """Figures and a table, attempt by attempt; the truth of a simulated bench beside the estimate."""
    if not rounds:
        return "<h2>Attempts</h2><p class='note'>No attempt was begun.</p>"
    labels = [f"attempt {r.number}" for r in rounds]
    has_truth = any(r.truth for r in rounds)
    truths = {key: [r.truth.get(key) for r in rounds] for key in ("attachments", "length_deviation_m")}
    left: list[float | None] = [r.attachments for r in rounds]
    series: list[tuple[str, str, Sequence[float | None]]] = [("estimate", ESTIMATE_COLOUR, left)]
    if has_truth:
        series.append(("truth", TRUTH_COLOUR, truths["attachments"]))
    top = max([1.0, *(v for v in [*left, *truths["attachments"]] if v is not None)])
    charts = [figures("Attachments left", "number", labels, series, math.ceil(1.2 * top))]
    if has_truth:
        effective = [_scaled(r.truth.get("effective_cut_ratio"), 100) for r in rounds]
        excessive = [_scaled(r.truth.get("excessive_cut_ratio"), 100) for r in rounds]
        ratios = [("effective", TRUTH_COLOUR, effective), ("excessive", HARM_COLOUR, excessive)]
        charts.append(figures("Cut ratio", "% of the goal", labels, ratios, 110))
        deviation = [_scaled(v, 1e3) for v in truths["length_deviation_m"]]
        top = max([2.0, *(v for v in deviation if v is not None)])
        charts.append(figures("Length deviation", "mm", labels, [("truth", TRUTH_COLOUR, deviation)], 1.2 * top))
    rows = [
        (
            f"{r.number}",
            f"{r.start:.1f} s",
            f"{r.end - r.start:.1f} s",
            "not known" if r.attachments is None else f"{r.attachments}",
            f"{r.connected}",
            f"{r.unknown}",
            f"{r.severed}",
            _safe(r.estimate),
        )
        for r in rounds
    ]
    heads = ("Attempt", "Began", "Took", "Estimated left", "Connected", "Unknown", "Severed", "Estimate")
    said = "" if has_truth else "<p class='note'>The bench tells no truth; the figures are the supervisor's own estimate.</p>"
    return f"<h2>Attempts</h2><div class='figures'>{''.join(charts)}</div>{said}{_table(heads, rows, numeric=range(1, 7))}"


def _time_line(record: SessionRecord) -> str:
    spans = intervals(record)
    lanes = []
    for node in leaves(record):
        own = [i for i in spans if i.path == node["path"]]
        if own and not is_guard(node["path"]):
            lanes.append((node["name"], own))
    guards = [Mark(i.start, i.end, f"{i.name}: {i.message}") for i in spans if is_guard(i.path) and not _passed(i)]
    refusals = [Mark(r.start, r.end, f"{r.arm} {r.command} refused {r.times} times: {r.message}") for r in refused(record)]
    answers = [
        Mark(e.stamp, e.stamp, f"{e.payload.get('event', 'approved')} by {e.payload.get('by', '?')}") for e in approvals(record)
    ]
    marks = [("guards waiting", "#c8372d", guards), ("refused", "#c98a1b", refusals), ("approvals", "#2e8b57", answers)]
    limits = record.header.get("limits") or {}
    defaults = {f.name: f.default for f in fields(Limits)}
    traces = []
    signals = record.topic(topics.SIGNALS)
    for name, key, limit in (("tension [N]", "tension", "tension_stop"), ("strain", "strain", "strain_stop")):
        values = [math.nan if e.payload.get(key) is None else float(e.payload[key]) for e in signals]
        traces.append(Trace(name, [e.stamp for e in signals], values, float(limits.get(limit, defaults[limit]))))
    starts = [(r.start, f"attempt {r.number}") for r in attempts(record)]
    return f"<h2>Time line</h2><figure>{time_line(lanes, marks, traces, starts, record.end)}</figure>"


def _passed(interval: Any) -> bool:
    """Whether a guard just said yes."""
    return bool(interval.start == interval.end and interval.status == "SUCCESS")


def _refused(record: SessionRecord) -> str:
    groups = refused(record)
    if not groups:
        return "<h2>Commands refused by the safety gate</h2><p class='note'>None.</p>"
    rows = [
        (f"{r.start:.2f} s", f"{r.times}", _safe(f"{r.arm} {r.command}"), _safe(r.holder), _safe(r.code), _safe(r.message))
        for r in groups[:MAX_ROWS]
    ]
    more = f"<p class='note'>and {len(groups) - MAX_ROWS} more in the record.</p>" if len(groups) > MAX_ROWS else ""
    table = _table(("From", "Times", "Command", "By", "Code", "Why"), rows, numeric=(0, 1))
    return f"<h2>Commands refused by the safety gate</h2>{table}{more}"


def _approvals(record: SessionRecord) -> str:
    rows = []
    for entry in approvals(record):
        p = entry.payload
        what = f"{p.get('kind', 'goal')} {p.get('goal_id', '')}"
        said = (str(p.get("event", "approved")), p.get("by", ""), what, p.get("frame_sequence", ""), p.get("reason", ""))
        rows.append((f"{entry.stamp:.2f} s", *(_safe(str(cell)) for cell in said)))
    if not rows:
        return "<h2>Approvals</h2><p class='note'>Nothing was approved; no cut was possible.</p>"
    return f"<h2>Approvals</h2>{_table(('At', 'Answer', 'By', 'What', 'Frame', 'Why asked'), rows)}"


def _settings(header: dict[str, Any]) -> str:
    """Limits, versions and all else that the header tells, flattened into short lines."""
    apart = {"outcome", "closed", "fault", "limits", "versions"}
    rest = {key: value for key, value in header.items() if key not in apart}
    configuration = rest.pop("configuration", None)
    if isinstance(configuration, dict):
        rest |= configuration
    parts = []
    shown = (("Limits, SI units", header.get("limits")), ("Configuration", rest), ("Versions", header.get("versions")))
    for name, value in shown:
        lines = [f"<div><span>{_safe(key)}</span><span>{_safe(text)}</span></div>" for key, text in _flat(value)]
        if lines:
            parts.append(f"<h2>{name}</h2><div class='settings'>{''.join(lines)}</div>")
    return "".join(parts)


def _flat(value: Any, key: str = "") -> Iterator[tuple[str, str]]:
    """Give a nested dict as pairs of dotted key and text."""
    if isinstance(value, dict):
        for name, item in value.items():
            yield from _flat(item, f"{key}.{name}" if key else str(name))
    elif value is not None:
        yield key, ", ".join(str(item) for item in value) if isinstance(value, list) else str(value)


def _table(heads: Iterable[str], rows: Iterable[Sequence[str]], numeric: Iterable[int] = ()) -> str:
    """Make a table of cells that are already safe."""
    right = set(numeric)

    def cell(tag: str, k: int, said: str) -> str:
        return f"<{tag} class='number'>{said}</{tag}>" if k in right else f"<{tag}>{said}</{tag}>"

    head = "".join(cell("th", k, _safe(said)) for k, said in enumerate(heads))
    body = "".join(f"<tr>{''.join(cell('td', k, said) for k, said in enumerate(row))}</tr>" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _scaled(value: float | None, scale: float) -> float | None:
    return None if value is None else scale * value


def _safe(said: str) -> str:
    return html.escape(said)
