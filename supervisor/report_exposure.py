"""The report's section on exposures: for each pull what the controller expected, what was measured, and why it ended."""

from __future__ import annotations

import html
from typing import Any

from hardware.limits import Limits
from supervisor.charts import curves
from supervisor.history import ExposureSummary, exposures
from supervisor.reading import SessionRecord

EXPECTED, MEASURED, OTHER, TRUTH = "#6f5fa8", "#27313a", "#3c9d8b", "#3f7cac"


def section(record: SessionRecord) -> str:
    """All exposures of a session; those of records that are older than the controller with the reason of their end alone."""
    found = exposures(record)
    if not found:
        return ""
    parts, number = [], 0
    for k, exposure in enumerate(found):
        number = number + 1 if k and found[k - 1].attempt == exposure.attempt else 1
        again = "" if number == 1 else f", exposure {number}"
        charts = "".join(_charts(exposure, record.header))
        figures = f"<div class='figures'>{charts}</div>" if charts else ""
        heading = f"<h3>Attempt {exposure.attempt}{again}</h3><p class='note'>{_safe(_sentence(exposure))}</p>"
        parts.append(f"<div class='exposure'>{heading}{figures}</div>")
    return f"<h2>Exposure</h2>{''.join(parts)}"


def _sentence(exposure: ExposureSummary) -> str:
    """Why it ended; without an end, how far the record goes. The true area is said where there is no chart to show it in."""
    if not exposure.message:
        return f"The pull did not come to its end; step {exposure.steps} is the last that was planned."
    unseen = exposure.area is not None and "opening" not in exposure.series
    area = f" In truth the camera sees {exposure.area:.0f} px of the opened cut." if unseen else ""
    return f"{exposure.message[0].upper()}{exposure.message[1:].rstrip('.')}.{area}"


def _charts(exposure: ExposureSummary, header: dict[str, Any]) -> list[str]:
    """A chart of everything that the record holds."""
    series = exposure.series
    charts = []

    def chart(title: str, unit: str, names: dict[str, tuple[str, str]], limit: tuple[str, float] | None = None) -> None:
        drawn = [(said, colour, series[name]) for name, (said, colour) in names.items() if name in series]
        truth = exposure.area if "opening" in names else None
        end = None if truth is None else ("truth at the attempt's end", TRUTH, float(truth))
        if drawn:
            charts.append(curves(title, unit, drawn, limit, end))

    chart("Losses", "a pixel", {"camera": ("camera facing", EXPECTED), "deform": ("deformation", OTHER)})
    chart("Opening of the cut", "px²", {"opening": ("expected", EXPECTED)})
    enough = _setting(header, "configuration", "skills", "optimal", "separation", "enough")
    said = None if enough is None else ("enough", enough)
    chart("Severed from connected", "standard deviations", {"separation": ("separation", EXPECTED)}, said)
    tension, strain = _limit(header, "tension_stop"), _limit(header, "strain_stop")
    names = {"expected_tension": ("expected", EXPECTED), "tension": ("measured", MEASURED)}
    chart("Tension", "N", names, (f"refused above {tension:g}", tension))
    chart("Strain", "ratio", {"strain": ("measured", MEASURED)}, (f"refused above {strain:g}", strain))
    chart("Sampled pulls", "share", {"agreement": ("agreement", EXPECTED), "feasible": ("feasible", OTHER)})
    return charts


def _limit(header: dict[str, Any], name: str) -> float:
    return _setting(header, "limits", name) or float(getattr(Limits(), name))


def _setting(header: dict[str, Any], *keys: str) -> float | None:
    """A number of the header, wherever it lies; None if it is not there."""
    value: Any = header
    for key in keys:
        value = value.get(key) if isinstance(value, dict) else None
    return float(value) if isinstance(value, int | float) else None


def _safe(said: str) -> str:
    return html.escape(said)
