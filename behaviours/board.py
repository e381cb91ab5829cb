"""The blackboard, typed: the only memory between behaviours. Every key has one writer and a value that a record can hold.

Interruptions are counted, not flagged: whoever stores something that an interruption makes stale stores the count beside it, and
it is stale as soon as the counts differ. No flag has to be reset, so none can be forgotten.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Generic, TypeVar

import py_trees
from py_trees.common import Access

from behaviours.proposal import Proposal
from behaviours.session_outcome import SessionOutcome, StepResult
from skills.estimate.graph import ConnectivityGraph
from skills.replan.next_goal import NextGoal
from skills.tracking.tracks import TrackedGoal

T = TypeVar("T")


@dataclass(frozen=True)
class Key(Generic[T]):
    """A place on the blackboard and what is read from it before the first write."""

    name: str
    default: T


@dataclass(frozen=True)
class Attempt:
    """The attempt going on: its `number` from 1, whether it cuts or only looks, and the interruptions before it began."""

    number: int = 0
    cut: bool = True
    interruptions: int = 0


@dataclass(frozen=True)
class Estimate:
    """A completed estimate of connectivity, made in attempt `attempt` after `interruptions`."""

    graph: ConnectivityGraph
    attempt: int
    interruptions: int


@dataclass(frozen=True)
class Plan:
    """A corrective goal, planned after `interruptions` on the image where the goal was `seen`; None before it is tracked."""

    goal: NextGoal
    seen: TrackedGoal | None
    interruptions: int


class Step(StrEnum):
    """The leaves whose failure can end a procedure, in the order in which they come."""

    CHECKLIST = "checklist"
    APPROVE_GOAL = "approve goal"
    START_TRACKING = "start tracking"
    BEGIN_ATTEMPT = "begin attempt"
    TRACK_WHILE_ASKING = "track while asking"
    APPROVE_AGAIN = "approve again"
    TRACK_DISSECT = "track while dissecting"
    DISSECT = "dissect"
    TRACK_EXPOSE = "track while exposing"
    EXPOSE = "expose"
    ESTIMATE = "estimate"
    ATTEMPTS_LEFT = "attempts left"
    REPLAN = "replan"
    TRACK_WHILE_CORRECTING = "track while approving"
    APPROVE_CORRECTIVE = "approve corrective goal"
    RETREAT = "retreat"
    VERDICT = "verdict"


def result_of(name: str) -> Key[StepResult | None]:
    """Key of how the leaf `name` ended; None while it runs and before it ran."""
    return Key(f"/steps/{slug(name)}/result", None)


def lease_of(name: str) -> Key[bool]:
    """Key of whether the leaf `name` runs under a lease."""
    return Key(f"/steps/{slug(name)}/leased", False)


def slug(name: str) -> str:
    """Write a name as a blackboard key or path component."""
    return "_".join(name.replace("?", "").split())


RESULTS = tuple(result_of(step) for step in Step)
LEASES = tuple(lease_of(step) for step in (Step.DISSECT, Step.EXPOSE, Step.RETREAT))

CHECKLIST_PASSED: Key[bool] = Key("/checklist/passed", False)  # once in this session
TRACKING: Key[bool] = Key("/tracking/started", False)  # of the goal that the operator approved
CUTTING_BEGAN: Key[bool] = Key("/dissect/began", False)  # tissue may have been cut in this session
INTERRUPTIONS: Key[int] = Key("/procedure/interruptions", 0)
ATTEMPT: Key[Attempt] = Key("/attempts/now", Attempt())
LOOKED_AGAIN: Key[int] = Key("/attempts/looked_again", 0)  # the attempt in which the one further look was spent
ESTIMATE: Key[Estimate | None] = Key("/estimate/last", None)
PLAN: Key[Plan | None] = Key("/replan/plan", None)
GRANTED_GOAL: Key[Proposal | None] = Key("/approve_goal/granted", None)
GRANTED_AGAIN: Key[Proposal | None] = Key("/approve_again/granted", None)
GRANTED_CORRECTIVE: Key[Proposal | None] = Key("/approve_corrective_goal/granted", None)
GRANTS = (GRANTED_GOAL, GRANTED_AGAIN, GRANTED_CORRECTIVE)
VERDICT: Key[SessionOutcome | None] = Key("/attempts/verdict", None)
OUTCOME: Key[SessionOutcome | None] = Key("/session/outcome", None)


class Board:
    """One leaf's declared access: any key may be read that was named, and the keys it writes have no other writer."""

    def __init__(self, owner: str, reads: Iterable[Key[Any]] = (), writes: Iterable[Key[Any]] = ()) -> None:
        self._client = py_trees.blackboard.Client(name=owner)
        for key in writes:
            self._client.register_key(key.name, Access.EXCLUSIVE_WRITE)
        for key in {key.name: key for key in reads}.values():
            self._client.register_key(key.name, Access.READ)

    def get(self, key: Key[T]) -> T:
        """Read `key`, or its default before the first write."""
        try:
            value: T = self._client.get(key.name)
        except KeyError:
            return key.default
        return value

    def set(self, key: Key[T], value: T) -> None:
        """Write `key`."""
        self._client.set(key.name, value)


def read(key: Key[T]) -> T:
    """Read `key` from outside the tree, for views, records and tests."""
    storage: dict[str, Any] = py_trees.blackboard.Blackboard.storage
    return storage.get(key.name, key.default)
