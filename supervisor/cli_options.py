"""What the commands of `dissect` share: the words that their options take, and what to do with them."""

from __future__ import annotations

import json
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from hardware.codes import InputError


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


def robot_file(bench: BenchKind, config: Path | None) -> Path | None:
    """The robot's configuration; None on the stub.

    Raises:
        InputError: it was forgotten, or given without `--bench dvrk`.
    """
    if bench is BenchKind.STUB:
        if config is not None:
            raise InputError("--config is for a robot: give --bench dvrk too, or leave it out")
        return None
    if config is None:
        raise InputError("--bench dvrk needs the robot's configuration: --config robot.toml (docs/robot.toml explains it)")
    return config


def write_json(path: Path | None, data: Any) -> None:
    """Write a command's result where it was asked for.

    Raises:
        InputError: the file cannot be written.
    """
    if path is None:
        return
    try:
        path.write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path} cannot be written: {error.strerror}") from error
