"""The command line: `dissect run`, `watch`, `replay`, `doctor`, `look`, `deadman`, `serve-stub`, `experiment`."""

from __future__ import annotations

import dataclasses
import logging
import os
import sys
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console
from rich.markup import escape
from rich.text import Text

from hardware.codes import InputError
from supervisor.cli_experiments import experiment
from supervisor.cli_options import (
    Agent,
    Approve,
    BenchKind,
    BenchOption,
    ConfigOption,
    Cover,
    CoverOption,
    Expose,
    ExposeOption,
    JsonOption,
    Rule,
    RuleOption,
    SceneOption,
    TrackerOption,
    ViewKind,
    WeightsOption,
    robot_file,
    write_json,
)
from supervisor.cli_robot import deadman, look, serve_stub

app = typer.Typer(
    help="Supervises autonomous tissue dissection. Research software, not for clinical use.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.add_typer(experiment, name="experiment")

SESSIONS = Path("sessions")


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
    from hardware.dvrk.bench import BenchDVRK
    from hardware.stub.scene import load_scene
    from skills.estimate.rule import Rule as EdgeRule
    from supervisor.approvers import AutoApprover, PromptApprover
    from supervisor.choices import Choices
    from supervisor.robot import agree_to_power, connect
    from supervisor.run import RunOptions, exit_status, prepare, prepare_robot
    from supervisor.run import run as run_session
    from supervisor.skillset import ExposureKind
    from supervisor.terminal import TerminalView
    from supervisor.view_rerun import RerunView
    from supervisor.warp_start import start_warp

    console = Console()
    robot = robot_file(bench_kind, config)
    if robot is not None and approve is Approve.AUTO:
        raise InputError("on a robot every goal is approved by the operator; leave --approve auto out")
    asks = robot is not None or approve is Approve.PROMPT
    loaded = load_scene(scene) if robot is None else None
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
        bench, checked = prepare(options) if robot is None else prepare_robot(options, connect(robot, ask))
    if isinstance(bench, BenchDVRK):
        agree_to_power(bench, ask)
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
    write_json(json_file, dataclasses.asdict(result))
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

    robot = robot_file(bench_kind, config)
    checks = diagnose(Path())
    if robot is not None:
        from supervisor.robot import diagnose_robot

        with Console().status("listening to the robot"):
            checks += diagnose_robot(robot)
    write_json(json_file, plain(checks))
    Console().print(table(checks))
    raise typer.Exit(0 if able(checks) else 1)


app.command()(look)
app.command()(deadman)
app.command(name="serve-stub")(serve_stub)


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


def _new_folder(scene: str, seed: int) -> Path:
    """A folder under sessions/ that is not there yet."""
    number = 1
    while (folder := SESSIONS / f"{scene}-seed{seed}-{number:03d}").exists():
        number += 1
    return folder


if __name__ == "__main__":
    main()
