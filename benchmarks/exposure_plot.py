"""The plot of `benchmarks.exposure` as SVG: cost against samples, horizon and mesh, and what is left to solve against iterations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from supervisor.charts import FAINT, GRID, INK, rule, text

WIDTH, HEIGHT = 900, 700
PANEL = (450.0, 350.0)
LEFT, RIGHT, TOP, BOTTOM = 62.0, 22.0, 62.0, 46.0
COLOURS = ("#3f7cac", "#b0574f", "#9dbcd4", "#dba7a1")


@dataclass(frozen=True)
class Curve:
    """Points (x, y) with the spread (least, greatest) of y where there is one."""

    name: str
    colour: str
    points: Sequence[tuple[float, float]]
    spread: Sequence[tuple[float, float]] = ()
    dashed: bool = False


def plot(figures: dict[str, Any]) -> str:
    """Draw the `scaling` and `convergence` of the benchmark's figures."""
    parts = [f'<rect width="{WIDTH}" height="{HEIGHT}" fill="#fff"/>']
    titles = {"samples": ("Samples K", "K"), "horizon": ("Horizon h", "h"), "mesh": ("Mesh", "constraints")}
    for k, (key, (title, axis)) in enumerate(titles.items()):
        scaling = figures["scaling"][key]
        points = [(float(row[axis]), row["ms"]["median"]) for row in scaling["points"]]
        spread = [(row["ms"]["min"], row["ms"]["max"]) for row in scaling["points"]]
        end_x, end_y = points[-1]
        line = [(x, end_y * x / end_x) for x in (points[0][0], end_x)]
        note = f"{scaling['setting']}; slope of the upper half {scaling['exponent']:.2f}; dashed: in proportion"
        curves = [Curve("in proportion", FAINT, line, dashed=True), Curve("rollouts", COLOURS[0], points, spread)]
        parts += _panel((k % 2) * PANEL[0], (k // 2) * PANEL[1], title, note, axis, "ms", curves)
    curves = []
    for case, dashed in zip(figures["convergence"]["cases"], (False, True), strict=False):
        for j, (name, left) in enumerate(case["residual"].items()):
            points = [(float(n), r) for n, r in zip(figures["convergence"]["iterations"], left, strict=True) if r is not None]
            label = f"{name}, {case['stiffness_over_inertia']:g}"
            curves.append(Curve(label, COLOURS[j + (2 if dashed else 0)], points, dashed=dashed))
    note = "share of the force imbalance left; number: edge stiffness over inertia"
    parts += _panel(PANEL[0], PANEL[1], "Equal iterations are not equal quality", note, "iterations", "", curves)
    inner, label = "\n".join(parts), "Cost and convergence of the tissue simulation"
    font = 'font-family="Helvetica, Arial, sans-serif"'
    return f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" {font} aria-label="{label}" xmlns="http://www.w3.org/2000/svg">{inner}</svg>\n'


def _panel(left: float, top: float, title: str, note: str, x_name: str, y_name: str, curves: Sequence[Curve]) -> list[str]:
    """Draw one panel, both axes logarithmic."""
    xs = [x for curve in curves for x, _ in curve.points]
    ys = [y for curve in curves for _, y in curve.points] + [y for curve in curves for pair in curve.spread for y in pair]
    marks = _marks(min(ys), max(ys))
    low, high = marks[0], marks[-1]
    legend = len(curves) > 2
    x1, x2 = left + LEFT, left + PANEL[0] - RIGHT
    y1, y2 = top + PANEL[1] - BOTTOM, top + TOP + (36.0 if legend else 0.0)

    def across(x: float) -> float:
        return x1 + (x2 - x1) * math.log(x / min(xs)) / math.log(max(xs) / min(xs))

    def up(y: float) -> float:
        return y1 + (y2 - y1) * math.log(y / low) / math.log(high / low)

    parts = [text(left + 16, top + 26, title, weight=600, size=14), text(left + 16, top + 44, note, colour=FAINT, size=11)]
    for mark in marks:
        parts += [rule((x1, up(mark)), (x2, up(mark)), GRID)]
        parts += [text(x1 - 8, up(mark) + 4, f"{mark:g} {y_name}".strip(), anchor="end", colour=FAINT)]
    for x in sorted({x for curve in curves for x, _ in curve.points}):
        parts += [rule((across(x), y1), (across(x), y1 + 4), FAINT)]
        parts += [text(across(x), y1 + 17, f"{x:g}", anchor="middle", colour=FAINT, size=11)]
    parts += [rule((x1, y1), (x2, y1), FAINT), text(x2, y1 + 34, x_name, anchor="end", colour=INK, size=12)]
    for curve in curves:
        dash = ' stroke-dasharray="5 4"' if curve.dashed else ""
        path = " ".join(f"{across(x):.1f},{up(y):.1f}" for x, y in curve.points)
        parts.append(f'<polyline points="{path}" fill="none" stroke="{curve.colour}" stroke-width="2"{dash}/>')
        for (x, _), (least, most) in zip(curve.points, curve.spread, strict=False):
            parts.append(rule((across(x), up(least)), (across(x), up(most)), curve.colour))
        if len(curve.points) > 2:  # a line of two points is a guide, not a measurement
            dot = f'r="3.2" fill="{curve.colour}"'
            parts += [f'<circle cx="{across(x):.1f}" cy="{up(y):.1f}" {dot}/>' for x, y in curve.points]
    for k, curve in enumerate(curves if legend else ()):
        x, y = x1 + (x2 - x1) * (k % 2) / 2, top + TOP + 2 + 17 * (k // 2)
        dash = ' stroke-dasharray="5 4"' if curve.dashed else ""
        parts.append(f'<path d="M{x:.1f} {y - 4:.1f}h24" stroke="{curve.colour}" stroke-width="2"{dash}/>')
        parts.append(text(x + 30, y, curve.name, size=11))
    return parts


def _marks(least: float, most: float) -> list[float]:
    """Marks of a logarithmic axis that hold all between `least` and `most`: 1, 2, 5, 10, ... or powers of ten if there are many."""
    powers = range(math.floor(math.log10(least)), math.ceil(math.log10(most)) + 1)
    steps = (1.0, 2.0, 5.0) if len(powers) < 5 else (1.0,)
    marks = [step * 10.0**power for power in powers for step in steps]
    first = max(k for k, mark in enumerate(marks) if mark <= least)
    last = min(k for k, mark in enumerate(marks) if mark >= most)
    return marks[first : last + 1]
