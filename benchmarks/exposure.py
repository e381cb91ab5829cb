"""Speed and quality of the exposure controller's tissue simulation, beside its peers.

Every side simulates the same sheet (21 x 21 vertices, 1240 edges and 1160 hinges), pulled the same way, with the same number of
constraint projections; only its way of solving differs. Rounds are interleaved in a new order each, so that a busy machine slows all
alike. Peers that are not installed are left out and named. Also: a whole MPPI update, its smoothing, the error of the fast solver
against the reference, convergence, and how the cost grows. Run: `python -m benchmarks.exposure --json b.json --plot b.svg`.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import statistics
import time
from collections.abc import Callable, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.exposure_convergence import convergence
from benchmarks.exposure_plot import plot
from benchmarks.exposure_update import Scene, mppi_update, scene, smoothing_problems
from benchmarks.peers import missing
from benchmarks.peers.newton_xpbd import NewtonRunner
from benchmarks.peers.ours import OurRunner
from benchmarks.peers.pypbd_xpbd import PypbdRunner
from benchmarks.peers.sheet import PULL, Load, PeerError, Runner, check, sheet
from benchmarks.peers.torch_mppi import TorchMppiRunner
from skills.expose.mppi import controls, perturbations
from skills.expose.xpbd_reference import reference_rollout
from supervisor.warp_start import start_warp

PAUSE = 0.02  # s before each run: the threads of the one before still spin for a while, waiting for work
MESHES, SAMPLES, HORIZON = (21, 31, 40), 128, 8  # of the MPPI updates
SCALED = Load(worlds=128, steps=4)  # what the scaling varies one number of
PACKAGES = ("numpy", "warp-lang", "torch", "casadi", "newton", "pypbd", "pytorch_mppi")


def interleaved(sides: dict[str, Callable[[], float]], rounds: int, rng: np.random.Generator) -> dict[str, list[float]]:
    """What each side measures, run once in every round, in an order drawn anew."""
    found: dict[str, list[float]] = {name: [] for name in sides}
    names = list(sides)
    for _ in range(rounds):
        for k in rng.permutation(len(names)):
            time.sleep(PAUSE)
            found[names[k]].append(sides[names[k]]())
    return found


def seconds(call: Callable[[], object]) -> float:
    """Duration of `call` [s]."""
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def spread(values: Sequence[float], factor: float = 1.0, digits: int = 3) -> dict[str, float]:
    """Median, least and greatest of `values`, times `factor`."""
    return {name: round(factor * f(values), digits) for name, f in (("median", statistics.median), ("min", min), ("max", max))}


def comparison(rounds: int, cores: int, rng: np.random.Generator) -> list[dict[str, Any]]:
    """A row for each side: nanoseconds per projection, or why there are none."""
    flat, load = sheet(), Load()
    makers: list[tuple[str, str, str, Callable[[], Runner]]] = [
        (f"ours, {n} thread{'s' if n > 1 else ''}", "Gauss-Seidel", "", lambda n=n: OurRunner(flat, load, threads=n))  # type: ignore[misc]
        for n in sorted({1, cores})
    ]
    makers += [
        (NewtonRunner.name, NewtonRunner.scheme, "newton", lambda: NewtonRunner(flat, load)),
        (PypbdRunner.name, PypbdRunner.scheme, "pypbd", lambda: PypbdRunner(flat, load)),
        (TorchMppiRunner.name, TorchMppiRunner.scheme, "pytorch_mppi", lambda: TorchMppiRunner(flat, load, threads=cores)),
    ]
    rows: list[dict[str, Any]] = []
    ready: dict[str, Callable[[], float]] = {}
    for name, scheme, module, make in makers:
        rows.append({"name": name, "scheme": scheme, "ns_per_projection": None})
        why = missing(module) if module else None
        if why is not None:
            rows[-1]["missing"] = why
            continue
        runner = make()
        rows[-1]["note"] = runner.note

        def run(runner: Runner = runner) -> float:
            runner.reset()
            taken = seconds(runner.run)
            check(flat, load, runner.positions(), runner.name)
            return taken

        try:
            for _ in range(2):  # compiles, and fills the caches
                run()
        except PeerError as error:
            rows[-1]["discarded"] = str(error)
            continue
        ready[name] = run
    for name, taken in interleaved(ready, rounds, rng).items():
        row = next(row for row in rows if row["name"] == name)
        row["ns_per_projection"] = spread(taken, 1e9 / load.projections(flat))
    return rows


def ratio(rows: list[dict[str, Any]], peer: str, ours: str) -> float | None:
    """How many times as long as ours the peer takes for a projection; None if either was not measured."""
    median = {row["name"]: row["ns_per_projection"]["median"] for row in rows if row["ns_per_projection"]}
    return round(median[peer] / median[ours], 2) if peer in median and ours in median else None


def updates(rounds: int, cores: int, rng: np.random.Generator) -> tuple[dict[str, Any], dict[str, float]]:
    """Whole MPPI updates for each mesh, each going on from the one before, and the smoothing alone [ms]."""
    scenes = {f"{side}x{side}x{SAMPLES}x{HORIZON}": scene(side, SAMPLES, HORIZON, cores) for side in MESHES}

    def update(name: str) -> float:
        start = time.perf_counter()
        plan = mppi_update(scenes[name])
        taken = time.perf_counter() - start
        if not np.abs(plan.step).max() > 0.0:
            raise PeerError(f"the update gave no motion: {plan.message}")
        return taken

    sides: dict[str, Callable[[], float]] = {name: lambda name=name: update(name) for name in scenes}  # type: ignore[misc]
    interleaved(sides, 1, rng)
    found = {name: spread(taken, 1e3, 1) for name, taken in interleaved(sides, rounds, rng).items()}
    smoother = next(iter(scenes.values())).smoother
    problems = smoothing_problems(next(iter(scenes.values())), 60, rng)
    smoother.solve(problems[0])
    return found, spread([seconds(lambda problem=problem: smoother.solve(problem)) for problem in problems], 1e3)  # type: ignore[misc]


def state_error(made: Scene, rng: np.random.Generator) -> float:
    """The greatest distance [m] of a vertex from where the float64 reference puts it, after all steps of the horizon."""
    model, config = made.model, made.solver.config
    steps = controls(
        np.tile(0.3e-3 * made.toward, (made.config.horizon, 1)), perturbations(rng, made.config), made.config.max_step
    )
    fast = made.solver.rollout(made.state, steps).final().positions
    exact = reference_rollout(
        model,
        made.state.positions.astype(np.float64),
        made.state.adhesion.astype(np.float64),
        made.state.joined.astype(np.float64),
        steps,
        inertia=config.newtons_per_metre(model),
        substeps=config.substeps,
        iterations=config.iterations,
    )
    return float(np.linalg.norm(fast - exact.positions[-1], axis=-1).max())


def scaling(rounds: int, cores: int, rng: np.random.Generator) -> dict[str, Any]:
    """Duration of a rollout [ms] against samples, horizon and mesh, one varied at a time, on the flat sheet."""
    base = f"h {SCALED.steps}, 21 x 21", f"K {SCALED.worlds}, 21 x 21", f"K {SCALED.worlds}, h {SCALED.steps}"
    families: dict[str, tuple[str, str, list[tuple[int, int, Load]]]] = {
        "samples": ("K", base[0], [(k, 21, Load(k, SCALED.steps)) for k in (8, 16, 32, 64, 128, 256, 512)]),
        "horizon": ("h", base[1], [(h, 21, Load(SCALED.worlds, h)) for h in (1, 2, 4, 8, 16)]),
        "mesh": ("constraints", base[2], [(sheet(n).constraints, n, SCALED) for n in (11, 16, 21, 26, 31, 36, 41)]),
    }
    runners = {
        (key, x): OurRunner(sheet(side), load, threads=cores)
        for key, (_, _, cases) in families.items()
        for x, side, load in cases
    }
    sides: dict[str, Callable[[], float]] = {
        f"{key} {x}": lambda runner=runner: seconds(runner.run)  # type: ignore[misc]
        for (key, x), runner in runners.items()
    }
    interleaved(sides, 1, rng)
    taken = interleaved(sides, rounds, rng)
    found: dict[str, Any] = {}
    for key, (axis, setting, cases) in families.items():
        points = [{axis: x, "side": side, "ms": spread(taken[f"{key} {x}"], 1e3)} for x, side, _ in cases]
        upper = slice(len(cases) // 2, None)
        medians = [statistics.median(taken[f"{key} {x}"]) for x, _, _ in cases]
        slope = np.polyfit(np.log([float(x) for x, _, _ in cases[upper]]), np.log(medians[upper]), 1)[0]
        found[key] = {"setting": setting, "exponent": round(float(slope), 3), "points": points}
    return found


def versions() -> dict[str, str]:
    """Of Python and of every package that takes part and is installed."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def processor() -> str:
    """The processor's model, where the system tells it."""
    listing = Path("/proc/cpuinfo")
    lines = listing.read_text().splitlines() if listing.exists() else []
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def measure(rounds: int, seed: int) -> dict[str, Any]:
    """All figures."""
    rng = np.random.default_rng(seed)
    cores = len(os.sched_getaffinity(0))
    load_before = os.getloadavg()[0]
    rows = comparison(rounds, cores, rng)
    update_ms, smoothing_ms = updates(rounds, cores, rng)
    ours = next(row["name"] for row in reversed(rows) if row["name"].startswith("ours"))
    flat, load = sheet(), Load()
    return {
        "rows": rows,
        "ratio_newton": ratio(rows, NewtonRunner.name, ours),
        "ratio_newton_one_thread": ratio(rows, NewtonRunner.name, "ours, 1 thread"),
        "ratio_pypbd": ratio(rows, PypbdRunner.name, ours),
        "ratio_pytorch_mppi": ratio(rows, TorchMppiRunner.name, ours),
        "mppi_update_ms": update_ms,
        "smoothing_ms": smoothing_ms,
        "state_error_m": state_error(scene(21, 8, HORIZON, cores), rng),
        "convergence": convergence(),
        "scaling": scaling(max(3, rounds // 2), cores, rng),
        "workload": {
            "vertices": len(flat.rest),
            "edges": len(flat.edges),
            "hinges": len(flat.hinges),
            "worlds": load.worlds,
            "steps": load.steps,
            "substeps": load.substeps,
            "iterations": load.iterations,
            "projections": load.projections(flat),
            "pull_m_per_step": float(np.linalg.norm(PULL)),
        },
        "rounds": rounds,
        "machine": {
            "cores": cores,
            "processor": processor(),
            "load_average_before": round(load_before, 2),
            "load_average_after": round(os.getloadavg()[0], 2),
        },
        "versions": versions(),
    }


def told(figures: dict[str, Any]) -> str:
    """The figures as a person reads them."""
    lines = []
    for row in figures["rows"]:
        ns = row["ns_per_projection"]
        said = (
            f"{ns['median']:7.2f} ns a projection [{ns['min']:.2f} to {ns['max']:.2f}]"
            if ns
            else row.get("missing", row.get("discarded"))
        )
        lines.append(f"{row['name']:22s}{row['scheme']:14s}{said}")
    for name, ms in figures["mppi_update_ms"].items():
        lines.append(f"{'MPPI update':22s}{name:14s}{ms['median']:7.1f} ms [{ms['min']:.1f} to {ms['max']:.1f}]")
    ms = figures["smoothing_ms"]
    lines.append(f"{'smoothing':36s}{ms['median']:7.2f} ms [{ms['min']:.2f} to {ms['max']:.2f}]")
    lines.append(f"{'fast form and reference differ by':36s}{figures['state_error_m'] * 1e6:7.2f} um at most")
    growth = figures["scaling"]
    for key, name in (("samples", "K"), ("horizon", "h"), ("mesh", "the mesh's constraints")):
        lines.append(f"cost grows with {name} to the power of {growth[key]['exponent']:.2f}")
    for case in figures["convergence"]["cases"]:
        for name, left in case["residual"].items():
            at = figures["convergence"]["iterations"].index(10)
            share = f"{left[at]:.2g}" if left[at] is not None and math.isfinite(left[at]) else "no number"
            lines.append(
                f"{name}, stiffness {case['stiffness_over_inertia']:g}: {share} of the imbalance left after 10 iterations"
            )
    machine = figures["machine"]
    loads = f"{machine['load_average_before']} before, {machine['load_average_after']} after"
    lines.append(f"{machine['cores']} cores ({machine['processor']}), load average {loads}")
    return "\n".join(lines)


def main() -> None:
    """Measure, print, and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])  # type: ignore[union-attr]
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--plot", type=Path, help="draw scaling and convergence to this .svg file")
    parser.add_argument("--rounds", type=int, default=11, help="of every comparison (default 11)")
    parser.add_argument("--seed", type=int, default=1, help="of the order and of the sampled controls (default 1)")
    options = parser.parse_args()
    start_warp()
    if options.rounds < 1:
        parser.error(f"--rounds must be at least 1, not {options.rounds}")
    if options.plot is not None and options.plot.suffix != ".svg":
        parser.error(f"--plot writes SVG; give a name that ends in .svg, not {options.plot.name}")
    figures = measure(options.rounds, options.seed)
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")
    if options.plot is not None:
        options.plot.write_text(plot(figures), encoding="utf-8")
    print(told(figures))


if __name__ == "__main__":
    main()
