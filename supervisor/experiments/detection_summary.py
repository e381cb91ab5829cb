"""The detection experiment's figures from its cases, and the tables that say them in words.

Severed is positive. Accuracy, balanced accuracy, precision and recall are over the edges that were decided, as in the paper; the rates of
false severed and unknown edges, and the Brier score, over all. Edges of one case are not independent: the intervals are too narrow.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from rich.table import Table

from supervisor.experiments.statistics import wilson

Run = dict[str, Any]

GROUPS = {"by_material": "scene", "by_disturbance": "disturbance", "by_cut": "cut"}
EDGES, GOAL_EDGES = "edges", "goal_edges"  # all of the grid's, and those that cross the goal

WORDS = {
    "detection_accuracy": "judged rightly, of the decided",
    "accuracy_unknown_wrong": "... of all",
    "balanced_accuracy": "balanced accuracy",
    "precision": "precision of severed",
    "recall": "recall of severed",
    "false_severed_rate": "connected but called severed",
    "unknown_rate": "unknown",
}

WITH_INTERVAL = ("detection_accuracy", "false_severed_rate")


def summary(runs: Sequence[Run]) -> dict[str, Any]:
    """Figures over all edges, the same over those that cross the goal as `goal_edges`, times, and what each case gave."""
    return {
        **_figures(runs, EDGES),
        GOAL_EDGES: _figures(runs, GOAL_EDGES),
        "ms_per_frame": times(runs),
        "not_judged": sum(EDGES not in run for run in runs),
        "codes": _counted(run["code"] for run in runs),
        "stopped_by": _counted(run["stopped_by"] for run in runs if run["stopped_by"]),
        "per_case": [_case(run) for run in runs],
    }


def rates(tallies: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Shares, their Wilson intervals (95 %), the counts behind them, and the reliability, over edges tallied as `detection_trial` does."""
    confusion = {
        truth: {called: sum(t["confusion"][truth][called] for t in tallies) for called in ("severed", "connected", "unknown")}
        for truth in ("severed", "connected")
    }
    severed, connected = confusion["severed"], confusion["connected"]
    edges = sum(severed.values()) + sum(connected.values())
    unknown = severed["unknown"] + connected["unknown"]
    correct = severed["severed"] + connected["connected"]
    counts = {
        "detection_accuracy": (correct, edges - unknown),
        "accuracy_unknown_wrong": (correct, edges),
        "precision": (severed["severed"], severed["severed"] + connected["severed"]),
        "recall": (severed["severed"], severed["severed"] + severed["connected"]),
        "specificity": (connected["connected"], connected["connected"] + connected["severed"]),
        "false_severed_rate": (connected["severed"], sum(connected.values())),
        "unknown_rate": (unknown, edges),
    }
    shares = {name: _share(*pair) for name, pair in counts.items()}
    both = shares["recall"], shares["specificity"]
    return {
        "edges": edges,
        **shares,
        "balanced_accuracy": None if both[0] is None or both[1] is None else (both[0] + both[1]) / 2,
        "brier": sum(t["squared_error"] for t in tallies) / edges if edges else None,
        "wilson": {name: wilson(*pair) for name, pair in counts.items()},
        "confusion": confusion,
        "reliability": _reliability(tallies),
    }


def times(runs: Sequence[Run]) -> dict[str, Any]:
    """How long [ms] an update of the tracker took, and how many points it followed: mean and greatest of the cases."""
    took = np.array([ms for run in runs for ms in run["ms"]])
    points = [run["points"] for run in runs if run["points"]]
    if not len(took):
        return {"mean": None, "p99": None, "frames": 0, "points": None}
    return {
        "mean": float(took.mean()),
        "p99": float(np.percentile(took, 99)),
        "frames": len(took),
        "points": {"mean": sum(points) / len(points), "max": max(points)},
    }


def rows(runs: Sequence[Run]) -> list[dict[str, Any]]:
    """One row for each edge across the goal of every case: what it was, and what it was called."""
    about = ("seed", "variant", "scene", "cut", "disturbance")
    return [{**{key: run[key] for key in about}, **row} for run in runs for row in run.get("rows", [])]


def tables(figures: dict[str, Any]) -> list[Table]:
    """What came out, in words: a column for each variant; below it the first one's figures by material, cut and disturbance."""
    variants = figures["variants"]
    made = Table(title=f"Detection: {figures['cases']} cases from seed {figures['seed']}")
    for name in ("", *variants):
        made.add_column(name, justify="right" if name else "left")
    for which, said in ((None, "all edges"), (GOAL_EDGES, "edges across the goal")):
        parts = [part if which is None else part[which] for part in variants.values()]
        made.add_section()
        made.add_row(said, *(f"{part['edges']}" for part in parts))
        for name, words in WORDS.items():
            made.add_row(words, *(_percent(part, name) for part in parts))
        made.add_row("Brier score", *(_number(part["brier"], "{:.4f}") for part in parts))
    made.add_section()
    for said, key in (("tracker, ms a frame: mean", "mean"), ("... 99 in 100 within", "p99")):
        made.add_row(said, *(_number(part["ms_per_frame"][key], "{:.1f}") for part in variants.values()))
    made.add_row("cases not judged", *(f"{part['not_judged']}" for part in variants.values()))
    return [made, _groups(next(iter(variants.values())), next(iter(variants)))]


# ------------------------------------------------------------ inside


def _figures(runs: Sequence[Run], which: str) -> dict[str, Any]:
    judged = [run for run in runs if which in run]
    parts = {
        name: {
            value: _brief([run for run in judged if run[key] == value], which)
            for value in dict.fromkeys(run[key] for run in runs)
        }
        for name, key in GROUPS.items()
    }
    return {**rates([run[which] for run in judged]), **parts}


def _brief(runs: Sequence[Run], which: str) -> dict[str, Any]:
    """A group's figures, without its reliability."""
    figures = rates([run[which] for run in runs])
    del figures["reliability"]
    return {"cases": len(runs), **figures}


def _reliability(tallies: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """For each bin of the probability: how many edges, their mean probability, and the share that is severed in truth."""
    if not tallies:
        return []
    sums = np.sum([t["bins"] for t in tallies], axis=0)
    edge = np.linspace(0.0, 1.0, len(sums) + 1)
    return [
        {
            "from": round(float(edge[k]), 6),
            "to": round(float(edge[k + 1]), 6),
            "count": int(count),
            "mean_predicted": float(predicted / count) if count else None,
            "share_severed": float(severed / count) if count else None,
        }
        for k, (count, predicted, severed) in enumerate(sums)
    ]


def _case(run: Run) -> dict[str, Any]:
    """What a case gave, without its edges."""
    kept = {key: value for key, value in run.items() if key not in ("rows", "ms", EDGES, GOAL_EDGES)}
    counts = {which: run[which]["confusion"] if which in run else None for which in (EDGES, GOAL_EDGES)}
    return {**kept, **counts, "ms_per_frame": float(np.mean(run["ms"])) if run["ms"] else None}


def _groups(figures: dict[str, Any], name: str) -> Table:
    """The figures of one variant by material, disturbance and cut: all edges / those across the goal."""
    made = Table(title=f"{name}: all edges / edges across the goal, in percent")
    for column in ("", "cases", "rightly", "balanced", "false severed", "unknown"):
        made.add_column(column, justify="right" if column else "left")
    keys = ("detection_accuracy", "balanced_accuracy", "false_severed_rate", "unknown_rate")
    for group in GROUPS:
        made.add_section()
        for value, part in figures[group].items():
            goal = figures[GOAL_EDGES][group][value]
            pairs = [" / ".join(_number(of[key], "{:.1%}").rstrip("%") for of in (part, goal)) for key in keys]
            made.add_row(value, str(part["cases"]), *pairs)
    return made


def _percent(figures: dict[str, Any], name: str) -> str:
    """A share, with its interval where that is shown."""
    said = _number(figures[name], "{:.2%}")
    if figures[name] is None or name not in WITH_INTERVAL:
        return said
    low, high = figures["wilson"][name]
    return f"{said}\n{100 * low:.1f} to {100 * high:.1f}"


def _share(count: int, total: int) -> float | None:
    return count / total if total else None


def _number(value: float | None, form: str) -> str:
    return "?" if value is None else form.format(value)


def _counted(words: Any) -> dict[str, int]:
    """How often each word comes, most often first."""
    return dict(sorted(Counter(words).items(), key=lambda item: (-item[1], item[0])))
