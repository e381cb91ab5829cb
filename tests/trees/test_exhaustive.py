"""Every outcome of every leaf and every guard failing at every point; see `tests.trees.explorer`.

Sizes at the time of writing (states, transitions; processor time on one core): two attempts with the guards 287, 3217; 27 s. With what
happens to the scene 223, 2258; 22 s. Without feedback 138, 1384; 7 s and 94, 908; 6 s. Three undisturbed attempts 77, 480; 5 s. Skills
that end in their first step 63, 1524; 9 s.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator

import pytest

from hardware.codes import Code
from tests.mocks.stage import Stage
from tests.trees.explorer import LATCHED, PASSING, Explored, explore
from tests.trees.invariants import InvariantError

GUARDS = (*PASSING, *LATCHED, "all is well", "flicker", "notes fail", "abort")
SCENE = ("late", "scene shifts", "goal lost or found")
TRIPS = {Code.EMERGENCY_STOP, Code.ARM_FAULT, Code.TENSION_ABORT, Code.RECORDER_FAILED}


@pytest.fixture(autouse=True)
def _quiet() -> Iterator[None]:
    """The scripted exceptions are meant; their tracebacks would hide the script that is printed."""
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


def codes(explored: Explored) -> set[str]:
    return {code for _, code in explored.ends}


def test_whatever_the_guards_find_the_invariants_hold_and_the_session_can_end() -> None:
    explored = explore(events=GUARDS, settings={"max_attempts": 2})

    assert not explored.stuck()
    assert len(explored.scripts) > 250
    assert codes(explored) >= TRIPS | {Code.COMPLETE, Code.ATTEMPTS_USED, Code.ABORTED, Code.INTERNAL_ERROR, Code.NOT_APPROVED}


def test_whatever_happens_to_the_scene_the_invariants_hold_and_the_session_can_end() -> None:
    explored = explore(events=SCENE, settings={"max_attempts": 2})

    assert not explored.stuck()
    assert len(explored.scripts) > 150
    assert codes(explored) >= {Code.COMPLETE, Code.SCENE_MOVED, Code.APPROVAL_EXPIRED, Code.GOAL_LOST}


def test_without_feedback_the_invariants_hold_and_nothing_is_called_complete() -> None:
    explored = explore(events=GUARDS, settings={"max_attempts": 2, "feedback": False})

    assert not explored.stuck()
    assert codes(explored) >= TRIPS | {Code.UNVERIFIED}
    assert Code.COMPLETE not in codes(explored)


def test_without_feedback_the_scene_may_do_what_it_likes() -> None:
    explored = explore(events=SCENE, settings={"max_attempts": 2, "feedback": False})

    assert not explored.stuck()
    assert codes(explored) >= {Code.UNVERIFIED, Code.SCENE_MOVED, Code.APPROVAL_EXPIRED}


def test_three_attempts_without_disturbances_end_in_every_way() -> None:
    explored = explore(events=(), settings={"max_attempts": 3})

    assert not explored.stuck()
    assert codes(explored) >= {Code.COMPLETE, Code.ATTEMPTS_USED, Code.GRASP_EMPTY}
    # A plan is made only while another attempt is left, and that one looks again.
    assert Code.NO_CANDIDATE not in codes(explored)


def test_skills_that_end_in_their_first_step_change_nothing() -> None:
    def eager(stage: Stage) -> None:
        stage.skills.eager = True

    explored = explore(events=("notes fail",), settings={"max_attempts": 1}, sabotage=eager)

    assert not explored.stuck()
    assert codes(explored) >= {Code.COMPLETE, Code.ATTEMPTS_USED, Code.GRASP_EMPTY, Code.RECORDER_FAILED}


def test_the_explorer_finds_a_cut_without_approval() -> None:
    def sabotage(stage: Stage) -> None:
        def move(lease: object, cut: bool) -> None:
            stage.bench.cutter.move_jaw(0.8)
            stage.bench.cutter.move_jaw(0.1)

        stage.skills._move = move  # type: ignore[method-assign]

    with pytest.raises(InvariantError, match=r"(?s)the scissors closed without a live approval.*shortest script.*tick") as found:
        explore(events=(), settings={"max_attempts": 1}, sabotage=sabotage)

    # While dissecting there is an approval. The next to move is the retreat, soonest when tracking ends at once.
    assert [line.split(". ")[1] for line in str(found.value).splitlines()[2:]] == [
        "tick",
        "checklist: ok",
        "answer: yes",
        "start_tracking: ok",
        "track: ended",
        "tick",
    ]


def test_the_explorer_finds_a_lease_that_is_not_revoked() -> None:
    def sabotage(stage: Stage) -> None:
        stage.gate.revoke = lambda lease: None  # type: ignore[method-assign]

    with pytest.raises(InvariantError, match=r"(?s)a lease is alive although.*shortest script"):
        explore(events=(), settings={"max_attempts": 1}, sabotage=sabotage)


def test_the_explorer_finds_an_approval_that_is_never_withdrawn() -> None:
    def sabotage(stage: Stage) -> None:
        stage.gate.withdraw_approval = lambda: None  # type: ignore[method-assign]

    with pytest.raises(InvariantError, match=r"(?s)something is left over.*shortest script"):
        explore(events=(), settings={"max_attempts": 1}, sabotage=sabotage)


def test_the_explorer_finds_a_skill_that_is_never_closed() -> None:
    def sabotage(stage: Stage) -> None:
        stage.skills.opened = Kept()

    with pytest.raises(InvariantError, match="a skill is open whose leaf does not run"):
        explore(events=(), settings={"max_attempts": 1}, sabotage=sabotage)


class Kept(list[str]):
    """A list that nothing can be removed from: the trace of a generator that is left open."""

    def remove(self, value: str) -> None:
        pass
