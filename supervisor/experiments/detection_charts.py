"""Reliability diagram of the detection experiment: `python -m supervisor.experiments.detection_charts d.json docs/pictures/`.

How often an edge was severed for each tenth of the probability that it was said to be: on the diagonal the probability can be trusted.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from supervisor.charts import FAINT, GRID, INK, box, picture, rule, text
from supervisor.experiments.statistics import wilson

WIDTH, HEIGHT = 900, 470
SIDE = 330  # of a diagram
TOP = 46
BOTTOM = TOP + SIDE
BARS = 44  # height of the counts below a diagram
PANELS = {None: (64, "all edges", "#2f8f7d"), "goal_edges": (520, "edges across the goal", "#c98a1b")}


def reliability_chart(figures: dict[str, Any]) -> str:
    """Both diagrams side by side, with Wilson's interval of each share and the number of edges below, as SVG."""
    parts: list[str] = []
    for key, (left, name, colour) in PANELS.items():
        part = figures if key is None else figures[key]
        parts += _panel(left, name, colour, part["reliability"], part["brier"])
    return picture(parts, "Reliability of the probability that an edge is severed", WIDTH, HEIGHT)


def write(figures: dict[str, Any], folder: Path) -> Path:
    """Write the chart into `folder`; gives its file."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "detection-reliability.svg"
    path.write_text(reliability_chart(figures) + "\n", encoding="utf-8")
    return path


# ------------------------------------------------------------ inside


def _panel(left: float, name: str, colour: str, bins: Sequence[dict[str, Any]], brier: float | None) -> list[str]:
    right = left + SIDE
    parts = [text(left, 22, name, weight=600, size=14)]
    if brier is not None:
        parts.append(text(right, 22, f"Brier score {brier:.4f}", anchor="end", colour=FAINT))
    for tick in (0.0, 0.25, 0.5, 0.75, 1.0):
        x, y = left + SIDE * tick, BOTTOM - SIDE * tick
        parts += [rule((left, y), (right, y), GRID if tick else FAINT), rule((x, TOP), (x, BOTTOM), GRID if tick else FAINT)]
        parts.append(text(left - 8, y + 4, f"{tick:g}", anchor="end", colour=FAINT))
        parts.append(text(x, BOTTOM + BARS + 22, f"{tick:g}", anchor="middle", colour=FAINT))
    parts.append(rule((left, BOTTOM), (right, TOP), FAINT, dash="4 4"))
    parts.append(text(left + 8, TOP + 16, "share severed in truth", colour=FAINT))
    parts.append(text((left + right) / 2, HEIGHT - 8, "probability severed, as estimated", anchor="middle", colour=FAINT))
    most = max((entry["count"] for entry in bins), default=1)
    seen = [entry for entry in bins if entry["count"]]
    for entry in seen:
        x, y = left + SIDE * entry["mean_predicted"], BOTTOM - SIDE * entry["share_severed"]
        low, high = wilson(round(entry["share_severed"] * entry["count"]), entry["count"])
        parts.append(rule((x, BOTTOM - SIDE * low), (x, BOTTOM - SIDE * high), colour))
        parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="5" fill="{colour}" stroke="#fff" stroke-width="1.5"/>')
    for entry in seen:
        # On a logarithmic scale, or the many plain edges would hide the doubtful ones.
        high = (BARS - 14) * math.log1p(entry["count"]) / math.log1p(most)
        start, thick = left + SIDE * entry["from"], SIDE * (entry["to"] - entry["from"])
        parts.append(box(start + 2, BOTTOM + BARS + 6 - high, thick - 4, high, GRID))
        parts.append(text(start + thick / 2, BOTTOM + BARS + 2, f"{entry['count']}", anchor="middle", size=10, colour=INK))
    return parts


def main(arguments: Sequence[str]) -> int:
    """Read the experiment's JSON, write its chart."""
    if len(arguments) != 2:
        print("usage: python -m supervisor.experiments.detection_charts RESULT.json FOLDER", file=sys.stderr)
        return 2
    print(write(json.loads(Path(arguments[0]).read_text(encoding="utf-8")), Path(arguments[1])))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
