from __future__ import annotations

import pytest

from behaviours.recovery import Recovery, recovery
from behaviours.session_outcome import SessionOutcome, StepResult, newest_failure
from hardware.codes import Code


@pytest.mark.parametrize(
    "code",
    [
        Code.EMERGENCY_STOP,
        Code.ARM_FAULT,
        Code.TENSION_ABORT,
        Code.RECORDER_FAILED,
        Code.INTERNAL_ERROR,
        Code.NOT_APPROVED,
        Code.TRIPPED,
        Code.ABORTED,
    ],
)
def test_after_what_only_a_person_can_clear_nothing_is_tried(code: Code) -> None:
    assert recovery(code) is Recovery.END


def test_a_lost_grasp_is_taken_anew_and_an_unfinished_cut_is_looked_at() -> None:
    assert recovery(Code.GRASP_SLIPPED) is Recovery.RETRY
    assert recovery(Code.NO_CANDIDATE) is Recovery.RETRY
    assert recovery(Code.STEP_TOO_LONG) is Recovery.LOOK


@pytest.mark.parametrize("code", [Code.DEPTH_INVALID, Code.SURFACE_INVALID, Code.GOAL_LOST, Code.TOO_MANY_UNKNOWN])
def test_what_one_picture_did_not_show_is_looked_at_once_more(code: Code) -> None:
    assert recovery(code) is Recovery.LOOK


def test_of_several_failures_the_newest_is_told() -> None:
    old, new, fine = (
        StepResult(1.0, Code.TENSION, "an old one"),
        StepResult(2.0, Code.GOAL_LOST, "a new one"),
        StepResult(3.0, Code.OK, "all is well"),
    )

    assert newest_failure([old, None, new, fine]) == SessionOutcome(Code.GOAL_LOST, "a new one")


def test_of_two_failures_at_one_instant_the_later_in_the_tree_is_told() -> None:
    first, second = StepResult(1.0, Code.TENSION, "first"), StepResult(1.0, Code.GOAL_LOST, "second")

    assert newest_failure([first, second]).message == "second"
