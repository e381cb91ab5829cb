"""The pictures of a report as inline SVG, made by hand: overlays on the endoscope's image, time line, figures per attempt, curves.

Vector graphics: sharp on paper, no scripts, no files beside the report.
"""

from __future__ import annotations

import base64
import html
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2

from hardware.interface import Image
from supervisor.history import Interval
from supervisor.palette import EDGE, GOAL, GRASP

FONT = "system-ui, -apple-system, 'Segoe UI', 'Liberation Sans', Arial, sans-serif"
INK, FAINT, GRID = "#27313a", "#6b7780", "#dfe4e8"
WIDTH = 960  # of the time line, in SVG units
LANE = 22
LEFT = 150
PHASE_COLOURS = ("#3f7cac", "#b0574f", "#3c9d8b", "#6f5fa8", "#c98a1b", "#5d6d7e", "#8a6d3b", "#4c8c4a")


@dataclass(frozen=True)
class Mark:
    """Something that happened at `start` [s] (to `end`), with a text that shows when pointed at."""

    start: float
    end: float
    text: str


@dataclass(frozen=True)
class Trace:
    """A curve below the time line: `times` and `values` (N,), the `limit` it must keep below, and its name with unit."""

    name: str
    times: Sequence[float]
    values: Sequence[float]
    limit: float


def overlay(image: Image, goal: dict[str, Any] | None, graph: dict[str, Any] | None, title: str) -> str:
    """Draw `image` (H, W, 3) uint8 RGB with the tracked goal, its grasp point, and the edges of an estimate, as SVG."""
    height, width = image.shape[:2]
    _, encoded = cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, 90])
    data = base64.b64encode(encoded.tobytes()).decode()
    parts = [f'<image href="data:image/jpeg;base64,{data}" width="{width}" height="{height}"/>']
    if graph is not None:
        parts += _edges(graph)
    if goal is not None:
        line = " ".join(f"{u:.1f},{v:.1f}" for u, v in goal["polyline"] if u is not None and v is not None)
        parts.append(f'<polyline points="{line}" fill="none" stroke="#000" stroke-opacity=".45" stroke-width="5"/>')
        parts.append(f'<polyline points="{line}" fill="none" stroke="{GOAL}" stroke-width="2.6"/>')
        u, v = goal["grasp"]
        if u is not None and v is not None:
            parts.append(
                f'<circle cx="{u:.1f}" cy="{v:.1f}" r="9" fill="none" stroke="#000" stroke-opacity=".45" stroke-width="5"/>'
            )
            parts.append(f'<circle cx="{u:.1f}" cy="{v:.1f}" r="9" fill="none" stroke="{GRASP}" stroke-width="2.6"/>')
    return _svg(width, height, parts, title)


def _edges(graph: dict[str, Any]) -> list[str]:
    """Keypoint grid: edges across the goal strong, the others faint."""
    points = graph["points"]
    parts = []
    for (a, b), state, crosses in zip(graph["edges"], graph["state"], graph["crosses_goal"], strict=True):
        ends = [*points[a], *points[b]]
        if any(value is None for value in ends):
            continue
        look = 'stroke-width="2.8"' if crosses else 'stroke-width="1" stroke-opacity=".6"'
        dash = ' stroke-dasharray="5 3"' if crosses and state == 2 else ""
        x1, y1, x2, y2 = ends
        parts.append(f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{EDGE[state]}" {look}{dash}/>')
    return parts


def time_line(
    lanes: Sequence[tuple[str, Sequence[Interval]]],
    marks: Sequence[tuple[str, str, Sequence[Mark]]],
    traces: Sequence[Trace],
    starts: Sequence[tuple[float, str]],
    end: float,
) -> str:
    """Draw a lane for each `(name, intervals)` and each `(name, colour, marks)`, the traces, and attempts at `(time, name)`."""
    end = max(end, 1e-3)
    body = WIDTH - LEFT - 16
    low = 30
    height = low + LANE * (len(lanes) + len(marks)) + 76 * len(traces) + 30

    def x(time: float) -> float:
        return LEFT + body * min(max(time, 0.0), end) / end

    parts = []
    for time in ticks(end, 10):
        parts.append(rule((x(time), low), (x(time), height - 26), GRID))
        parts.append(text(x(time), height - 10, f"{time:g} s", anchor="middle", colour=FAINT))
    for time, name in starts:
        parts.append(rule((x(time), 10), (x(time), height - 26), INK, dash="3 3"))
        parts.append(text(x(time) + 5, 20, name, weight=600))
    y = low
    for k, (name, spans) in enumerate(lanes):
        parts.append(text(LEFT - 10, y + 15, name, anchor="end"))
        parts += [_bar(x(i.start), x(i.end), y, PHASE_COLOURS[k % len(PHASE_COLOURS)], i) for i in spans]
        y += LANE
    for name, colour, found in marks:
        parts.append(text(LEFT - 10, y + 15, name, anchor="end", colour=FAINT))
        for mark in found:
            wide = max(x(mark.end) - x(mark.start), 3.0)
            parts.append(box(x(mark.start), y + 4, wide, LANE - 8, colour, tip=mark.text))
        y += LANE
    for trace in traces:
        parts += _trace(trace, y + 12, 56, x)
        y += 76
    return _svg(WIDTH, height, parts, "Time line of the session")


def _bar(x1: float, x2: float, y: float, colour: str, interval: Interval) -> str:
    """Draw one span of a lane; a failure or an interruption shows at its end."""
    tip = f"{interval.name}, {interval.start:.1f} to {interval.end:.1f} s, {interval.status.lower()}. {interval.message}"
    edge = {"FAILURE": "#c8372d", "INVALID": "#c98a1b"}.get(interval.status)
    end = box(max(x2 - 4, x1), y + 3, 5, LANE - 6, edge, tip=tip) if edge else ""
    return box(x1, y + 3, max(x2 - x1, 2.0), LANE - 6, colour, round_by=3, tip=tip) + end


def _trace(trace: Trace, y: float, height: float, x: Any) -> list[str]:
    """Draw one curve with its limit in a strip from `y` down; a gap where there was no reading."""
    top = 1.15 * max([v for v in trace.values if math.isfinite(v)] + [trace.limit])

    def down(value: float) -> float:
        return y + height * (1 - max(value, 0.0) / top)

    points = [(x(time), down(value)) for time, value in zip(trace.times, trace.values, strict=True)]
    right = WIDTH - 16
    return [
        rule((LEFT, y + height), (right, y + height), FAINT),
        rule((LEFT, down(trace.limit)), (right, down(trace.limit)), "#c8372d", dash="5 4"),
        text(LEFT - 10, y + height / 2 + 4, trace.name, anchor="end"),
        text(right, down(trace.limit) - 4, f"refused above {trace.limit:g}", anchor="end", colour="#c8372d", size=10),
        *_curve(points, INK, 1.4),
    ]


def _curve(points: Iterable[tuple[float, float]], colour: str, thick: float) -> list[str]:
    """Join points; a gap where one is not finite, and a dot for one that stands alone."""
    runs: list[list[tuple[float, float]]] = [[]]
    for point in points:
        if all(math.isfinite(value) for value in point):
            runs[-1].append(point)
        elif runs[-1]:
            runs.append([])
    parts = []
    for run in runs:
        if len(run) == 1:
            parts.append(f'<circle cx="{run[0][0]:.1f}" cy="{run[0][1]:.1f}" r="{thick:g}" fill="{colour}"/>')
        elif run:
            line = " ".join(f"{u:.1f},{v:.1f}" for u, v in run)
            parts.append(f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="{thick:g}"/>')
    return parts


def figures(
    title: str, unit: str, labels: Sequence[str], series: Iterable[tuple[str, str, Sequence[float | None]]], top: float
) -> str:
    """Draw bars per attempt: `series` are `(name, colour, values)`, a missing value leaves a "?"; `top` ends the axis."""
    series = list(series)
    width, height, low, high = 300, 210, 168, 34
    group = (width - 56) / max(len(labels), 1)
    thick = min(34.0, 0.7 * group / max(len(series), 1))
    parts = [text(0, 14, title, weight=600), text(width, 14, unit, anchor="end", colour=FAINT)]
    for value in ticks(top, 4):
        if unit == "number" and value % 1:
            continue
        y = low - (low - high) * value / top
        parts.append(rule((34, y), (width, y), GRID))
        parts.append(text(28, y + 4, f"{value:g}", anchor="end", colour=FAINT))
    for k, label in enumerate(labels):
        middle = 44 + group * (k + 0.5)
        parts.append(text(middle, low + 16, label, anchor="middle"))
        for j, (_, colour, values) in enumerate(series):
            x = middle + (j - len(series) / 2) * thick
            number = values[k]
            if number is None or not math.isfinite(number):
                parts.append(text(x + thick / 2, low - 4, "?", anchor="middle", colour=FAINT))
                continue
            tall = (low - high) * min(number, top) / top
            parts.append(box(x + 1, low - tall, thick - 2, max(tall, 1.2), colour))
            parts.append(text(x + thick / 2, low - tall - 4, f"{number:.3g}", anchor="middle", size=10.5))
    at = 34.0
    for name, colour, _ in series:
        parts.append(box(at, height - 15, 10, 10, colour))
        parts.append(text(at + 15, height - 6, name, colour=FAINT))
        at += 24 + 6.4 * len(name)
    return _svg(width, height, parts, title)


def curves(
    title: str,
    unit: str,
    series: Iterable[tuple[str, str, Sequence[float | None]]],
    limit: tuple[str, float] | None = None,
    end: tuple[str, str, float] | None = None,
) -> str:
    """Draw curves over steps, from 1: `series` are `(name, colour, values)`, a missing value leaves a gap.

    `limit` is `(what it says, value)`; `end` marks `(name, colour, value)` at the last step.
    """
    drawn = [(n, c, [math.nan if v is None else float(v) for v in values]) for n, c, values in series]
    width, height, low, high, left = 300, 210, 168, 34, 50
    seen = [v for *_, values in drawn for v in values if math.isfinite(v)]
    seen += [0.0, *([] if limit is None else [limit[1]]), *([] if end is None else [end[2]])]
    span = max(max(seen) - min(seen), 1e-9)
    bottom, top = min(seen) - 0.06 * span * (min(seen) < 0), max(seen) + 0.08 * span
    steps = max([1, *(len(values) for *_, values in drawn)])

    def x(step: float) -> float:
        return left + 6 + (width - left - 14) * (step - 1) / max(steps - 1, 1)

    def y(value: float) -> float:
        return low - (low - high) * (value - bottom) / (top - bottom)

    parts = [text(0, 14, title, weight=600), text(width, 14, unit, anchor="end", colour=FAINT)]
    raster = ticks(top - bottom, 4)[1]
    for k in range(math.ceil(bottom / raster), math.floor(top / raster) + 1):
        parts.append(rule((left, y(k * raster)), (width, y(k * raster)), FAINT if k == 0 else GRID))
        parts.append(text(left - 6, y(k * raster) + 4, f"{round(k * raster, 9):g}", anchor="end", colour=FAINT))
    parts.append(text(left - 6, low + 16, "step", anchor="end", colour=FAINT))
    for step in [1, *(int(t) for t in ticks(steps, 4)[1:] if t % 1 == 0 and t > 1)]:
        parts.append(text(x(step), low + 16, f"{step}", anchor="middle", colour=FAINT))
    if limit is not None:
        parts.append(rule((left, y(limit[1])), (width, y(limit[1])), "#c8372d", dash="5 4"))
        parts.append(text(width, y(limit[1]) + 13, limit[0], anchor="end", colour="#c8372d", size=10))
    for _, colour, values in drawn:
        parts += _curve([(x(k + 1), y(value)) for k, value in enumerate(values)], colour, 2.0)
    if end is not None:
        parts.append(f'<circle cx="{x(steps):.1f}" cy="{y(end[2]):.1f}" r="4" fill="{end[1]}"/>')
        parts.append(text(x(steps) - 8, y(end[2]) + 4, f"{end[2]:.5g}", anchor="end", size=10.5))
    at = float(left)
    for name, colour in [*((name, colour) for name, colour, _ in drawn), *([] if end is None else [end[:2]])]:
        parts.append(box(at, height - 15, 10, 10, colour))
        parts.append(text(at + 15, height - 6, name, colour=FAINT))
        at += 24 + 6.4 * len(name)
    return _svg(width, height, parts, title)


def ticks(end: float, count: int) -> list[float]:
    """Round numbers from 0 to `end`, about `count` of them."""
    raw = end / count
    power = 10 ** math.floor(math.log10(raw))
    step = next(s * power for s in (1, 2, 5, 10) if s * power >= raw - 1e-12)
    return [round(k * step, 9) for k in range(int(end / step + 1e-9) + 1)]


def text(x: float, y: float, said: str, *, anchor: str = "start", colour: str = INK, weight: int = 400, size: float = 12) -> str:
    """Make one SVG text, escaped."""
    look = f'text-anchor="{anchor}" fill="{colour}" font-weight="{weight}" font-size="{size}"'
    return f'<text x="{x:.1f}" y="{y:.1f}" {look}>{html.escape(said)}</text>'


def rule(start: tuple[float, float], end: tuple[float, float], colour: str, *, dash: str = "none") -> str:
    """Make one straight line."""
    (x1, y1), (x2, y2) = start, end
    return f'<line x1="{x1:.1f}" y1="{y1:.1f}" x2="{x2:.1f}" y2="{y2:.1f}" stroke="{colour}" stroke-dasharray="{dash}"/>'


def box(x: float, y: float, width: float, height: float, colour: str, *, round_by: float = 0, tip: str = "") -> str:
    """Make one filled rectangle, with a text that shows when pointed at."""
    inner = f"<title>{html.escape(tip)}</title>" if tip else ""
    where = f'x="{x:.1f}" y="{y:.1f}" width="{width:.1f}" height="{height:.1f}" rx="{round_by:g}"'
    return f'<rect {where} fill="{colour}">{inner}</rect>'


def _svg(width: float, height: float, parts: Iterable[str], title: str) -> str:
    inner = "\n".join(parts)
    label = html.escape(title, quote=True)
    return f'<svg viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{label}" xmlns="http://www.w3.org/2000/svg">{inner}</svg>'


def picture(parts: Iterable[str], title: str, width: int, height: int) -> str:
    """A chart as a file of its own: it brings its size, its letters, and a ground, since pages with a dark theme would swallow the ink."""
    size = f'viewBox="0 0 {width} {height}" width="{width}" height="{height}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size} role="img" aria-label="{title}" font-family="{FONT}">'
    return "\n".join([head, f'<rect width="{width}" height="{height}" rx="6" fill="#fff"/>', *parts, "</svg>"])
