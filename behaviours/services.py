"""What the leaves of the tree are given: the gate, the skills, the operator, the record. The session fills it once."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from behaviours.proposal import Approver
from hardware.codes import Code, InputError
from hardware.gate import Lease, SafetyGate
from hardware.interface import Array
from skills.checklist_outcome import CheckOutcome
from skills.dissect.outcome import DissectOutcome
from skills.estimate.graph import ConnectivityGraph
from skills.expose.outcome import ExposeOutcome
from skills.replan.next_goal import NextGoal
from skills.retreat_outcome import RetreatOutcome
from skills.scene.goal import Goal
from skills.skill import Steps
from skills.tracking.outcome import TrackOutcome
from skills.tracking.tracks import TrackedGoal

log = logging.getLogger(__name__)


class SkillSet(Protocol):
    """Every skill of a session. Each call gives a fresh generator; only one of those with a lease runs at a time."""

    def checklist(self) -> Steps[CheckOutcome]:
        """Enable and home the arms, then check everything that motion needs."""
        ...

    def start_tracking(self, goal: Goal) -> Steps[TrackOutcome]:
        """Begin to follow the approved goal on the newest frame."""
        ...

    def track(self) -> Steps[None]:
        """Look at the newest frame when due, without end; `tracked` gives the result."""
        ...

    def tracked(self) -> TrackedGoal | None:
        """Give the goal as last seen; None before tracking has started."""
        ...

    def dissect(self, lease: Lease, segments: Array | None) -> Steps[DissectOutcome]:
        """Cut along the whole goal, or only along `segments` (S, 2, 2) pixels of the newest tracked frame."""
        ...

    def expose(self, lease: Lease) -> Steps[ExposeOutcome]:
        """Pull the tissue so that the dissected region is seen, stretched."""
        ...

    def estimate(self) -> Steps[ConnectivityGraph]:
        """Judge which connections across the goal are severed."""
        ...

    def replan(self, graph: ConnectivityGraph) -> Steps[NextGoal]:
        """Plan the segments that sever what is left."""
        ...

    def retreat(self, lease: Lease) -> Steps[RetreatOutcome]:
        """Lift the tools clear; both arms hold."""
        ...


@dataclass(frozen=True)
class Services:
    """All that the leaves need.

    `note(topic, payload)` takes events for the record (plain JSON values, SI units); leaves call `tell`. `recorder_fault` gives a
    sentence when the record cannot be written any more, else None.

    Raises:
        InputError: a setting is out of range.
    """

    gate: SafetyGate
    skills: SkillSet
    approver: Approver
    goal: Goal
    recorder_fault: Callable[[], str | None]
    note: Callable[[str, dict[str, Any]], None]
    max_attempts: int = 3
    feedback: bool = True  # False: only dissect, max_attempts times, without looking what is left
    approval_lifetime: float = 600.0  # [s] of bench time, from the question to the answer and again from the answer on
    max_displacement: float = 8.0  # [px], median, that the goal may have moved between asking and cutting
    max_asks: int = 3  # questions in a row for one approval before the session gives up
    hold_patience: float = 1.0  # [s] within which both arms must have come to rest before a skill starts

    def __post_init__(self) -> None:
        for name in ("max_attempts", "max_asks"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} is {getattr(self, name)}; it must be at least 1")
        for name in ("approval_lifetime", "max_displacement", "hold_patience"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise InputError(f"{name} is {getattr(self, name)}; it must be a finite number above 0")

    def tell(self, topic: str, **payload: Any) -> None:
        """Put an event into the record. If that fails everything stops, as nothing may happen unrecorded."""
        try:
            self.note(topic, payload)
        except Exception as error:
            log.exception("an event could not be recorded")
            self.gate.trip(Code.RECORDER_FAILED, f"an event could not be recorded: {error}")
