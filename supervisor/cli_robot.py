"""Commands around a robot: `dissect look`, a picture to draw the goal on, `deadman`, and `serve-stub`, a robot to try everything on."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape

from supervisor.cli_options import BenchKind, BenchOption, ConfigOption, SceneOption, robot_file


def look(
    bench_kind: BenchOption = BenchKind.STUB,
    config: ConfigOption = None,
    scene: SceneOption = "silicone",
    seed: Annotated[int, typer.Option(min=0, help="Of the stub bench's random draws.")] = 0,
    out: Annotated[Path, typer.Option(help="Where the picture goes (.png).")] = Path("look.png"),
) -> None:
    """Save the left picture, rectified, as a session sees it: a goal's points are its pixels. Nothing moves or is commanded."""
    from hardware.stub.scene import load_scene
    from supervisor.look import look_at_robot, look_at_stub, save_picture

    file = robot_file(bench_kind, config)
    image = look_at_stub(load_scene(scene), seed) if file is None else look_at_robot(file)
    save_picture(image, out)
    height, width = image.shape[:2]
    said = f'{out}: {width} x {height} pixels. A goal drawn on it has "image_size": [{width}, {height}].'
    Console().print(said, markup=False, highlight=False, soft_wrap=True)


def deadman(
    config: Annotated[
        Path, typer.Option("--config", help="The robot's configuration (robot.toml), which names arms and transport.")
    ],
    budget: Annotated[float, typer.Option(help="Seconds without a heartbeat until the arms are held.")] = 0.1,
) -> None:
    """Hold both arms of robot.toml when the supervisor dies: `python -m hardware.dvrk.deadman` with what it is to be told."""
    from hardware.dvrk import deadman as process
    from hardware.dvrk.config import load_robot

    robot = load_robot(config)
    root = logging.getLogger()
    root.handlers.clear()  # it says what it does by the log, in a form of its own
    root.setLevel(logging.WARNING)
    arms = [robot.topic(arm.name) for arm in robot.arms]
    raise typer.Exit(process.main([*arms, "--transport", robot.transport, "--budget", str(budget)]))


def serve_stub(
    scene: SceneOption = "silicone",
    seed: Annotated[int, typer.Option(min=0, help="Gives every random draw.")] = 0,
    folder: Annotated[
        Path, typer.Option(help="Where robot.toml, the hand-eye files, goal.json and, at the end, truth.json go.")
    ] = Path("stub-robot"),
    transport: Annotated[str, typer.Option(help="ros1 (ROS_MASTER_URI) or ros2.")] = "ros1",
    prefix: Annotated[str, typer.Option(help="Namespace in front of all topics, such as /dvrk.")] = "",
    pictures: Annotated[float, typer.Option(min=0.1, max=30.0, help="Most pairs of images per second.")] = 10.0,
    cutter: Annotated[str, typer.Option(help="What PSM2 holds, such as CURVED_SCISSORS:400178.")] = "POTTS_SCISSORS:400001",
) -> None:
    """Publish the stub bench as a da Vinci robot on a ROS graph, until interrupted; then write the truth about the tissue."""
    import shlex

    from hardware.stub.scene import load_scene
    from supervisor.serve_stub import ServeOptions, serve
    from supervisor.warp_start import start_warp

    console = Console()
    options = ServeOptions(load_scene(scene), seed, folder, transport, prefix, pictures, cutter)
    start_warp()

    def ready(robot: Path, drawn: Path) -> None:
        console.print(
            f"{options.scene.name}, seed {seed}, is on the graph. Its configuration: {escape(str(robot))}", soft_wrap=True
        )
        command = shlex.join(["dissect", "run", "--bench", "dvrk", "--config", str(robot), "--goal", str(drawn)])
        console.print(command, style="bold", markup=False, highlight=False, soft_wrap=True)

    serve(options, ready)
