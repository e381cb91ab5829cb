"""Exhaustive exploration of the tree: every outcome of every leaf and every guard failing, at every point that can be reached.

An explicit-state search, breadth first. A state is reached by replaying the shortest script that leads to it; a script is a list of
moves, one per tick; a move is an event before the tick and the words that the scripted skills and the operator are given during it.
Two scripts that end with equal nodes, blackboard, skills and bench (`state_of`) lead to one state. The invariants are checked after
each tick; a broken one raises `InvariantError` with the shortest script that leads to it.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from py_trees.behaviour import Behaviour
from py_trees.common import Status

from behaviours import board
from behaviours.approve import Approve
from behaviours.guard import Guard
from behaviours.services import Services
from tests.mocks.stage import Stage
from tests.trees.invariants import InvariantError, Invariants
from trees.session import create_root

LIFETIME = 0.6  # [s] of an approval here, so that letting it expire is cheap


def _all_is_well(stage: Stage) -> None:
    for arm in stage.bench.arms.values():
        arm.recover()
    stage.bench.eye.thaw()
    stage.bench.grasper.force = np.zeros(3)
    stage.bench.grasper.pose = stage.home
    stage.bench.advance(0.3)  # the median of the force forgets


def _arm_off(stage: Stage) -> None:
    stage.bench.cutter.power_off()


def _camera_frozen(stage: Stage) -> None:
    stage.bench.eye.freeze()
    stage.bench.advance(0.3)


def _outside(stage: Stage) -> None:
    stage.bench.grasper.pose = stage.home.moved(np.array([-1.0, 0.0, 0.0]))


def _tension_unknown(stage: Stage) -> None:
    stage.bench.grasper.force = np.array([np.nan, 0.0, 0.0])


def _flicker(stage: Stage) -> None:
    """Lose and regain an arm between two ticks: only the gate's monitor sees it."""
    stage.bench.cutter.power_off()
    stage.bench.advance(0.05)
    stage.bench.cutter.recover()


def _tension_high(stage: Stage) -> None:
    stage.bench.grasper.force = np.array([6.0, 0.0, 0.0])
    stage.bench.advance(0.3)


def _pressed(stage: Stage) -> None:
    stage.bench.pressed = True


def _fault(stage: Stage) -> None:
    stage.bench.grasper.fault()


def _recorder(stage: Stage) -> None:
    stage.recorder_fault = "the disk is full"


def _notes(stage: Stage) -> None:
    stage.notes_fail = True


def _late(stage: Stage) -> None:
    stage.bench.advance(LIFETIME + 0.1)


def _shift(stage: Stage) -> None:
    stage.skills.shift += 20.0


def _lost(stage: Stage) -> None:
    stage.skills.lost = not stage.skills.lost


def _abort(stage: Stage) -> None:
    stage.root.stop(Status.INVALID)


PASSING: dict[str, Callable[[Stage], None]] = {
    "arm off": _arm_off,
    "camera frozen": _camera_frozen,
    "tip outside": _outside,
    "tension unknown": _tension_unknown,
}
LATCHED: dict[str, Callable[[Stage], None]] = {
    "emergency stop": _pressed,
    "arm fault": _fault,
    "tension too high": _tension_high,
    "recorder fault": _recorder,
}
OTHER: dict[str, Callable[[Stage], None]] = {
    "notes fail": _notes,
    "flicker": _flicker,
    "late": _late,
    "scene shifts": _shift,
    "goal lost or found": _lost,
    "abort": _abort,
}
ASKING_NEXT = {"dissect", "replan"}  # skills after which the goal must be seen, to be asked about
EVENTS = {**PASSING, **LATCHED, **OTHER, "all is well": _all_is_well}


@dataclass(frozen=True)
class Move:
    """What happens before one tick, and the words said during it: `step: word`."""

    event: str
    words: tuple[str, ...] = ()

    def __str__(self) -> str:
        return " / ".join(filter(None, (self.event, ", ".join(self.words)))) or "tick"


class Play:
    """A fresh session in which moves are made one after the other."""

    def __init__(
        self, settings: dict[str, Any], create: Callable[[Services], Behaviour], sabotage: Callable[[Stage], None]
    ) -> None:
        self.words: tuple[str, ...] = ()
        self.asked: list[tuple[str, tuple[str, ...]]] = []
        self.given: list[str] = []
        self.stage = Stage(self._choose, tick=1e-3, step=0.05, approval_lifetime=LIFETIME, **settings)
        sabotage(self.stage)
        self.stage.build(create)
        self.condition = ""
        self.invariants = Invariants(self.stage)

    def make(self, move: Move, check: bool = True) -> None:
        """Make one move and check the invariants."""
        self.words, self.asked, self.given = move.words, [], []
        if move.event:
            EVENTS[move.event](self.stage)
        if move.event in PASSING:
            self.condition = move.event
        elif move.event == "all is well":
            self.condition = ""
        if move.event != "abort":
            self.stage.tick()
        if check:
            self.invariants.check()

    @property
    def ended(self) -> bool:
        """Whether the root has ended or was aborted."""
        return self.stage.root.status is not Status.RUNNING

    def _choose(self, step: str, options: tuple[str, ...]) -> str:
        place = len(self.asked)
        said = self.words[place] if place < len(self.words) else f"{step}: {options[0]}"
        asked, word = said.split(": ")
        assert asked == step, f"{step} asks where {asked} asked before: the tree is not deterministic"
        self.asked.append((step, options))
        self.given.append(said)
        return word


@dataclass
class Explored:
    """What was seen: per state the shortest script to it, and the states that follow it."""

    scripts: dict[Any, tuple[Move, ...]] = field(default_factory=dict)
    follow: dict[Any, set[Any]] = field(default_factory=dict)
    ends: dict[Any, str] = field(default_factory=dict)
    codes: set[str] = field(default_factory=set)
    transitions: int = 0

    def stuck(self) -> list[tuple[Move, ...]]:
        """Give the scripts to states from which no end can be reached any more."""
        before: dict[Any, set[Any]] = {}
        for state, following in self.follow.items():
            for after in following:
                before.setdefault(after, set()).add(state)
        reached, queue = set(self.ends), deque(self.ends)
        while queue:
            for state in before.get(queue.popleft(), ()):
                if state not in reached:
                    reached.add(state)
                    queue.append(state)
        return [self.scripts[state] for state in self.follow if state not in reached]


def explore(
    *,
    events: tuple[str, ...] = tuple(EVENTS),
    settings: dict[str, Any] | None = None,
    create: Callable[[Services], Behaviour] = create_root,
    sabotage: Callable[[Stage], None] = lambda stage: None,
) -> Explored:
    """Visit every state that can be reached.

    Args:
        events: those of `EVENTS` that may happen.
        settings: of the `Services`.
        create: builds the tree.
        sabotage: breaks something before the tree is built, to see that it is found.

    Raises:
        InvariantError: an invariant does not hold; its text is the shortest script.
    """
    seen = Explored()

    def play(script: tuple[Move, ...]) -> Play:
        fresh = Play(settings or {}, create, sabotage)
        for move in script[:-1]:
            fresh.make(move, check=False)  # this far it was checked when its state was found
        try:
            fresh.make(script[-1])
        except InvariantError as violated:
            lines = "\n".join(f"  {number}. {move}" for number, move in enumerate(script, 1))
            raise InvariantError(f"{violated}\nthe shortest script that leads to it:\n{lines}") from None
        return fresh

    def visit(script: tuple[Move, ...]) -> Iterator[tuple[Any, tuple[Move, ...], Play]]:
        """Make the last move of `script` with every combination of words."""
        now = play(script)
        yield state_of(now), script, now
        last = script[-1]
        if last.event:
            return  # what lasts of an event is part of the state: the words are tried from there
        for place in range(len(last.words), len(now.asked)):
            step, options = now.asked[place]
            for word in options[1:]:
                yield from visit((*script[:-1], Move(last.event, (*now.given[:place], f"{step}: {word}"))))

    fresh = Play(settings or {}, create, sabotage)
    queue: deque[tuple[Any, tuple[Move, ...], tuple[str, ...]]] = deque([("start", (), possible(fresh))])
    seen.scripts["start"] = ()
    while queue:
        state, script, may_happen = queue.popleft()
        following = seen.follow.setdefault(state, set())
        for event in ("", *(event for event in may_happen if event in events)):
            for after, longer, now in visit((*script, Move(event))):
                seen.transitions += 1
                following.add(after)
                if after in seen.scripts:
                    continue
                seen.scripts[after] = longer
                if now.ended:
                    outcome = board.read(board.OUTCOME)
                    seen.ends[after] = outcome.code if outcome else "none"
                else:
                    queue.append((after, longer, possible(now)))
    return seen


def possible(play: Play) -> tuple[str, ...]:
    """Give the events that make a difference to `play`."""
    stage, gate = play.stage, play.stage.gate
    if play.condition:
        # One passing condition at a time; while it holds nothing runs, so only its end and a latched one matter.
        return (*LATCHED, "all is well", "abort")
    asked = gate.approval is not None or stage.approver.open is not None
    return (
        *PASSING,
        *LATCHED,
        *(("abort",) if stage.root.status is Status.RUNNING else ()),
        *(() if stage.notes_fail else ("notes fail",)),
        *(("flicker",) if gate.lease else ()),
        *(("late",) if asked else ()),
        *(("scene shifts",) if asked and stage.skills.following else ()),
        *(("goal lost or found",) if stage.skills.following and (asked or ASKING_NEXT & set(stage.skills.opened)) else ()),
    )


def state_of(play: Play) -> Any:
    """Everything that the future depends on, made comparable; times and counters only as far as they are compared to others.

    A node that does not run starts afresh at its next tick, so how it ended before makes no difference. Ends have no future: of them only
    the status and the code are kept apart.
    """
    if play.ended:
        outcome = board.read(board.OUTCOME)
        return play.stage.root.status.value, outcome and outcome.code.value
    stage, gate = play.stage, play.stage.gate
    read, now = board.read, board.read(board.INTERRUPTIONS)
    attempt, estimate, plan, verdict = read(board.ATTEMPT), read(board.ESTIMATE), read(board.PLAN), read(board.VERDICT)
    nodes = list(stage.root.iterate())
    place = {id(node): number for number, node in enumerate(nodes)}
    # Guards remember nothing: which of them waits makes no difference to what may follow.
    running = [node for node in nodes if node.status is Status.RUNNING and not isinstance(node, Guard)]
    if verdict:  # only the retreat is left
        memory: Any = verdict.code.value
    else:
        memory = (
            (attempt.number, attempt.interruptions == now, read(board.LOOKED_AGAIN) == attempt.number),
            estimate is not None
            and estimate.graph.complete
            and (estimate.attempt, estimate.interruptions) == (attempt.number, now),
            plan is not None and plan.interruptions == now,
            (read(board.CHECKLIST_PASSED), read(board.TRACKING), read(board.CUTTING_BEGAN)),
        )
    return (
        tuple((place[id(node)], place.get(id(getattr(node, "current_child", None)))) for node in running),
        tuple(node._count for node in nodes if isinstance(node, Approve) and node.status is Status.RUNNING),
        memory,
        stage.approver.open and (stage.approver.open.kind, moved(stage)),
        tuple(sorted(stage.skills.opened)),
        (stage.skills.following, stage.skills.lost, stage.notes_fail, bool(play.condition)),
        gate.approval and approved(stage),
        gate.tripped and gate.tripped.code.value,
        gate.lease is not None,
    )


def moved(stage: Stage) -> tuple[bool, bool]:
    """Whether the question is too old, and whether the scene moved since it was asked."""
    asked = stage.approver.open
    assert asked is not None
    shifted = abs(asked.polyline[0, 0] - 200.0 - stage.skills.shift) > stage.services.max_displacement
    return stage.bench.now() - asked.stamp > LIFETIME, bool(shifted)


def approved(stage: Stage) -> bool:
    """Whether the scene moved since what is approved was asked."""
    grants = [grant for key in board.GRANTS if (grant := board.read(key))]
    asked = max(grants, key=lambda grant: grant.stamp)
    return bool(abs(asked.polyline[0, 0] - 200.0 - stage.skills.shift) > stage.services.max_displacement)
