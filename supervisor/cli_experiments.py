"""`dissect experiment`: the paper's experiments on the stub bench, each with its progress and its figures."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from supervisor.cli_options import (
    Agent,
    Expose,
    ExposeOption,
    JsonOption,
    SceneOption,
    TrackerOption,
    WeightsOption,
    write_json,
)

experiment = typer.Typer(help="The paper's experiments, on the stub bench.", no_args_is_help=True)


@experiment.command()
def autonomy(
    scene: SceneOption = "silicone",
    agent: Annotated[Agent, typer.Option(help="Dissection agent.")] = Agent.PLANNING,
    expose: ExposeOption = Expose.OPTIMAL,
    feedback: Annotated[bool, typer.Option(help="With or without feedback.")] = True,
    attempts: Annotated[int, typer.Option(min=1, max=20)] = 3,
    trials: Annotated[int, typer.Option(min=1)] = 40,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first trial; the others count up.")] = 0,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; default: one for each core.")] = None,
    json_file: JsonOption = None,
) -> None:
    """How far an agent gets by itself, with and without feedback (paper, Evaluation of Dissection Autonomy)."""
    from hardware.stub.scene import load_scene
    from supervisor.experiments.autonomy import AutonomySettings, run_experiment

    load_scene(scene)
    settings = AutonomySettings(scene, agent.value, feedback, attempts, trials, seed, expose.value)
    journal = (json_file or Path("autonomy.json")).with_suffix(".trials.jsonl")
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    console = Console()
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("trials", total=trials)
        successes = 0

        def progress(trial: dict[str, Any]) -> None:
            nonlocal successes
            successes += bool(trial["success"])
            bar.update(task, advance=1, description=f"trials ({successes} succeeded)")

        try:
            figures = run_experiment(settings, journal, workers, progress)
        except KeyboardInterrupt:
            console.print(f"Interrupted. The trials that ended are in {journal}; the same command goes on after them.")
            raise typer.Exit(3) from None
    write_json(json_file, figures)
    low, high = figures["success_ci95"]
    deviation = figures["length_deviation_m"]
    console.print(
        f"success {figures['success_rate']:.0%} (95 % CI {low:.0%} to {high:.0%}), "
        f"length deviation {deviation['mean'] * 1e3:.2f} ± {deviation['sd'] * 1e3:.2f} mm, "
        f"{figures['attachments']['mean']:.2f} attachments a trial, false done {figures['false_done_rate']:.1%}, "
        f"{figures['wall_s']:.0f} s"
    )


@experiment.command()
def exposure(
    scene: SceneOption = "chicken",
    trials: Annotated[int, typer.Option(min=1, help="Seeds; on each, every method pulls.")] = 20,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first trial; the others count up.")] = 0,
    tilt: Annotated[float | None, typer.Option(help="Look from this angle [degrees] from the vertical.")] = None,
    ablation: Annotated[bool, typer.Option("--ablation", help="Pull with the controller's parts left out, too.")] = False,
    pictures: Annotated[Path | None, typer.Option(help="Folder for pictures of the first seeds.")] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; default: one for each core.")] = None,
    json_file: JsonOption = None,
) -> None:
    """How much of the cut is seen, and what is judged from it (paper, Evaluation of Exposure Maximization Control)."""
    from supervisor.experiments.exposure import ExposureSettings, run_experiment, variants
    from supervisor.experiments.exposure_summary import tables
    from supervisor.plain import plain

    settings = ExposureSettings(scene, trials, seed, ablation, tilt)
    settings.load()
    journal = (json_file or Path("exposure.json")).with_suffix(".trials.jsonl")
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    console = Console()
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("pulls", total=trials * len(variants(ablation)))

        def progress(run: dict[str, Any]) -> None:
            bar.update(task, advance=1, description=f"pulls (seed {run['seed']}, {run['method'].replace('_', ' ')})")

        try:
            figures = run_experiment(settings, journal, workers, progress, pictures)
        except KeyboardInterrupt:
            console.print(f"Interrupted. The pulls that ended are in {journal}; the same command goes on after them.")
            raise typer.Exit(3) from None
    write_json(json_file, plain(figures))
    console.print(*tables(figures), f"{figures['wall_s']:.0f} s", sep="\n")


@experiment.command()
def detection(
    cases: Annotated[int, typer.Option(min=1, help="Seeds; each is a tissue, a cut, an expert's pull and a disturbance.")] = 50,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the first case; the others count up.")] = 0,
    tracker: TrackerOption = "dis",
    weights: WeightsOption = None,
    device: Annotated[str, typer.Option(help="Where a learned tracker computes: cpu, or a GPU such as cuda:0.")] = "cpu",
    compare: Annotated[
        bool, typer.Option("--compare", help="Judge by lk, by dis chained and by the elongation rule, too.")
    ] = False,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; default: one for each core.")] = None,
    json_file: JsonOption = None,
) -> None:
    """Which edges are judged connected or severed, and how rightly (paper, Evaluation of Dissection Feedback)."""
    from supervisor.experiments.detection import DetectionSettings, run_experiment, variants, write_rows
    from supervisor.experiments.detection_summary import tables
    from supervisor.plain import plain

    settings = DetectionSettings(cases, seed, tracker, weights, device, compare)
    result = json_file or Path("detection.json")
    journal = result.with_suffix(".trials.jsonl")
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    console = Console()
    with Progress(*columns, console=console) as bar:
        task = bar.add_task("pulls", total=cases * len(variants(settings)))

        def progress(run: dict[str, Any]) -> None:
            bar.update(task, advance=1, description=f"pulls (seed {run['seed']}, {run['variant']})")

        try:
            figures, edges = run_experiment(settings, journal, workers, progress)
        except KeyboardInterrupt:
            console.print(f"Interrupted. The pulls that ended are in {journal}; the same command goes on after them.")
            raise typer.Exit(3) from None
    write_json(json_file, plain(figures))
    if json_file is not None:
        write_rows(result.with_suffix(".edges.jsonl"), edges)
    console.print(*tables(figures), f"{figures['wall_s']:.0f} s", sep="\n")
