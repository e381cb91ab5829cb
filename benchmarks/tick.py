"""What a tick of the tree costs, and how soon after a fault the arms get their last command.

The cost is that of `root.tick_once()` with scripted skills that do nothing, beside a bare py_trees tree of the same shape with py_trees'
own leaves. Rounds are interleaved, so that a busy machine slows both alike. The reaction is counted on the mock bench, in ticks
and in bench time, over faults that come at different moments between two ticks. Run: `python -m benchmarks.tick --json t.json`.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import py_trees
from py_trees import behaviours, composites, decorators
from py_trees.behaviour import Behaviour
from py_trees.common import Status

from behaviours.board import Step
from behaviours.leaf import Condition
from hardware.gate import Lease
from hardware.interface import CUTTER
from tests.mocks.skills import script
from tests.mocks.stage import TICK, Stage
from trees.session import create_root

PHASES = 8  # moments between two ticks at which a fault comes
STATES = {
    "asking the operator": ("answer", Step.APPROVE_GOAL),
    "dissecting": ("dissect", Step.DISSECT),
    "exposing": ("expose", Step.EXPOSE),
}


def bare(node: Behaviour) -> Behaviour:
    """Copy the shape of `node` with py_trees' own nodes; leaves end as they ended or run as they run now."""
    children = [bare(child) for child in node.children]
    if isinstance(node, composites.Parallel):
        policy = node.policy
        if isinstance(policy, py_trees.common.ParallelPolicy.SuccessOnSelected):
            policy = py_trees.common.ParallelPolicy.SuccessOnSelected([children[node.children.index(c)] for c in policy.children])
        return composites.Parallel(node.name, policy, children)
    if isinstance(node, composites.Selector | composites.Sequence):
        kind = composites.Selector if isinstance(node, composites.Selector) else composites.Sequence
        return kind(node.name, memory=node.memory, children=children)
    if children:
        return decorators.PassThrough(node.name, children[0])
    if isinstance(node, Condition) and node.status is Status.INVALID:
        return behaviours.Failure(node.name)  # a selector with memory has gone past it
    leaves = {Status.RUNNING: behaviours.Running, Status.FAILURE: behaviours.Failure}
    return leaves.get(node.status, behaviours.Success)(node.name)


def idle(step: str, leaf: str) -> Stage:
    """Give a session that has come to `leaf`, where it stays; its skills do nothing."""
    stage = Stage(script(**{step: "wait" if step == "answer" else "running"}))
    stage.skills._move = lambda lease, cut: None  # type: ignore[method-assign]
    stage.build(create_root)
    arrive(stage, leaf)
    return stage


def arrive(stage: Stage, leaf: str) -> None:
    """Tick until `leaf` runs, and a little longer."""
    node = next(node for node in stage.root.iterate() if node.name == leaf)
    while node.status is not Status.RUNNING:
        stage.tick()
    stage.tick(3)


def per_tick(root: Behaviour, ticks: int) -> float:
    """Time of one tick [us]."""
    start = time.perf_counter()
    for _ in range(ticks):
        root.tick_once()
    return (time.perf_counter() - start) / ticks * 1e6


def cost(step: str, leaf: str, rounds: int, ticks: int) -> dict[str, float]:
    """Median cost of a tick [us] at `leaf`, of ours and of the bare tree, and their ratio."""
    stage = idle(step, leaf)
    twin = bare(stage.root)
    for _ in range(3):
        twin.tick_once()
    assert sum(1 for _ in twin.tick()) == sum(1 for _ in stage.root.tick()), "the bare tree ticks other nodes than ours"
    pairs = [(per_tick(stage.root, ticks), per_tick(twin, ticks)) for _ in range(rounds)]
    ours, theirs = (statistics.median(column) for column in zip(*pairs, strict=True))
    return {"tick_us": ours, "bare_us": theirs, "ratio_bare": ours / theirs}


def camera_freezes(stage: Stage) -> None:
    """No new image from now on; it is too old for motion 0.2 s later."""
    stage.bench.eye.freeze()


def tension_rises(stage: Stage) -> None:
    """A pull of 6 N from now on; the median of the force needs three samples of it."""
    stage.bench.grasper.force = np.array([6.0, 0.0, 0.0])


def tip_leaves(stage: Stage) -> None:
    """The grasper is suddenly seen far out of the workspace."""
    stage.bench.grasper.pose = stage.bench.grasper.pose.moved(np.array([1.0, 0.0, 0.0]))


def record_fails(stage: Stage) -> None:
    """The record cannot be written any more."""
    stage.recorder_fault = "the disk is full"


FAULTS: dict[str, Callable[[Stage], None]] = {
    "emergency stop": lambda stage: setattr(stage.bench, "pressed", True),
    "arm fault": lambda stage: stage.bench.cutter.fault(),
    "arm without power": lambda stage: stage.bench.cutter.power_off(),
    "tension too high": tension_rises,
    "camera frozen": camera_freezes,
    "tip outside the workspace": tip_leaves,
    "recorder fault": record_fails,
}


def moving(lease: Lease, cut: bool) -> None:
    """Move the scissors at every tick, a little to and fro."""
    pose = lease.setpoint_cp(CUTTER)
    lease.servo_cp(CUTTER, pose.moved(np.array([1e-5 if pose.position[0] < 0.02 else -1e-5, 0.0, 0.0])))


def reaction(fault: Callable[[Stage], None], phase: float) -> tuple[float, float, int]:
    """Give the time from `fault` to the last motion and to the hold [ms of bench time], and the ticks to the last motion."""
    stage = Stage(script(expose="running"))
    stage.skills._move = moving  # type: ignore[method-assign]
    stage.build(create_root)
    arrive(stage, Step.EXPOSE)
    at = stage.bench.now() + phase * TICK
    stage.bench.at(at, lambda: fault(stage))
    stage.tick(30)
    moves = [command.stamp for command in stage.bench.motions() if command.stamp >= at]
    holds = [command.stamp for command in stage.bench.log if command.name == "hold" and command.stamp >= at]
    return (moves[-1] - at) * 1e3 if moves else 0.0, (holds[0] - at) * 1e3, len(moves)


def reactions() -> dict[str, dict[str, float]]:
    """Worst reaction to each fault over all phases."""
    found = {}
    for name, fault in FAULTS.items():
        cases = [reaction(fault, (phase + 0.5) / PHASES) for phase in range(PHASES)]
        found[name] = {
            "last_motion_ms": max(case[0] for case in cases),
            "hold_ms": max(case[1] for case in cases),
            "ticks_with_motion": max(case[2] for case in cases),
        }
    return found


def main() -> None:
    """Measure, print, and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--rounds", type=int, default=15)
    parser.add_argument("--ticks", type=int, default=100, help="of each tree in a round")
    arguments = parser.parse_args()
    figures: dict[str, Any] = {
        "nodes": len(list(Stage().build(create_root).iterate())),
        "tick_period_ms": TICK * 1e3,
        "cost": {name: cost(*where, arguments.rounds, arguments.ticks) for name, where in STATES.items()},
        "reaction": reactions(),
    }
    for name, row in figures["cost"].items():
        print(f"{name:28s}{row['tick_us']:7.0f} us a tick, bare py_trees {row['bare_us']:5.0f} us, ratio {row['ratio_bare']:.2f}")
    for name, row in figures["reaction"].items():
        after = f"last motion {row['last_motion_ms']:5.1f} ms after it ({row['ticks_with_motion']} ticks)"
        print(f"{name:28s}{after}, both arms told to hold after {row['hold_ms']:5.1f} ms")
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
