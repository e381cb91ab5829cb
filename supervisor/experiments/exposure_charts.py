"""Charts of the exposure experiment for the documentation: `python -m supervisor.experiments.exposure_charts e.json docs/pictures/`."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from supervisor.charts import FAINT, GRID, INK, box, picture, rule, text, ticks

METHODS = {  # name in the JSON: (name in words, colour)
    "optimal": ("planned", "#2f8f7d"),
    "goal_normal": ("across the goal", "#c98a1b"),
    "naive_normal": ("naive, towards the grasp", "#b0574f"),
}
WIDTH, HEIGHT = 900, 330
TOP, BOTTOM = 46, 258  # of the panels

Scale = Callable[[float], float]


def curves_chart(figures: dict[str, Any]) -> str:
    """Area seen, and edges judged rightly, after each step of the pull: mean over trials, band of one standard error."""
    curves = figures["curves"]
    steps = len(curves["optimal"]["step"])
    areas = {name: _band(curves[name]["area_px"], curves[name]["n"], 1.0) for name in METHODS}
    shares = {name: _band(curves[name]["accuracy"], curves[name]["n"], 100.0) for name in METHODS}
    most = max([high for band in areas.values() for _, _, high in band if math.isfinite(high)], default=1.0)
    parts = _panel(56, 432, "area of the cut seen", "pixels", areas, steps, 1.04 * most)
    parts += _panel(512, 888, "edges judged rightly", "percent", shares, steps, 100.0)
    optimal = figures["methods"]["optimal"]
    if optimal["connectivity_accuracy"] is not None:
        x, y = _x(512, 888, steps)(optimal["steps"]["mean"]), _y(100.0)(100 * optimal["connectivity_accuracy"])
        colour = METHODS["optimal"][1]
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" fill="{colour}" stroke="#fff" stroke-width="1.5"/>')
    parts += _legend(f"band: one standard error of {figures['trials']} trials; dot: where the planned pull stops by itself")
    return picture(parts, "Area seen and edges judged rightly over the pull", WIDTH, HEIGHT)


def angle_chart(figures: dict[str, Any]) -> str:
    """Mean area by the angle between grasp and goal normal, as bars, with the ratio to the naive method's above the planned one's."""
    bins = figures["by_angle"]
    most = max([value for b in bins for name in METHODS if (value := b["visible_area_px"][name]) is not None], default=1.0)
    top = 1.12 * max(most, 1.0)
    y = _y(top)
    parts = _axis(56, 888, "area of the cut seen, by the angle between grasp and goal normal", "pixels", top)
    group = (888 - 56) / len(bins)
    thick = 0.24 * group
    for k, entry in enumerate(bins):
        middle = 56 + group * (k + 0.5)
        parts.append(text(middle, BOTTOM + 18, f"{entry['from_deg']} to {entry['to_deg']}°", anchor="middle"))
        parts.append(
            text(middle, BOTTOM + 34, f"{entry['n']} trial{'' if entry['n'] == 1 else 's'}", anchor="middle", colour=FAINT)
        )
        for j, (name, (_, colour)) in enumerate(METHODS.items()):
            value, x = entry["visible_area_px"][name], middle + (j - 1.5) * thick
            if value is None:
                continue
            parts.append(box(x + 1, y(value), thick - 2, max(BOTTOM - y(value), 1.0), colour))
            ratio = entry["ratio_to_naive"][name]
            if name != "naive_normal" and ratio is not None:
                parts.append(text(x + thick / 2, y(value) - 5, f"× {ratio:.1f}", anchor="middle", size=11))
    parts += _legend("×: times the naive area")
    return picture(parts, "Area seen by the angle between grasp and goal normal", WIDTH, HEIGHT)


def write(figures: dict[str, Any], folder: Path) -> list[Path]:
    """Write both charts into `folder`; gives their files."""
    folder.mkdir(parents=True, exist_ok=True)
    charts = {"exposure-curves.svg": curves_chart(figures), "exposure-angle.svg": angle_chart(figures)}
    for name, chart in charts.items():
        (folder / name).write_text(chart + "\n", encoding="utf-8")
    return [folder / name for name in charts]


# ------------------------------------------------------------ inside


def _band(spread: dict[str, list[float | None]], count: int, scale: float) -> list[tuple[float, float, float]]:
    """Mean and one standard error to either side at each step; nan where nothing is known."""
    band = []
    for mean, sd in zip(spread["mean"], spread["sd"], strict=True):
        middle = math.nan if mean is None else scale * mean
        error = math.nan if sd is None else scale * sd / math.sqrt(max(count, 1))
        band.append((middle, middle - error, middle + error))
    return band


def _x(left: float, right: float, steps: int) -> Scale:
    return lambda step: left + (right - left) * step / steps


def _y(top: float) -> Scale:
    return lambda value: BOTTOM - (BOTTOM - TOP) * min(max(value, 0.0), top) / top


def _axis(left: float, right: float, title: str, unit: str, top: float) -> list[str]:
    parts = [text(left, 22, title, weight=600, size=14), text(right, 22, unit, anchor="end", colour=FAINT)]
    for value in ticks(top, 5):
        y = _y(top)(value)
        parts.append(rule((left, y), (right, y), GRID if value else FAINT))
        parts.append(text(left - 8, y + 4, f"{value:g}", anchor="end", colour=FAINT))
    return parts


def _panel(
    left: float,
    right: float,
    title: str,
    unit: str,
    bands: dict[str, list[tuple[float, float, float]]],
    steps: int,
    top: float,
) -> list[str]:
    x, y = _x(left, right, steps), _y(top)
    parts = _axis(left, right, title, unit, top)
    parts += [text(x(step), BOTTOM + 18, f"{step:g}", anchor="middle", colour=FAINT) for step in ticks(steps, 7)]
    parts.append(text((left + right) / 2, BOTTOM + 36, "step of the pull, 0.5 mm at most", anchor="middle", colour=FAINT))
    for name, band in bands.items():
        seen = [(k + 1, *values) for k, values in enumerate(band) if all(map(math.isfinite, values))]
        edge = [(x(k), y(high)) for k, _, _, high in seen] + [(x(k), y(low)) for k, _, low, _ in reversed(seen)]
        parts.append(f'<polygon points="{_points(edge)}" fill="{METHODS[name][1]}" fill-opacity=".14"/>')
    for name, band in bands.items():
        line = [(x(k + 1), y(values[0])) for k, values in enumerate(band) if math.isfinite(values[0])]
        look = f'fill="none" stroke="{METHODS[name][1]}" stroke-width="2.4" stroke-linejoin="round"'
        parts.append(f'<polyline points="{_points(line)}" {look}/>')
    return parts


def _points(points: Sequence[tuple[float, float]]) -> str:
    return " ".join(f"{u:.1f},{v:.1f}" for u, v in points)


def _legend(note: str) -> list[str]:
    parts, at = [], 56.0
    for name, colour in METHODS.values():
        parts += [box(at, HEIGHT - 21, 11, 11, colour), text(at + 17, HEIGHT - 11, name, colour=INK)]
        at += 34 + 6.6 * len(name)
    return [*parts, text(888, HEIGHT - 11, note, anchor="end", colour=FAINT, size=11)]


def main(arguments: Sequence[str]) -> int:
    """Read the experiment's JSON, write its charts."""
    if len(arguments) != 2:
        print("usage: python -m supervisor.experiments.exposure_charts RESULT.json FOLDER", file=sys.stderr)
        return 2
    for path in write(json.loads(Path(arguments[0]).read_text(encoding="utf-8")), Path(arguments[1])):
        print(path)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
