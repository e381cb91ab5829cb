"""The exposure experiment's figures from its runs, and the tables that say them in words.

A trial is the runs of one seed by name: `naive_normal`, `goal_normal`, `optimal_full` (all steps), `optimal` (stops by itself), and
ablations. The figures of the method `optimal` take area and curves from the one run, and what is judged from the other.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from rich.table import Table

from hardware.codes import Code
from hardware.interface import Array
from hardware.limits import Limits
from skills.expose.pull import PullConfig
from supervisor.experiments.statistics import mean_sd, wilson

Run = dict[str, Any]
Trial = dict[str, Run]

MAIN = ("optimal", "naive_normal", "goal_normal")
NAIVE = "naive_normal"
FULL = {"optimal": "optimal_full"}  # the run that pulls all steps, where it is not the method's own
STEPS = PullConfig().steps
ANGLES = (0, 15, 30, 45, 60, 90)  # [degrees] between grasp and goal normal
# A command is refused for these only after the gate stopped all motion or ended the lease.
STOPPED = {Code.TRIPPED.value, Code.LEASE_REVOKED.value}


def summary(trials: Sequence[Trial]) -> dict[str, Any]:
    """Figures of every method, curves over the pull, areas by angle, and the trials themselves."""
    names = [*MAIN, *(name for name in trials[0] if name not in MAIN and name not in FULL.values())]
    matched = [matched_areas([_full(trial, name) for name in MAIN]) for trial in trials]
    figures = {name: _method(trials, name) for name in names}
    for k, name in enumerate(MAIN):
        figures[name]["visible_area_matched_tension_px"] = _mean([areas[k] for _, areas in matched if areas])
    for name in names[len(MAIN) :]:
        # Each ablation meets the controller alone, so that it does not change the figures of the three.
        pairs = [matched_areas([trial[name], _full(trial, "optimal")])[1] for trial in trials]
        figures[name]["visible_area_matched_tension_px"] = _mean([areas[0] for areas in pairs if areas])
        figures[name]["optimal_at_that_tension_px"] = _mean([areas[1] for areas in pairs if areas])
    return {
        "methods": figures,
        "curves": {name: curve([_full(trial, name) for trial in trials]) for name in names},
        "by_angle": by_angle(trials, names),
        "per_trial": [_trial(trial, tension, areas) for trial, (tension, areas) in zip(trials, matched, strict=True)],
    }


def judgement(runs: Sequence[Run]) -> dict[str, Any]:
    """How the edges across the goal were judged, summed over runs: rates with Wilson's 95 % intervals, and the counts behind them.

    An unknown edge counts as not correct and as not called severed; `accuracy_of_decided` leaves it out. Edges of one run are not
    independent: the intervals are too narrow.
    """
    sums: Counter[str] = Counter()
    for run in runs:
        sums.update(run["judged"])
    severed, connected = sums["severed"], sums["connected"]
    unknown = sums["severed_unknown"] + sums["connected_unknown"]
    rates = {
        "connectivity_accuracy": (_correct(sums), severed + connected),
        "accuracy_of_decided": (_correct(sums), severed + connected - unknown),
        "unknown_rate": (unknown, severed + connected),
        "true_severed_rate": (sums["severed_called_severed"], severed),
        "false_severed_rate": (sums["connected_called_severed"], connected),
    }
    return {
        **{name: _rate(*counts) for name, counts in rates.items()},
        "wilson": {name: wilson(*counts) for name, counts in rates.items()},
        "edges": dict(sums),
        "not_judged": sum(not run["judged"] for run in runs),
    }


def matched_areas(runs: Sequence[Run]) -> tuple[float | None, list[float]]:
    """The greatest true tension [N] that every run reached, and the area [px] of each there; none if one of them never pulled."""
    if not all(run["curve"] for run in runs):
        return None, []
    tension = min(max(sample["tension_n"] for sample in run["curve"]) for run in runs)
    return tension, [area_at(run, tension) for run in runs]


def area_seen(run: Run) -> float:
    """Area [px] after the last step, before anything more happens to tissue that is left stretched; as found if nothing was pulled."""
    return _area(run["curve"][-1]) if run["curve"] else float(run["visible_area_px"])


def area_at(run: Run, tension: float) -> float:
    """Area [px] seen when the pull first reached `tension` [N], linear between steps.

    A step at no more than an earlier tension is left out, which makes the tension rise.
    """
    rising: list[tuple[float, float]] = []
    for sample in run["curve"]:
        if not rising or sample["tension_n"] > rising[-1][0]:
            rising.append((sample["tension_n"], sample["area_px"]))
    tensions, areas = zip(*rising, strict=True)
    return float(np.interp(tension, tensions, areas))


def curve(runs: Sequence[Run]) -> dict[str, Any]:
    """Area [px], tension [N] and share of edges judged rightly, mean and spread over runs after each step; rates pooled over runs.

    A run that stopped keeps its last value; one that never pulled is left out.
    """
    padded = [_padded(run["curve"]) for run in runs if run["curve"]]
    result: dict[str, Any] = {"n": len(padded), "step": list(range(1, STEPS + 1))}
    for name, of in (("area_px", _area), ("tension_n", _tension), ("accuracy", _accuracy)):
        spreads = [_spread([of(samples[k]) for samples in padded]) for k in range(STEPS)]
        result[name] = {key: [spread[key] for spread in spreads] for key in ("mean", "sd")}
    pooled = [judgement([{"judged": samples[k]} for samples in padded]) for k in range(STEPS)]
    return {**result, **{name: [step[name] for step in pooled] for name in ("true_severed_rate", "false_severed_rate")}}


def by_angle(trials: Sequence[Trial], names: Sequence[str]) -> list[dict[str, Any]]:
    """Mean area [px] of each method after all steps, and its ratio to the naive one's, by the angle between grasp and goal normal."""
    angles = np.degrees([trial[NAIVE]["angle_rad"] for trial in trials])
    bins = []
    for low, high in pairwise(ANGLES):
        inside = [trial for trial, angle in zip(trials, angles, strict=True) if low <= angle < high]
        means = {name: _mean([area_seen(_full(trial, name)) for trial in inside]) for name in names}
        naive = means[NAIVE]
        ratios = {name: mean / naive if mean is not None and naive else None for name, mean in means.items()}
        bins.append({"from_deg": low, "to_deg": high, "n": len(inside), "visible_area_px": means, "ratio_to_naive": ratios})
    return bins


def tables(figures: dict[str, Any]) -> list[Table]:
    """What came out, in words: one column for each method; below it, if there are any, one row for each ablation."""
    methods = {name: figures["methods"][name] for name in MAIN}
    made = Table(title=f"Exposure: {figures['scene']}, {figures['trials']} trials from seed {figures['seed']}")
    for name in ("", *methods):
        made.add_column(name.replace("_", " "), justify="right" if name else "left")

    def row(said: str, value: Any) -> None:
        made.add_row(said, *(value(method) for method in methods.values()))

    row("cut seen after all steps [px]", lambda m: f"{m['visible_area_px']['mean']:.0f} ± {m['visible_area_px']['sd']:.0f}")
    row("... at the same tension", lambda m: _said(m["visible_area_matched_tension_px"], "{:.0f}"))
    row("... once settled, tears included", lambda m: f"{m['visible_area_settled_px']['mean']:.0f}")
    row("edges judged rightly", lambda m: _percent(m, "connectivity_accuracy"))
    row("... of those decided", lambda m: _percent(m, "accuracy_of_decided"))
    row("left unknown", lambda m: _percent(m, "unknown_rate"))
    row("severed edges called severed", lambda m: _percent(m, "true_severed_rate"))
    row("connected edges called severed", lambda m: _percent(m, "false_severed_rate"))
    row("steps until it stopped", lambda m: f"{m['steps']['mean']:.1f}")
    row("greatest tension [N]", lambda m: f"{m['peak_tension_n']:.2f}")
    row("greatest strain", lambda m: f"{m['peak_strain']:.2f}")
    row("tissue torn [times]", lambda m: f"{m['torn']}")
    row("all limits kept", lambda m: "yes" if m["limits"]["kept"] else "NO")
    row("why it stopped", lambda m: "\n".join(f"{code.replace('_', ' ')} {count}" for code, count in m["stopped_by"].items()))
    ablations = {name: method for name, method in figures["methods"].items() if name not in MAIN}
    return [made, _ablation_table(figures["methods"]["optimal"], ablations)] if ablations else [made]


def _ablation_table(optimal: dict[str, Any], ablations: dict[str, Any]) -> Table:
    """Every method after all steps; the second column in brackets: the whole controller at the same tension."""
    made = Table(title="Parts of the controller left out, all steps pulled")
    columns = ("", "cut seen [px]", "at the same tension", "rightly judged", "wrongly severed", "tension [N]", "limits kept")
    for name in columns:
        made.add_column(name, justify="right" if name else "left")
    whole = {**optimal, **optimal["all_steps"], "optimal_at_that_tension_px": None}
    for name, m in {"whole": whole, **ablations}.items():
        same = _said(m["visible_area_matched_tension_px"], "{:.0f}")
        other = _said(m["optimal_at_that_tension_px"], "{:.0f}")
        made.add_row(
            name.replace("_", " "),
            f"{m['visible_area_px']['mean']:.0f} ± {m['visible_area_px']['sd']:.0f}",
            "" if name == "whole" else f"{same} ({other})",
            _said(m["connectivity_accuracy"], "{:.1%}"),
            _said(m["false_severed_rate"], "{:.1%}"),
            f"{m['peak_tension_n']:.2f}",
            "yes" if m["limits"]["kept"] else "NO",
        )
    return made


# ------------------------------------------------------------ one method, one trial


def _method(trials: Sequence[Trial], name: str) -> dict[str, Any]:
    own, full = [trial[name] for trial in trials], [_full(trial, name) for trial in trials]
    tensions, strains = [run["peak_tension_n"] for run in own], [run["peak_strain"] for run in own]
    figures = {
        "visible_area_px": mean_sd([area_seen(run) for run in full]),
        "visible_area_settled_px": mean_sd([run["visible_area_px"] for run in full]),
        "visible_area_matched_tension_px": None,
        **judgement(own),
        "steps": mean_sd([run["steps"] for run in own]),
        "peak_tension_n": max(tensions),
        "peak_tension_mean_n": _mean(tensions),
        "peak_strain": max(strains),
        "peak_strain_mean": _mean(strains),
        "torn": sum(run["torn"] for run in own),
        "stopped_by": _counted(run["stopped_by"] or run["code"] for run in own),
        "failed": _counted(run["code"] for run in own if run["code"] != Code.OK.value),
        "limits": _limits(own if name not in FULL else [*own, *full]),
    }
    if name in FULL:
        figures["all_steps"] = {
            **judgement(full),
            "steps": mean_sd([run["steps"] for run in full]),
            "peak_tension_n": max(run["peak_tension_n"] for run in full),
            "peak_strain": max(run["peak_strain"] for run in full),
            "torn": sum(run["torn"] for run in full),
            "stopped_by": _counted(run["stopped_by"] or run["code"] for run in full),
        }
    return figures


def _limits(runs: Sequence[Run]) -> dict[str, Any]:
    """Whether the tension stayed under what the gate aborts at and nothing tripped; refused commands by how many runs had them."""
    abort = Limits().tension_abort
    peak = max(run["peak_tension_n"] for run in runs)
    stopped = sum(bool(STOPPED & set(run["refused"])) for run in runs)
    return {
        "kept": peak < abort and stopped == 0,
        "tension_abort_n": abort,
        "peak_tension_n": peak,
        "stopped_by_gate": stopped,
        "refused": _counted(code for run in runs for code in run["refused"]),
    }


def _trial(trial: Trial, tension: float | None, areas: list[float]) -> dict[str, Any]:
    first = next(iter(trial.values()))
    setting = {name: first[name] for name in ("seed", "severed_share", "grasp_away_m", "grasp_along_m", "angle_rad")}
    runs = {
        name: {**{key: value for key, value in run.items() if key not in setting and key != "method"}, "curve": _columns(run)}
        for name, run in trial.items()
    }
    return {
        **setting,
        "matched_tension_n": tension,
        "matched_area_px": dict(zip(MAIN, areas, strict=True)) if areas else None,
        "runs": runs,
    }


def _full(trial: Trial, name: str) -> Run:
    return trial[FULL.get(name, name)]


# ------------------------------------------------------------ samples of a curve


def _columns(run: Run) -> dict[str, list[Any]]:
    """A run's curve by column, not by step: a third of the size in JSON."""
    samples = run["curve"]
    plain = {name: [sample[name] for sample in samples] for name in ("step", "area_px", "tension_n", "strain")}
    return {**plain, "accuracy": [_accuracy(sample) for sample in samples]}


def _padded(samples: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """The newest sample at each step 1..STEPS; before the first one, the first."""
    made: Array = np.array([sample["step"] for sample in samples])
    return [samples[max(int(np.searchsorted(made, step, side="right")) - 1, 0)] for step in range(1, STEPS + 1)]


def _area(sample: dict[str, Any]) -> float:
    return float(sample["area_px"])


def _tension(sample: dict[str, Any]) -> float:
    return float(sample["tension_n"])


def _accuracy(sample: dict[str, Any]) -> float | None:
    return _rate(_correct(sample), sample["severed"] + sample["connected"])


def _correct(counts: dict[str, Any]) -> int:
    """Severed edges called severed and connected ones called connected."""
    return int(
        counts["severed_called_severed"] + counts["connected"] - counts["connected_called_severed"] - counts["connected_unknown"]
    )


# ------------------------------------------------------------ small statistics


def _spread(values: Sequence[float | None]) -> dict[str, float | None]:
    known = [value for value in values if value is not None]
    return dict(mean_sd(known)) if known else {"mean": None, "sd": None}


def _mean(values: Sequence[float]) -> float | None:
    return sum(values) / len(values) if values else None


def _rate(count: int, total: int) -> float | None:
    return count / total if total else None


def _counted(words: Any) -> dict[str, int]:
    """How often each word comes, most often first."""
    return dict(sorted(Counter(words).items(), key=lambda item: (-item[1], item[0])))


def _said(value: float | None, form: str) -> str:
    return "?" if value is None else form.format(value)


def _percent(method: dict[str, Any], name: str) -> str:
    low, high = method["wilson"][name]
    return "?" if method[name] is None else f"{method[name]:.1%}\n{low:.0%} to {high:.0%}"
