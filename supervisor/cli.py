"""The command line: `dissect run`, `watch`, `replay`, `doctor`, `serve-stub`, `experiment`."""

from __future__ import annotations

import dataclasses
import json
import logging
import os
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.text import Text

from hardware.codes import InputError

app = typer.Typer(
    help="Supervises autonomous tissue dissection. Research software, not for clinical use.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
experiment = typer.Typer(help="The paper's experiments, on the stub bench.", no_args_is_help=True)
app.add_typer(experiment, name="experiment")

SESSIONS = Path("sessions")


class Agent(StrEnum):
    """Dissection agents."""

    PLANNING = "planning"


class Expose(StrEnum):
    """How the tissue is pulled to see the cut; the same words as `supervisor.skillset.ExposureKind`, without what it imports."""

    OPTIMAL = "optimal"
    NAIVE = "naive"
    GOAL_NORMAL = "goal-normal"


class Rule(StrEnum):
    """How edges are judged; the same words as `skills.estimate.rule.Rule`, without what it imports."""

    LIKELIHOOD = "likelihood"
    ELONGATION = "elongation"


class Cover(StrEnum):
    """How the corrective segments are chosen."""

    OPTIMAL = "optimal"
    GREEDY = "greedy"


class Approve(StrEnum):
    """Who approves goals."""

    AUTO = "auto"
    PROMPT = "prompt"


class BenchKind(StrEnum):
    """What a session runs on."""

    STUB = "stub"
    DVRK = "dvrk"


class ViewKind(StrEnum):
    """What shows a running session."""

    TERMINAL = "terminal"
    RERUN = "rerun"
    NONE = "none"


SceneOption = Annotated[str, typer.Option(help="Name of a scene, or a .toml file.")]
ExposeOption = Annotated[
    Expose,
    typer.Option(help="Plan the pull (optimal), or pull straight: from the goal's middle to the grasp, or across the goal."),
]
RuleOption = Annotated[
    Rule, typer.Option(help="Judge edges by the whole pull (likelihood), or by the paper's threshold on length (elongation).")
]
CoverOption = Annotated[
    Cover, typer.Option(help="Correct with the fewest segments, proven (optimal), or by the paper's greedy choice (greedy).")
]
TrackerOption = Annotated[
    str, typer.Option(help="dis, dis-chained, lk, litetracker, cotracker3, raft, or a tracker exported to .onnx or .pt2.")
]
WeightsOption = Annotated[Path | None, typer.Option("--tracker-weights", help="Checkpoint file of a learned tracker.")]
BenchOption = Annotated[BenchKind, typer.Option("--bench", help="The simulated bench, or a da Vinci Research Kit.")]
ConfigOption = Annotated[Path | None, typer.Option("--config", help="The robot's configuration (robot.toml), for --bench dvrk.")]
JsonOption = Annotated[Path | None, typer.Option("--json", help="Write the result as JSON to this file.")]


@app.command()
def run(
    bench_kind: BenchOption = BenchKind.STUB,
    config: ConfigOption = None,
    scene: SceneOption = "silicone",
    goal: Annotated[
        Path | None, typer.Option(help="Goal file (JSON); default, on the stub alone: what an expert would draw on the scene.")
    ] = None,
    agent: Annotated[Agent, typer.Option(help="Dissection agent.")] = Agent.PLANNING,
    expose: ExposeOption = Expose.OPTIMAL,
    rule: RuleOption = Rule.LIKELIHOOD,
    cover: CoverOption = Cover.OPTIMAL,
    tracker: TrackerOption = "dis",
    weights: WeightsOption = None,
    device: Annotated[
        str,
        typer.Option(help="Where the exposure is planned and a learned tracker computes: auto, cpu, or a GPU such as cuda:0."),
    ] = "auto",
    attempts: Annotated[int, typer.Option(min=1, max=20, help="Most attempts.")] = 3,
    feedback: Annotated[bool, typer.Option(help="Expose, estimate and replan after each attempt.")] = True,
    seed: Annotated[int, typer.Option(min=0, help="Gives every random draw.")] = 0,
    record: Annotated[Path | None, typer.Option(help="Folder of the record; default: a new one under sessions/.")] = None,
    approve: Annotated[
        Approve | None, typer.Option(help="Approve goals automatically (the stub's default), or ask at the terminal.")
    ] = None,
    view: Annotated[ViewKind, typer.Option(help="What shows the session while it runs.")] = ViewKind.TERMINAL,
    json_file: JsonOption = None,
) -> None:
    """Run one supervised session on the stub bench or on a robot, where every goal is approved by the operator."""
    from hardware.stub.scene import load_scene
    from skills.estimate.rule import Rule as EdgeRule
    from supervisor.approvers import AutoApprover, PromptApprover
    from supervisor.choices import Choices
    from supervisor.robot import connect
    from supervisor.run import RunOptions, exit_status, prepare, prepare_robot
    from supervisor.run import run as run_session
    from supervisor.skillset import ExposureKind
    from supervisor.terminal import TerminalView
    from supervisor.view_rerun import RerunView
    from supervisor.warp_start import start_warp

    console = Console()
    robot_file = _robot_file(bench_kind, config)
    if robot_file is not None and approve is Approve.AUTO:
        raise InputError("on a robot every goal is approved by the operator; leave --approve auto out")
    asks = robot_file is not None or approve is Approve.PROMPT
    loaded = load_scene(scene) if robot_file is None else None
    name = "robot" if loaded is None else loaded.name
    folder = record or _new_folder(name, seed)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"the record folder {folder} is already there and not empty; name a new one")
    covering: Literal["optimal", "greedy"] = "greedy" if cover is Cover.GREEDY else "optimal"
    choices = Choices(ExposureKind(expose.value), EdgeRule(rule.value), covering, tracker, weights, device)
    options = RunOptions(loaded, goal, agent.value, attempts, feedback, seed, folder, asks, choices)
    terminal: TerminalView | None = None

    def ask(question: str) -> str:
        if terminal is not None:
            terminal.pause()
        return console.input(question, markup=False)

    start_warp()
    with console.status("preparing the bench (the first run compiles its kernels)"):
        bench, checked = prepare(options) if robot_file is None else prepare_robot(options, connect(robot_file, ask))
    rerun = None
    if view is ViewKind.RERUN:
        folder.mkdir(parents=True, exist_ok=True)
        rerun = RerunView(folder, serve=True)
        console.print(rerun.how_to_open)
    terminal = None if view is ViewKind.NONE else TerminalView(console, title=f"{name}, seed {seed}")
    approver = PromptApprover(ask) if asks else AutoApprover()
    try:
        result = run_session(options, bench, checked, approver, [] if terminal is None else [terminal], rerun)
    except KeyboardInterrupt:
        console.print(f"\nInterrupted: both arms hold. Record and report are in {folder}.")
        raise typer.Exit(3) from None
    _write_json(json_file, dataclasses.asdict(result))
    console.print(f"\n[bold]{result.outcome}[/bold]: {escape(result.message)}")
    took = f"{result.attempts} attempt{'' if result.attempts == 1 else 's'}, {result.wall_s:.0f} s."
    if result.length_deviation_m is None:
        console.print(took)
    else:
        judged = "success" if result.success else "no success"
        strands = f"{result.attachments} attachment{'' if result.attachments == 1 else 's'} left"
        deviation = f"length deviation {result.length_deviation_m * 1e3:.1f} mm"
        console.print(f"Judged by the mesh: {judged}; {strands}, {deviation}, {took}")
    console.print(f"Record: {folder}\nReport: {folder / 'report.html'}")
    raise typer.Exit(exit_status(result.code))


@app.command()
def replay(folder: Annotated[Path, typer.Argument(help="Folder of a recorded session.")]) -> None:
    """Show the timeline of a recorded session, closed or not."""
    from supervisor.reading import read
    from supervisor.replay import timeline

    console = Console()
    for line in timeline(read(folder)):
        console.print(line)


@app.command()
def watch(where: Annotated[Path, typer.Argument(help="A session's folder, or the folder of all sessions.")] = SESSIONS) -> None:
    """Show a session that is running in another terminal."""
    from supervisor.watch import watch as watch_session

    watch_session(where, Console())


@app.command()
def doctor(bench_kind: BenchOption = BenchKind.STUB, config: ConfigOption = None, json_file: JsonOption = None) -> None:
    """Say what this machine can and cannot run, and why; with --bench dvrk also what a robot tells, and what would block a session."""
    from supervisor.doctor import able, diagnose, table
    from supervisor.plain import plain

    robot_file = _robot_file(bench_kind, config)
    checks = diagnose(Path())
    if robot_file is not None:
        from supervisor.robot import diagnose_robot

        with Console().status("listening to the robot"):
            checks += diagnose_robot(robot_file)
    _write_json(json_file, plain(checks))
    Console().print(table(checks))
    raise typer.Exit(0 if able(checks) else 1)


@app.command(name="serve-stub")
def serve_stub(
    scene: SceneOption = "silicone",
    seed: Annotated[int, typer.Option(min=0, help="Gives every random draw.")] = 0,
    folder: Annotated[
        Path, typer.Option(help="Where robot.toml, the hand-eye files, goal.json and, at the end, truth.json go.")
    ] = Path("stub-robot"),
    transport: Annotated[str, typer.Option(help="ros1 (ROS_MASTER_URI) or ros2.")] = "ros1",
    prefix: Annotated[str, typer.Option(help="Namespace in front of all topics, such as /dvrk.")] = "",
    pictures: Annotated[float, typer.Option(min=0.1, max=30.0, help="Most pairs of images per second.")] = 10.0,
) -> None:
    """Publish the stub bench as a da Vinci robot on a ROS graph, until interrupted; then write the truth about the tissue."""
    import shlex

    from hardware.stub.scene import load_scene
    from supervisor.serve_stub import ServeOptions, serve
    from supervisor.warp_start import start_warp

    console = Console()
    options = ServeOptions(load_scene(scene), seed, folder, transport, prefix, pictures)
    start_warp()

    def ready(robot: Path, drawn: Path) -> None:
        console.print(
            f"{options.scene.name}, seed {seed}, is on the graph. Its configuration: {escape(str(robot))}", soft_wrap=True
        )
        command = shlex.join(["dissect", "run", "--bench", "dvrk", "--config", str(robot), "--goal", str(drawn)])
        console.print(command, style="bold", markup=False, highlight=False, soft_wrap=True)

    serve(options, ready)


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
    _write_json(json_file, figures)
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
    _write_json(json_file, plain(figures))
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
    _write_json(json_file, plain(figures))
    if json_file is not None:
        write_rows(result.with_suffix(".edges.jsonl"), edges)
    console.print(*tables(figures), f"{figures['wall_s']:.0f} s", sep="\n")


def main() -> None:
    """Entry point: bad input is one sentence and exit status 2."""
    logging.basicConfig(level=os.environ.get("DISSECT_LOG", "ERROR"), format="%(levelname)s %(name)s: %(message)s")
    try:
        app()
    except InputError as error:
        sentence = str(error).rstrip(".")
        said = Text.assemble(("dissect: ", "red"), f"{sentence[0].lower()}{sentence[1:]}.")
        Console(stderr=True).print(said, soft_wrap=True)
        sys.exit(2)


def _robot_file(bench: BenchKind, config: Path | None) -> Path | None:
    """The robot's configuration; None on the stub."""
    if bench is BenchKind.STUB:
        if config is not None:
            raise InputError("--config is for a robot: give --bench dvrk too, or leave it out")
        return None
    if config is None:
        raise InputError("--bench dvrk needs the robot's configuration: --config robot.toml (docs/robot.toml explains it)")
    return config


def _new_folder(scene: str, seed: int) -> Path:
    """A folder under sessions/ that is not there yet."""
    number = 1
    while (folder := SESSIONS / f"{scene}-seed{seed}-{number:03d}").exists():
        number += 1
    return folder


def _write_json(path: Path | None, data: Any) -> None:
    if path is None:
        return
    try:
        path.write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from error


if __name__ == "__main__":
    main()
