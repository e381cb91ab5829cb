from __future__ import annotations

from py_trees.common import Status

from behaviours.board import Step, read, result_of
from behaviours.track import Track
from hardware.codes import Code
from tests.mocks.skills import script
from tests.mocks.stage import Stage


def tracking(**words: str | list[str]) -> Stage:
    stage = Stage(script(**words))
    stage.build(lambda services: Track(Step.TRACK_DISSECT, services))
    return stage


def test_it_runs_for_ever_without_a_lease() -> None:
    stage = tracking()

    assert stage.tick(50) is Status.RUNNING
    assert stage.gate.lease is None


def test_tracking_that_ends_by_itself_is_a_failure() -> None:
    stage = tracking(track=["running", "ended"])

    assert stage.tick(3) is Status.FAILURE
    result = read(result_of(Step.TRACK_DISSECT))
    assert result is not None and (result.code, result.message) == (Code.INTERNAL_ERROR, "tracking ended by itself")


def test_tracking_that_raises_is_a_failure() -> None:
    stage = tracking(track="raise")

    assert stage.tick(2) is Status.FAILURE
    assert stage.root.feedback_message == "RuntimeError: track broke"


def test_preempted_it_is_closed_and_starts_afresh() -> None:
    stage = tracking()
    stage.tick(2)

    stage.root.stop(Status.INVALID)
    assert stage.skills.opened == []
    stage.tick(2)

    assert stage.skills.begun == ["track", "track"]
