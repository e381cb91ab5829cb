"""What happens in a branch has not happened here; a process that cannot be split is refused, and nobody waits for ever."""

import threading

import pytest

from supervisor.experiments import faults_split
from supervisor.experiments.faults_split import branch


def test_a_branch_gives_what_it_found_and_leaves_nothing_behind():
    seen = [1]

    def act() -> int:
        seen.append(2)
        return sum(seen)

    assert branch(act, threading.enumerate()) == 3
    assert seen == [1]


def test_a_process_with_another_thread_is_not_split_unless_nothing_waits_for_it():
    done, before = threading.Event(), threading.enumerate()
    other = threading.Thread(target=done.wait, name="right-eye")
    other.start()

    try:
        with pytest.raises(RuntimeError, match="cannot be split: right-eye"):
            branch(lambda: 1, before)
        assert branch(lambda: 1, [*before, other]) == 1
    finally:
        done.set()
        other.join()


def test_a_branch_that_fails_is_an_error_here(capfd: pytest.CaptureFixture[str]):
    def act() -> int:
        raise ValueError("no such arm")

    with pytest.raises(RuntimeError, match="a branch of the session failed"):
        branch(act, threading.enumerate())
    assert "no such arm" in capfd.readouterr().err


def test_a_branch_that_hangs_is_ended(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(faults_split, "LONGEST", 0.2)

    with pytest.raises(RuntimeError, match="did not come to its end within"):
        branch(lambda: threading.Event().wait(), threading.enumerate())
