"""A session over the served stub on a graph within one process: real driver, gate, tree and deadman, and every command overheard.

Bench time goes on only as the session lets it, so a run is the same to the last message each time. Nothing is rendered: the endoscope
publishes empty pictures at its usual rate, through the same topics and faults.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
import py_trees

from behaviours.services import Services, SkillSet
from hardware.dvrk import messages as m
from hardware.dvrk.bench import BenchDVRK
from hardware.dvrk.config import RobotConfig, SpeedConfig
from hardware.dvrk.deadman import NAME as DEADMAN
from hardware.dvrk.deadman import Deadman
from hardware.dvrk.local import LocalGraph, LocalTransport
from hardware.dvrk.transport import TransportError
from hardware.gate import Decision, SafetyGate
from hardware.interface import Array, CameraModel, Frame, StereoFrame
from hardware.limits import Limits
from hardware.served.impostor import STEP as STRANGE_STEP
from hardware.served.impostor import Impostor
from hardware.served.node import ServedBench, Serving
from hardware.served.site import SCISSORS, write_site
from hardware.stub.bench import StubBench
from hardware.stub.endoscope import StubEndoscope
from hardware.stub.scene import Scene, load_scene
from supervisor.approvers import AutoApprover
from supervisor.experiments.faults_skills import PhaseSkills, fitted_grasp, place_of
from supervisor.robot import fitted
from supervisor.session import TICK
from supervisor.skillset import SkillConfig
from supervisor.stub_goal import drawn_goal
from trees.session import create_root

ARMS = ("PSM1", "PSM2")
MOTIONS = {"servo_cp": m.PoseStamped, "jaw/move_jp": m.JointState, "state_command": m.StringStamped}
HOLD, PAUSE = "hold", "pause"
STOPS = (HOLD, PAUSE)  # a paused arm takes no motion from anybody
STRANGERS_PERIOD = 0.02  # [s] between what a second node sends


def scene() -> Scene:
    """Silicone, coarse, and without calibration error: what tissue does is not the question."""
    loaded = load_scene("silicone")
    tissue = replace(loaded.tissue, fine_spacing=2e-3, coarse_spacing=6e-3, puncture_variation=0.0)
    return replace(loaded, tissue=tissue, arms=replace(loaded.arms, bias=0.0))


@dataclass(frozen=True)
class Heard:
    """One command on the graph at bench time `at` [s]; `lease` numbers the right to move that was alive then, 0 none."""

    at: float
    arm: str
    name: str
    ours: bool
    lease: int


class EmptyPictures:
    """Looks like the stub's endoscope and shows nothing."""

    def __init__(self, camera: CameraModel, now: Callable[[], float]) -> None:
        self.camera, self._now = camera, now
        self._image = np.zeros((camera.height, camera.width, 3), dtype=np.uint8)

    def stereo(self) -> StereoFrame:
        """A black pair."""
        return StereoFrame(Frame(0, self._now(), self._image), self._image)


class OneEyeAfterTheOther:
    """The stub's endoscope, without a thread for the second eye: a process that is to be split has none."""

    def __init__(self, endoscope: StubEndoscope) -> None:
        self._endoscope = endoscope
        self.camera: CameraModel = endoscope.camera

    def stereo(self) -> StereoFrame:
        """The same pair."""
        self._endoscope.left()
        return self._endoscope.stereo()


class Master:
    """Whether the graph's master is there. Connections between nodes outlive it, as on a ROS 1 graph."""

    up = True


class Joined(LocalTransport):
    """A node that asks the master."""

    def __init__(self, graph: LocalGraph, name: str, master: Master) -> None:
        super().__init__(graph, name, 0.0)
        self._master = master

    def kinds(self) -> Mapping[str, str]:
        """What is published, as the master knows it."""
        self._ask()
        return super().kinds()

    def publishers_of(self, topic: str) -> tuple[str, ...]:
        """Who publishes, as the master knows it."""
        self._ask()
        return super().publishers_of(topic)

    def alive(self) -> bool:
        """Whether the master answers."""
        return self._master.up and super().alive()

    def _ask(self) -> None:
        if not self._master.up:
            raise TransportError("the master does not answer")


class Stranger:
    """A program that commands an arm beside the supervisor, a little further along x each time."""

    def __init__(self, transport: LocalTransport, config: RobotConfig, arm: str) -> None:
        self._transport = transport
        self._pose: m.PoseStamped | None = None
        self._servo = transport.publisher(config.topic(f"{arm}/servo_cp"), m.PoseStamped)
        transport.subscribe(config.topic(f"{arm}/setpoint_cp"), m.PoseStamped, self._see)

    def act(self) -> None:
        """Send one command."""
        if self._pose is not None:
            goal = self._pose.position + np.array([STRANGE_STEP, 0.0, 0.0])
            self._servo.publish(m.PoseStamped(self._transport.stamp(), self._pose.frame_id, goal, self._pose.quaternion))

    def _see(self, message: m.PoseStamped, received: float) -> None:
        self._pose = message


class Robot:
    """The served stub, driver and deadman on one graph, and everything that is commanded on it, `heard`.

    `blind`: its pictures are empty. PSM2 holds `cutter`. Whoever makes the gate sets `gate`.
    """

    def __init__(
        self,
        folder: Path,
        shown: Scene,
        blind: bool,
        serving: Serving | None = None,
        cutter: str = SCISSORS,
        speeds: SpeedConfig | None = None,
    ) -> None:
        self.threads_before = frozenset(threading.enumerate())
        self.stub = StubBench(shown, 0)
        self.goal = drawn_goal(self.stub)
        seen = self.stub.endoscope
        shows = EmptyPictures(seen.camera, self.stub.now) if blind else OneEyeAfterTheOther(seen)
        self.stub.endoscope = cast(StubEndoscope, shows)
        self.config = write_site(self.stub, folder, cutter=cutter)
        if speeds is not None:
            self.config = replace(self.config, speeds=speeds)
        self.graph, self.master = LocalGraph(self.stub.now), Master()
        self.heard: list[Heard] = []
        self.gate: SafetyGate | None = None
        self.deadman_runs = True
        self._leases: list[object] = []
        self._strangers: list[tuple[LocalTransport, Callable[[], object]]] = []
        self._theirs, self._stranger_due = False, 0.0
        self.served = ServedBench(self.stub, self.graph.node("dvrk"), self.config, serving)
        self.deadman = Deadman(Joined(self.graph, DEADMAN, self.master), [self.config.topic(arm) for arm in ARMS])
        self._listen(self.graph.node("ear"))
        self.bench = BenchDVRK(
            self.config, Joined(self.graph, "supervisor", self.master), wait=self._let_pass, wall=0.0, threaded=False
        )
        self.bench.open()

    def now(self) -> float:
        """Bench time [s]."""
        return self.stub.now()

    def tips(self) -> dict[str, Array]:
        """Where each tip truly is (3,) [m]."""
        return {arm: self.stub.arms[arm].true_pose().position.copy() for arm in ARMS}

    def duplicate(self, arm: str) -> None:
        """A second node reports for `arm`."""
        node = self.graph.node("impostor")
        self._strangers.append((node, Impostor(node, self.config, arm).report))

    def stranger(self, arm: str) -> None:
        """A second node commands `arm`."""
        node = self.graph.node("stranger")
        self._strangers.append((node, Stranger(node, self.config, arm).act))

    def dismiss(self) -> None:
        """All other nodes leave."""
        for node, _ in self._strangers:
            node.close()
        self._strangers.clear()

    def lease(self) -> int:
        """The number of the right to move that is alive; 0 none."""
        lease = None if self.gate is None else self.gate.lease
        if lease is None:
            return 0
        if not self._leases or self._leases[-1] is not lease:
            self._leases.append(lease)
        return len(self._leases)

    # ------------------------------------------------------------ inside

    def _let_pass(self, duration: float) -> None:
        self.served.advance(duration)
        if self._strangers and self.now() >= self._stranger_due:
            self._stranger_due = self.now() + STRANGERS_PERIOD
            self._theirs = True
            for _, act in self._strangers:
                act()
            self._theirs = False
        if self.deadman_runs:
            self.deadman.look()

    def _listen(self, node: LocalTransport) -> None:
        for arm in ARMS:
            for name, kind in {**MOTIONS, HOLD: m.Empty}.items():
                node.subscribe(self.config.topic(f"{arm}/{name}"), kind, self._hear(arm, name), queue=100)

    def _hear(self, arm: str, name: str) -> Callable[[m.Message, float], None]:
        def hear(message: m.Message, received: float) -> None:
            what = PAUSE if isinstance(message, m.StringStamped) and message.string == PAUSE else name
            self.heard.append(Heard(self.now(), arm, what, not self._theirs, self.lease()))

        return hear


class Doing(SkillSet, Protocol):
    """Skills that tell what they do: `doing` is what is under way and since when [s]; `begun` counts those that move the arms."""

    doing: tuple[str, float]
    begun: int


class Watched(Robot):
    """A session on that robot, as those see it who watch it; `decisions` are those of its gate, `notes` what its behaviours told."""

    decisions: list[Decision]
    notes: list[tuple[float, str, dict[str, Any]]]

    @property
    def doing(self) -> tuple[str, float]:
        """What is under way, and since when [s]."""
        raise NotImplementedError

    @property
    def begun(self) -> int:
        """How many skills that move the arms have begun."""
        raise NotImplementedError

    @property
    def ended(self) -> bool:
        """Whether the tree has come to its end."""
        raise NotImplementedError


class Staged(Watched):
    """One session. `tick` lets it go on by one tick."""

    def __init__(
        self,
        folder: Path,
        shown: Scene,
        blind: bool,
        make: Callable[[Staged, SafetyGate], Doing],
        attempts: int = 3,
        serving: Serving | None = None,
    ) -> None:
        super().__init__(folder, shown, blind, serving)
        self.decisions, self.notes = [], []
        gate = self.gate = SafetyGate(self.bench, Limits(), self.decisions.append)
        self.skills = make(self, gate)
        py_trees.blackboard.Blackboard.clear()
        self.root = create_root(
            Services(
                gate=gate,
                skills=self.skills,
                approver=AutoApprover(),
                goal=self.goal,
                recorder_fault=lambda: None,
                note=lambda topic, payload: self.notes.append((self.now(), topic, payload)),
                max_attempts=attempts,
            )
        )

    @property
    def doing(self) -> tuple[str, float]:
        """As the skills say."""
        return self.skills.doing

    @property
    def begun(self) -> int:
        """As the skills say."""
        return self.skills.begun

    @property
    def ended(self) -> bool:
        """Whether the tree has come to its end."""
        return self.root.status not in (py_trees.common.Status.RUNNING, py_trees.common.Status.INVALID)

    def tick(self) -> None:
        """As the session's own loop does; once the tree has ended only time goes on."""
        if not self.ended:
            self.root.tick_once()
        self.bench.advance(TICK)


class Stand(Staged):
    """One light session: motions at known places, and nothing is looked at."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, scene(), True, self._light)

    def _light(self, staged: Staged, gate: SafetyGate) -> Doing:
        settings = fitted_grasp(fitted(SkillConfig(), self.config))
        return PhaseSkills(gate, place_of(self.stub), self.goal, settings)
