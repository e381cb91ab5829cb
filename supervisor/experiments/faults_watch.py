"""What becomes of a session when a fault befalls it: what was noticed, when both arms were held, what was sent after it, and how it ended.

Whoever runs the session goes on by one tick whenever a generator here yields. What is measured is heard on the graph, beside the driver.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from behaviours import board
from hardware.codes import Code
from hardware.interface import Array
from hardware.served.faults import ONCE
from hardware.served.faults import Fault as Served
from supervisor.experiments.faults_cases import MOMENTS, Fault, Moments, Phase, arm_of, clear, inject
from supervisor.experiments.faults_reasons import TOLERATED
from supervisor.experiments.faults_stand import ARMS, HOLD, STOPS, Watched

LONGEST = 60.0  # [s] for a session to come to a phase
QUIET = (Code.OK, Code.LEASE_REVOKED)
GOES_ON = "the step ends, the session goes on"
STEP_ENDS = 15.0  # [s] for a step that noticed nothing to end

T = TypeVar("T")
Story = Generator[None, None, T]


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
    which there must be none. `after_noticed`: motion commands of any step later than `noticed`, and `next_step`: those of a later step of
    the procedure, while the fault lasts; of one that happens once, until all guards are content again. `drift` [m]: how far a tip still
    went after the hold. `verdict`: held, at rest (nothing moved and nothing was sent), not noticed, tolerated (not noticed, harmless by
    the rules of the robot, and the step ended well), or not held.
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
    after_noticed: int
    drift: float
    next_step: int
    outcome: str
    verdict: str


def lead(stand: Watched, phase: Phase, moments: Moments = MOMENTS) -> Story[None]:
    """The session goes on to the moment of `phase`.

    Raises:
        RuntimeError: it never came there.
    """
    doing, after, _ = moments[phase]
    while not (stand.doing[0].startswith(doing) and stand.now() - stand.doing[1] >= after):
        if stand.ended or stand.now() > LONGEST:
            raise RuntimeError(f"the session never came to {phase}: it was {stand.doing[0]!r}; {_ending()}")
        yield


def watch(stand: Watched, fault: Fault, phase: Phase, patience: Patience) -> Story[Row]:
    """`fault` happens now; see what becomes of the session."""
    arm = arm_of(fault, phase)
    seen = _Seen(stand, once=isinstance(fault, Served) and fault in ONCE)
    inject(stand, fault, arm)
    while not (seen.noticed and stand.now() - seen.start >= seen.noticed[0] + patience.watched):
        if stand.now() - seen.start > patience.unnoticed:
            break
        yield
        seen.look()
    held, last, after, late, further = seen.commands()
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
    outcome = yield from _outcome(stand, seen, patience)
    if verdict == "not noticed" and seen.ended_well and fault in TOLERATED:
        verdict = "tolerated"
    return Row(fault.value, phase.value, arm, str(code), message, at, last, held, after, late, drift, further, outcome, verdict)


class _Seen:
    """What is seen of a session from now on."""

    def __init__(self, stand: Watched, once: bool) -> None:
        self._stand, self._once = stand, once
        self.start, self.begun = stand.now(), stand.begun
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
            self.noticed, self.begun = found, self._stand.begun  # a step that began meanwhile is none that looks again
            if not any(self._guards()):
                self._content = found[0]  # a step failed at which no guard takes offence: the session may go on at once
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

    def commands(self) -> tuple[float | None, float | None, int, int, int]:
        """When both arms were held, the last motion command, those after the arm's hold, those after it was noticed, of a later step."""
        mine = [one for one in self._stand.heard[self._commands :] if one.ours]
        holds = {arm: min((one.at for one in mine if one.arm == arm and one.name == HOLD), default=math.inf) for arm in ARMS}
        motions = [one for one in mine if one.name not in STOPS]
        same = [one for one in motions if one.lease in (0, self._lease)]
        self._until = min((one.at - self.start for one in motions if one not in same), default=math.inf)
        held = max(holds.values()) - self.start
        last = max((one.at - self.start for one in same), default=None)
        after = sum(one.at > holds[one.arm] + 1e-9 for one in same)
        later = [one for one in motions if one not in same and (not self._once or one.at - self.start < self._content)]
        noticed = self.start + (self.noticed[0] if self.noticed else math.inf)
        late = sum(one.at > noticed + 1e-9 for one in (*same, *later))
        return (held if math.isfinite(held) else None), last, after, late, len(later)

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
        if not stand.ended:  # nobody asks them any more
            for code, message in self._guards():
                yield now, code, message

    def _guards(self) -> Iterator[tuple[Code, str]]:
        gate = self._stand.gate
        assert gate is not None
        for check in (gate.check_arms, gate.check_camera, gate.check_workspace, gate.check_tension):
            verdict = check()
            if not verdict.ok:
                yield verdict.code, verdict.message


def _outcome(stand: Watched, seen: _Seen, patience: Patience) -> Story[str]:
    """How the session ended, or what it does when the fault is gone."""
    if seen.noticed is None:
        until = stand.now() + STEP_ENDS
        while seen.step is None and not stand.ended and stand.now() < until:
            yield
            seen.follow_step()
        step = "goes on" if seen.step is None else f"{seen.step[0]}: {seen.step[1]}"
        return f"{step}; {_ending()}" if stand.ended else step
    if stand.ended:
        return _ending()
    first = "waits" if seen.interrupted else GOES_ON
    if stand.begun > seen.begun:
        return f"{first}; looks again"
    clear(stand)
    begun, until = stand.begun, stand.now() + patience.recovery
    while not stand.ended and stand.now() < until and (stand.begun == begun or stand.lease() == 0):
        yield
    again = stand.begun > begun
    if stand.ended:
        return f"{first}; when the fault is gone: {_ending()}"
    if not seen.interrupted:
        return first
    return f"{first}; when the fault is gone: {'looks again' if again else 'goes on waiting'}"


def _ending() -> str:
    outcome = board.read(board.OUTCOME)
    return f"ends: {outcome.code}" if outcome else "no outcome"
