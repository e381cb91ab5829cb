"""What a live view keeps from one tick to the next: the last refusals, the last lines of the log, where an exposure stands."""

from __future__ import annotations

from dataclasses import dataclass, replace

from supervisor.exposing import in_words, is_exposing
from supervisor.snapshot import TickSnapshot

KEPT_REFUSALS = 4
KEPT_LINES = 6


@dataclass(frozen=True)
class Refused:
    """One kind of refused command: the last one's `stamp` [s], how often in a row it was refused, and why."""

    stamp: float
    arm: str
    command: str
    code: str
    message: str
    times: int = 1


@dataclass(frozen=True)
class Recent:
    """The newest last: refusals (the same one in a row counted, not repeated), and log lines with their bench time.

    `exposing` is what the exposure controller expects of its newest step, in words; empty while nothing is pulled.
    """

    refusals: tuple[Refused, ...] = ()
    lines: tuple[tuple[float, str], ...] = ()
    exposing: str = ""

    def after(self, snapshot: TickSnapshot) -> Recent:
        """Give what is kept once `snapshot` has been seen."""
        refusals = list(self.refusals)
        for d in snapshot.decisions:
            if d.accepted:
                continue
            new = Refused(d.stamp, d.arm, d.command, str(d.code), d.message)
            last = refusals[-1] if refusals else None
            if last and (last.arm, last.command, last.code) == (new.arm, new.command, new.code):
                refusals[-1] = replace(new, times=last.times + 1)
            else:
                refusals.append(new)
        lines = (*self.lines, *((snapshot.stamp, text) for text in snapshot.log))
        exposing = self.exposing if snapshot.exposure is None else in_words(snapshot.exposure)
        shown = exposing if is_exposing(snapshot.nodes) else ""
        return Recent(tuple(refusals[-KEPT_REFUSALS:]), lines[-KEPT_LINES:], shown)
