"""What can go wrong with a robot, and when in a session: the cases of the fault experiment."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum

from hardware.interface import CUTTER, GRASPER
from hardware.served.faults import OF_ROBOT
from hardware.served.faults import Fault as Served
from supervisor.experiments.faults_skills import ESTIMATING, RETRACTING, SNIPPING
from supervisor.experiments.faults_stand import Robot


class Phase(StrEnum):
    """Where in a session."""

    APPROACH = "approach"
    GRASP = "grasp"
    RETRACT = "retract"
    CUT = "cut"
    EXPOSE = "expose"
    ESTIMATE = "estimate"


class Graph(StrEnum):
    """Faults that need more than the served robot."""

    MASTER_GONE = "master_gone"  # connections outlive it
    DUPLICATE_PUBLISHER = "duplicate_publisher"  # a second node reports for the arm
    FOREIGN_COMMANDS = "foreign_commands"  # a second node commands it
    DEADMAN_GONE = "deadman_gone"


Fault = Served | Graph
Moment = tuple[str, float, str]
Moments = Mapping[Phase, Moment]
FAULTS: tuple[Fault, ...] = (*Served, *Graph)
# What a skill does in a phase, how long into it the fault comes [s], and the arm at work.
MOMENTS: Moments = {
    Phase.APPROACH: ("lowering the grasper", 0.4, GRASPER),
    Phase.GRASP: ("closing the grasper", 0.4, GRASPER),
    Phase.RETRACT: (RETRACTING, 0.4, GRASPER),
    Phase.CUT: (SNIPPING, 0.3, CUTTER),
    Phase.EXPOSE: ("exposing: step 3", 0.1, GRASPER),
    Phase.ESTIMATE: (ESTIMATING, 0.3, GRASPER),
}


def arm_of(fault: Fault, phase: Phase) -> str:
    """The arm that it befalls: the one at work; tissue is lost by the one that holds it."""
    return GRASPER if fault is Served.JAW_SLIPS else MOMENTS[phase][2]


def inject(stand: Robot, fault: Fault, arm: str) -> None:
    """Let `fault` happen on `arm`, or on the whole robot where it is no arm's."""
    if isinstance(fault, Served):
        stand.served.inject(fault, "" if fault in OF_ROBOT else arm)
    elif fault is Graph.MASTER_GONE:
        stand.master.up = False
    elif fault is Graph.DUPLICATE_PUBLISHER:
        stand.duplicate(arm)
    elif fault is Graph.FOREIGN_COMMANDS:
        stand.stranger(arm)
    else:
        stand.deadman_runs = False


def clear(stand: Robot) -> None:
    """End all faults; what they left behind stays."""
    stand.served.clear()
    stand.master.up = True
    stand.dismiss()
    stand.deadman_runs = True
