"""Every fault of a robot in every phase of a session: what holds the arms, how soon, and how the session goes on.

python -m supervisor.experiments.faults --json faults.json --markdown docs/faults.md

One session is led to a phase; there it is split, so that each fault befalls the very same moment, and each branch is watched: until the
fault was noticed and for a while longer, then without the fault. What is measured is heard on the graph, beside the driver.
"""

from __future__ import annotations

import argparse
import json
import logging
import math
import multiprocessing
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from enum import StrEnum
from functools import partial
from pathlib import Path

import numpy as np

from behaviours import board
from hardware.codes import Code
from hardware.interface import Array
from hardware.served.faults import OF_ROBOT, ONCE
from hardware.served.faults import Fault as Served
from supervisor.experiments.faults_page import TOLERATED, page
from supervisor.experiments.faults_skills import ESTIMATING, RETRACTING, SNIPPING
from supervisor.experiments.faults_stand import ARMS, HOLD, STOPS, Robot, Staged, Stand

LONGEST = 60.0  # [s] for a session to come to a phase
QUIET = (Code.OK, Code.LEASE_REVOKED)
STEP_ENDS = 15.0  # [s] for a step that noticed nothing to end


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
FAULTS: tuple[Fault, ...] = (*Served, *Graph)
# What a skill does in a phase, how long into it the fault comes [s], and the arm at work.
MOMENTS: Mapping[Phase, tuple[str, float, str]] = {
    Phase.APPROACH: ("lowering the grasper", 0.4, "PSM1"),
    Phase.GRASP: ("closing the grasper", 0.4, "PSM1"),
    Phase.RETRACT: (RETRACTING, 0.4, "PSM1"),
    Phase.CUT: (SNIPPING, 0.3, "PSM2"),
    Phase.EXPOSE: ("exposing: step 3", 0.1, "PSM1"),
    Phase.ESTIMATE: (ESTIMATING, 0.3, "PSM1"),
}


@dataclass(frozen=True)
class Patience:
    """How long a session is watched [s], from the fault until it counts as not noticed; after it was noticed; when it is gone."""

    unnoticed: float = 4.0  # so that a motion of the jaw that comes next has time to fail
    watched: float = 1.5  # longer than an arm must have been quiet for after a motion that failed
    recovery: float = 2.5


PATIENT = Patience()


@dataclass(frozen=True)
class Row:
    """What one fault did in one phase. Times [s] count from the fault; None where there was no such thing.

    `noticed`: the first decision, trip or waiting guard, with `code` and `message`. `last_command`: the last motion command under the
    right to move that was alive then; `held`: when both arms had been told to hold. `after_hold`: such commands after that arm's hold, of
    which there must be none. `drift` [m]: how far a tip still went after the hold. `next_step`: commands of a later step of the procedure
    while the fault lasts; of one that happens once, until all guards are content again. `verdict`: held, at rest (nothing moved and nothing
    was sent), not noticed, tolerated (not noticed, harmless by the rules of the robot, and the step ended well), or not held.
    """

    fault: str
    phase: str
    arm: str
    code: str
    message: str
    noticed: float | None
    last_command: float | None
    held: float | None
    after_hold: int
    drift: float
    next_step: int
    outcome: str
    verdict: str


def run_with_fault(fault: Fault, phase: Phase, folder: Path, patience: Patience = PATIENT) -> Row:
    """Lead a new session to `phase`, let `fault` happen, and watch; the served robot's files go to `folder`."""
    stand = Stand(folder)
    lead(stand, phase)
    return watch(stand, fault, phase, patience)


def run_all(
    cases: Iterable[tuple[Fault, Phase]],
    folder: Path,
    patience: Patience = PATIENT,
    make: Callable[[Path], Staged] = Stand,
    moments: Mapping[Phase, tuple[str, float, str]] = MOMENTS,
) -> Iterator[Row]:
    """The same for many, with one session, which `make` makes, that is split at each phase: rows come phase by phase."""
    wanted = list(cases)
    stand = make(folder)
    for phase in Phase:
        faults = [fault for fault, at in wanted if at is phase]
        if not faults:
            continue
        lead(stand, phase, moments)
        for fault in faults:
            yield _branch(partial(watch, stand, fault, phase, patience))


def lead(stand: Staged, phase: Phase, moments: Mapping[Phase, tuple[str, float, str]] = MOMENTS) -> None:
    """Let the session go on to the moment of `phase`.

    Raises:
        RuntimeError: it never came there.
    """
    doing, after, _ = moments[phase]
    while not (stand.skills.doing[0].startswith(doing) and stand.now() - stand.skills.doing[1] >= after):
        if stand.ended or stand.now() > LONGEST:
            raise RuntimeError(f"the session never came to {phase}: {stand.root.feedback_message}")
        stand.tick()


def watch(stand: Staged, fault: Fault, phase: Phase, patience: Patience) -> Row:
    """Let `fault` happen now, and see what becomes of the session."""
    arm = MOMENTS[phase][2]
    seen = _Seen(stand, once=isinstance(fault, Served) and fault in ONCE)
    inject(stand, fault, arm)
    while not (seen.noticed and stand.now() - seen.start >= seen.noticed[0] + patience.watched):
        if stand.now() - seen.start > patience.unnoticed:
            break
        stand.tick()
        seen.look()
    held, last, after, further = seen.commands()
    if seen.noticed is None:
        verdict = "not noticed"
    elif held is not None and after == 0:
        verdict = "held"
    elif held is None and not last and not further:
        verdict = "at rest"
    else:
        verdict = "not held"
    drift = seen.drift(held) if seen.noticed else 0.0
    at, code, message = seen.noticed or (None, "", "")
    outcome = _outcome(stand, seen, patience)
    if verdict == "not noticed" and seen.ended_well and fault in TOLERATED:
        verdict = "tolerated"
    return Row(fault.value, phase.value, arm, str(code), message, at, last, held, after, drift, further, outcome, verdict)


class _Seen:
    """What is seen of a session from now on."""

    def __init__(self, stand: Staged, once: bool) -> None:
        self._stand, self._once = stand, once
        self.start, self.begun = stand.now(), stand.skills.begun
        self._content = math.inf  # when all guards were content again
        self.step: tuple[str, Code] | None = None  # the first one to end, and how
        self.noticed: tuple[float, Code, str] | None = None
        self._commands, self._decisions, self._notes = len(stand.heard), len(stand.decisions), len(stand.notes)
        self._lease = stand.lease()
        self._tips: list[tuple[float, dict[str, Array]]] = []
        self._until = math.inf  # the first command of a later step

    def look(self) -> None:
        """After each tick."""
        self._tips.append((self._stand.now() - self.start, self._stand.tips()))
        if self.noticed is None and (found := min(self._complaints(), key=lambda one: one[0], default=None)):
            self.noticed = found
        if self.noticed and self._content == math.inf and not any(self._guards()):
            self._content = self._stand.now() - self.start
        self.follow_step()

    def follow_step(self) -> None:
        """Look whether the step under way has ended."""
        for key in board.RESULTS:
            result = board.read(key)
            if self.step is None and result is not None and result.stamp > self.start:
                self.step = (key.name.split("/")[2], result.code)

    @property
    def ended_well(self) -> bool:
        """Whether the step that was under way came to a good end."""
        return self.step is not None and self.step[1] is Code.OK

    def commands(self) -> tuple[float | None, float | None, int, int]:
        """When both arms were held, the last motion command, those after the arm's hold, and those of a later step."""
        mine = [one for one in self._stand.heard[self._commands :] if one.ours]
        holds = {arm: min((one.at for one in mine if one.arm == arm and one.name == HOLD), default=math.inf) for arm in ARMS}
        motions = [one for one in mine if one.name not in STOPS]
        same = [one for one in motions if one.lease in (0, self._lease)]
        self._until = min((one.at - self.start for one in motions if one not in same), default=math.inf)
        held = max(holds.values()) - self.start
        last = max((one.at - self.start for one in same), default=None)
        after = sum(one.at > holds[one.arm] + 1e-9 for one in same)
        later = [one for one in motions if one not in same and (not self._once or one.at - self.start < self._content)]
        return (held if math.isfinite(held) else None), last, after, len(later)

    def drift(self, held: float | None) -> float:
        """How far a tip went between the hold (or the fault, where none was sent) and now, or a later step's first command [m]."""
        later = [tips for at, tips in self._tips if (held or 0.0) <= at <= self._until]
        if len(later) < 2:
            return 0.0
        return max(float(np.linalg.norm(later[-1][arm] - later[0][arm])) for arm in ARMS)

    @property
    def interrupted(self) -> bool:
        """Whether the procedure was interrupted."""
        return any(topic == "interruption" for _, topic, _ in self._stand.notes[self._notes :])

    def _complaints(self) -> Iterator[tuple[float, Code, str]]:
        stand, now = self._stand, self._stand.now() - self.start
        for one in stand.decisions[self._decisions :]:
            if one.code not in QUIET:
                yield one.stamp - self.start, one.code, one.message
        for key in board.RESULTS:
            result = board.read(key)
            if result is not None and result.stamp > self.start and result.code not in QUIET:
                yield result.stamp - self.start, result.code, result.message
        gate = stand.gate
        assert gate is not None
        if trip := gate.tripped:
            yield trip.stamp - self.start, trip.code, trip.message
        for code, message in self._guards():
            yield now, code, message

    def _guards(self) -> Iterator[tuple[Code, str]]:
        gate = self._stand.gate
        assert gate is not None
        for check in (gate.check_arms, gate.check_camera, gate.check_workspace, gate.check_tension):
            verdict = check()
            if not verdict.ok:
                yield verdict.code, verdict.message


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


def _outcome(stand: Staged, seen: _Seen, patience: Patience) -> str:
    """How the session ended, or what it does when the fault is gone."""
    if seen.noticed is None:
        until = stand.now() + STEP_ENDS
        while seen.step is None and not stand.ended and stand.now() < until:
            stand.tick()
            seen.follow_step()
        step = "goes on" if seen.step is None else f"{seen.step[0]}: {seen.step[1]}"
        return f"{step}; {_ending()}" if stand.ended else step
    if stand.ended:
        return _ending()
    first = "waits" if seen.interrupted else "the step ends, the session goes on"
    if stand.skills.begun > seen.begun:
        return f"{first}; looks again"
    clear(stand)
    begun, until = stand.skills.begun, stand.now() + patience.recovery
    while not stand.ended and stand.now() < until and (stand.skills.begun == begun or stand.lease() == 0):
        stand.tick()
    if stand.ended:
        return f"{first}; when the fault is gone: {_ending()}"
    if not seen.interrupted:
        return first
    return f"{first}; when the fault is gone: {'looks again' if stand.skills.begun > begun else 'goes on waiting'}"


def _ending() -> str:
    outcome = board.read(board.OUTCOME)
    return f"ends: {outcome.code}" if outcome else "ends without an outcome"


def _branch(act: Callable[[], Row]) -> Row:
    """What `act` gives in a copy of this process; here nothing has happened."""
    context = multiprocessing.get_context("fork")
    receive, send = context.Pipe(duplex=False)
    process = context.Process(target=lambda: send.send(act()))
    process.start()
    send.close()
    try:
        row: Row = receive.recv()
    except EOFError as error:
        raise RuntimeError("a branch of the session failed; its traceback is above") from error
    finally:
        process.join()
    return row


def main(arguments: list[str] | None = None) -> int:
    """Run all cases, and write what was found."""
    parser = argparse.ArgumentParser(prog="python -m supervisor.experiments.faults", description="Every fault in every phase.")
    parser.add_argument("--json", type=Path, help="write the rows to this file")
    parser.add_argument("--markdown", type=Path, help="write the page to this file")
    parser.add_argument("--faults", nargs="*", choices=[str(one) for one in FAULTS], help="only these")
    parser.add_argument("--phases", nargs="*", choices=list(Phase), help="only these")
    options = parser.parse_args(arguments)
    logging.disable(logging.CRITICAL)  # the sentences are in the rows
    cases = [
        (fault, phase)
        for phase in Phase
        for fault in FAULTS
        if (not options.phases or phase in options.phases) and (not options.faults or fault in options.faults)
    ]
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for number, row in enumerate(run_all(cases, Path(folder)), 1):
            rows.append(asdict(row))
            print(f"{number}/{len(cases)} {row.phase} {row.fault}: {row.verdict}, {row.outcome}", file=sys.stderr)
    if options.json:
        options.json.write_text(json.dumps({"rows": rows}, indent=1) + "\n", encoding="utf-8")
    if options.markdown:
        options.markdown.write_text(page(rows), encoding="utf-8")
    return 1 if any(row["verdict"] == "not held" for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
