"""The protocol of the experiments on tissue that was dissected before: grasp, draw the goal on the cut, pull, judge.

The session's own skills do all of it; nothing here knows what is measured.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

from hardware.codes import Code
from hardware.gate import SafetyGate
from hardware.interface import GRASPER, Bench, MoveReport
from hardware.stub.bench import StubBench
from skills.estimate.graph import ConnectivityGraph
from skills.expose.outcome import ExposeOutcome
from skills.motion import pause, servo_line
from skills.skill import Steps
from skills.tracking.outcome import TrackOutcome
from supervisor.experiments.dissected import goal_on_the_cut
from supervisor.session import TICK
from supervisor.skillset import SessionSkills, SkillConfig
from supervisor.stub_goal import drawn_goal

T = TypeVar("T")

TEST_PULL = 3e-3  # [m]: a flap that is severed resists less than whole tissue
BACK_SPEED = 5e-3  # [m/s], from there to where the pull begins
SETTLE = 0.3  # [s], there
LONGEST = 120.0  # [s] of bench time for one skill


@dataclass(frozen=True)
class Pulled:
    """What became of a trial: the newest answer of each skill, None for those that were not asked."""

    tracked: TrackOutcome
    held: MoveReport | None
    exposed: ExposeOutcome | None
    graph: ConnectivityGraph | None

    @property
    def code(self) -> Code:
        """OK, or why there is nothing to judge."""
        return (self.tracked if self.exposed is None else self.exposed).code

    @property
    def message(self) -> str:
        """One sentence for people."""
        if self.exposed is None and self.held is not None:
            return self.held.message
        return (self.exposed or self.tracked).message


def starting_at(config: SkillConfig, lift: float) -> SkillConfig:
    """`config` for tissue that is severed already: its reference is taken `lift` [m] above where the jaws closed."""
    return replace(config, grasp=replace(config.grasp, test_pull=TEST_PULL), pull=replace(config.pull, relaxed=lift))


def pull(
    truth: StubBench,
    gate: SafetyGate,
    skills: SessionSkills,
    lift: float,
    after_tick: Callable[[], None],
    follow_grasp: bool = True,
) -> Pulled:
    """Grasp, draw the goal `lift` [m] above where the jaws closed, pull from there and judge; `after_tick` is called at every tick.

    `skills` are set up by `starting_at`. `truth` is the bench below whatever the gate looks at; only the expert sees it. The goal is
    drawn anew after the grasp, so that nobody needs to follow it before: without `follow_grasp` nothing is looked at meanwhile.

    Raises:
        RuntimeError: a skill did not come to an end.
    """
    bench = gate.bench
    _run(bench, skills.checklist(), skills, after_tick, tracking=False)
    tracked = _run(bench, skills.start_tracking(drawn_goal(truth)), skills, after_tick, tracking=False)
    if tracked.code is not Code.OK:
        return Pulled(tracked, None, None, None)
    lease = gate.grant("grasp")
    held = _run(bench, skills.take_hold(lease), skills, after_tick, follow_grasp)
    if skills.grasped is not None:
        start = skills.grasped.origin.moved(lift * skills.grasped.normal)
        _run(bench, servo_line(lease, GRASPER, start, BACK_SPEED, "going back"), skills, after_tick, follow_grasp)
        _run(bench, pause(lease, SETTLE, "letting the tissue settle"), skills, after_tick, follow_grasp)
        # The protocol begins here: the expert draws the goal on the picture of the grasped, dissected tissue.
        tracked = _run(bench, skills.start_tracking(goal_on_the_cut(truth)), skills, after_tick, tracking=False)
    gate.revoke(lease)
    lease = gate.grant("expose")
    exposed = _run(bench, skills.expose(lease), skills, after_tick)
    gate.revoke(lease)
    graph = _run(bench, skills.estimate(), skills, after_tick, tracking=False) if exposed.code is Code.OK else None
    return Pulled(tracked, held, exposed, graph)


def _run(bench: Bench, steps: Steps[T], skills: SessionSkills, after_tick: Callable[[], None], tracking: bool = True) -> T:
    """Run a skill to its end, a tick at a time, tracking beside it."""
    beside = skills.track() if tracking else None
    until = bench.now() + LONGEST
    while bench.now() < until:
        try:
            next(steps)
        except StopIteration as end:
            outcome: T = end.value
            return outcome
        if beside is not None:
            next(beside)
        after_tick()
        bench.advance(TICK)
    raise RuntimeError(f"a skill took longer than {LONGEST:.0f} s of bench time")
