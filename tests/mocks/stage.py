"""A session's services over a mock bench: scripted skills and operator, every decision and note kept, and a tick that takes no time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import py_trees
from py_trees.behaviour import Behaviour
from py_trees.common import Status

from behaviours.board import Key
from behaviours.services import Services
from hardware.gate import Decision, SafetyGate
from tests.mocks.bench import MockBench
from tests.mocks.skills import GOAL, Choose, ScriptedApprover, ScriptedSkills, script

TICK = 1 / 30  # [s]
T = TypeVar("T")


def put(key: Key[T], value: T) -> None:
    """Write `key` on the blackboard, as its one writer in the tree would."""
    py_trees.blackboard.Blackboard.set(key.name, value)


class Stage:
    """`tick` lets a tick period pass, then ticks `root`. `recorder_fault` and `notes_fail` break the record."""

    def __init__(self, choose: Choose | None = None, *, tick: float = TICK, step: float = 0.01, **settings: Any) -> None:
        py_trees.blackboard.Blackboard.clear()
        self.bench = MockBench(step)
        self.home = self.bench.grasper.pose
        self.decisions: list[Decision] = []
        self.notes: list[tuple[str, dict[str, Any]]] = []
        self.recorder_fault: str | None = None
        self.notes_fail = False
        self.gate = SafetyGate(self.bench, on_decision=self.decisions.append)
        choose = choose or script()
        self.skills = ScriptedSkills(choose)
        self.approver = ScriptedApprover(choose)
        self.period = tick
        self.services = Services(
            gate=self.gate,
            skills=self.skills,
            approver=self.approver,
            goal=GOAL,
            recorder_fault=lambda: self.recorder_fault,
            note=self._note,
            **settings,
        )

    def build(self, create: Callable[[Services], Behaviour]) -> Behaviour:
        """Make a leaf or a tree from the services."""
        self.root = create(self.services)
        return self.root

    def tick(self, count: int = 1) -> Status:
        """Let a tick period pass and tick, `count` times or until the root has ended."""
        for _ in range(count):
            self.bench.advance(self.period)
            self.root.tick_once()
            if self.root.status is not Status.RUNNING:
                break
        return self.root.status

    def noted(self, topic: str) -> list[dict[str, Any]]:
        """Give the payloads noted on `topic`."""
        return [payload for name, payload in self.notes if name == topic]

    def settled(self) -> bool:
        """Whether nothing is left over: no live lease, no approval, no open skill or question, and both arms hold."""
        gate = self.gate
        return (
            gate.lease is None
            and gate.approval is None
            and not self.skills.opened
            and self.approver.open is None
            and self.bench.holding()
        )

    def _note(self, topic: str, payload: dict[str, Any]) -> None:
        if self.notes_fail:
            raise OSError("the disk is full")
        self.notes.append((topic, payload))
