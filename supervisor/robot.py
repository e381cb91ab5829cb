"""What a session on a da Vinci needs beside the session itself: its bench on the graph, and skills that its instruments can carry out."""

from __future__ import annotations

import dataclasses
import gc
import math
import sys
import time
from collections.abc import Callable
from pathlib import Path

from hardware.codes import InputError
from hardware.dvrk.bench import BenchDVRK
from hardware.dvrk.choose_transport import make_transport
from hardware.dvrk.config import RobotConfig, load_robot
from hardware.dvrk.doctor import examine
from hardware.dvrk.energy import OperatorEnergy
from hardware.dvrk.transport import TransportError
from hardware.interface import ArmState, OperatingState
from skills.dissect.planning import BLADE
from supervisor.doctor import Check
from supervisor.skillset import SkillConfig

NODE = "dissection_supervisor"
SPARE = math.radians(1.0)  # kept from the jaw's own limit
SHORTEST_SNIP = 0.5e-3  # [m]
TURN = 0.5e-3  # [s] after which a thread of Python hands over


def connect(file: Path, ask: Callable[[str], str]) -> BenchDVRK:
    """Join the graph that the configuration in `file` names; `ask` puts questions to the operator. Nothing is checked yet.

    Raises:
        InputError: the configuration or a calibration is wrong, ROS is not there, or its master does not answer.
    """
    config = load_robot(file)
    stay_prompt()
    try:
        transport = make_transport(config.transport, NODE)
        return BenchDVRK(config, transport, energy=OperatorEnergy(ask), wall=time.time())
    except TransportError as error:
        raise InputError(str(error)) from error


def agree_to_power(bench: BenchDVRK, ask: Callable[[str], str]) -> None:
    """Have a person agree before a session powers or homes anything; arms that are enabled and homed already need no word.

    Raises:
        InputError: the person did not; the bench is closed, and nothing was powered.
    """
    asleep = [arm.config.called for arm in bench.arms.values() if not _ready(arm.operating_state())]
    if not asleep:
        return
    names = " and ".join(asleep)
    question = f"The session will power and home {names}: what moves must be free. Power and home now? [y/N] "
    try:
        if ask(question).strip().lower() in ("y", "yes"):
            return
    except EOFError:
        pass  # nobody is there
    except BaseException:
        bench.close()
        raise
    bench.close()
    raise InputError(f"nothing was powered, as you did not agree; enable and home {names} at the console, or agree")


def _ready(state: ArmState) -> bool:
    return state.state is OperatingState.ENABLED and state.is_homed


def stay_prompt() -> None:
    """Keep the threads of this process, the driver's monitor among them, from waiting long for one another.

    Python's interpreter serves one thread at a time. A look of the monitor takes it 1 ms; but with a thread for each topic and Python's own
    turns of 5 ms some looks took 55 ms, of the 100 ms that the deadman allows. And a full garbage collection goes through all
    that was ever imported, 100 ms and more in one go: what is there now is left out of all later ones.
    """
    sys.setswitchinterval(TURN)
    gc.collect()
    gc.freeze()


def diagnose_robot(file: Path) -> list[Check]:
    """What the robot of the configuration in `file` tells; a robot that cannot be reached is a finding, a wrong configuration an error.

    Raises:
        InputError: the configuration cannot be used.
    """
    config = load_robot(file)
    try:
        transport = make_transport(config.transport, f"{NODE}_doctor")
    except TransportError as error:
        return [Check("robot", False, "not reached", str(error))]
    try:
        bench = BenchDVRK(config, transport, wall=time.time())
    except InputError as error:
        transport.close()
        return [Check("calibration", False, str(error), "Register the cameras anew, or correct the configuration.")]
    try:
        return [Check(one.name, one.ok, one.detail, one.remedy, one.required) for one in examine(bench)]
    finally:
        bench.close()


def fitted(skills: SkillConfig, robot: RobotConfig) -> SkillConfig:
    """The settings as far as the robot's jaws open: scissors that open less take shorter snips.

    Raises:
        InputError: the scissors open too little for any snip.
    """
    grasper, cutter = robot.grasper, robot.cutter
    widest = grasper.instrument.jaw_upper - grasper.jaw_zero - SPARE
    grasp = dataclasses.replace(skills.grasp, jaw_open=min(skills.grasp.jaw_open, widest))
    if not cutter.instrument.has_jaw:
        return dataclasses.replace(skills, grasp=grasp)
    planning = skills.planning
    most = min(planning.most_jaw, cutter.instrument.jaw_upper - cutter.jaw_zero - SPARE)
    # As in the planning agent: the blades, `reach` long above the tip's depth, open over one snip and its overlap.
    longest = 2.0 * (BLADE - planning.depth) * math.tan(most / 2.0) - planning.overlap
    if longest < SHORTEST_SNIP:
        raise InputError(
            f"{cutter.tool_type} opens {math.degrees(most):.0f} degrees, which is too little for any snip "
            f"at a depth of {planning.depth * 1e3:.1f} mm"
        )
    planning = dataclasses.replace(
        planning, most_jaw=most, least_jaw=min(planning.least_jaw, most), snip=min(planning.snip, longest)
    )
    return dataclasses.replace(skills, grasp=grasp, planning=planning)
