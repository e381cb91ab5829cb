"""The operator is asked at the terminal without holding up the tree; only a clear yes to the open question counts."""

import threading

import numpy as np
import pytest

from behaviours.proposal import Proposal
from supervisor.approvers import AutoApprover, PromptApprover


def proposal(name: str = "a") -> Proposal:
    return Proposal("goal", name, np.zeros((2, 2)), np.zeros((0, 2, 2)), 1, 0.0, "cut along the goal as drawn")


def answered(approver: PromptApprover) -> None:
    for thread in threading.enumerate():
        if thread is not threading.main_thread() and thread.daemon:
            thread.join(timeout=2.0)


@pytest.mark.parametrize(("typed", "approved"), [("y", True), ("YES", True), ("", False), ("n", False), ("maybe", False)])
def test_only_a_clear_yes_approves(typed, approved):
    approver = PromptApprover(lambda question: typed)
    approver.request(proposal())
    answered(approver)

    answer = approver.answer()
    assert answer is not None
    assert (answer.approved, answer.goal_id, answer.by) == (approved, "a", "operator")


def test_a_closed_terminal_declines():
    def closed(question: str) -> str:
        raise EOFError

    approver = PromptApprover(closed)
    approver.request(proposal())
    answered(approver)

    assert approver.answer().approved is False


def test_there_is_no_answer_while_the_operator_thinks_and_a_late_one_does_not_count():
    gate = threading.Event()

    def slow(question: str) -> str:
        gate.wait(2.0)
        return "y"

    approver = PromptApprover(slow)
    approver.request(proposal())
    assert approver.answer() is None
    approver.cancel()
    gate.set()
    answered(approver)

    assert approver.answer() is None


def test_the_automatic_approver_answers_the_newest_question_only():
    approver = AutoApprover()
    assert approver.answer() is None
    approver.request(proposal("a"))
    approver.request(proposal("b"))

    assert approver.answer().goal_id == "b"
    approver.cancel()
    assert approver.answer() is None
