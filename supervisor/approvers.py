"""Who approves a goal: nobody needs asking on the stub (auto), or the operator at the terminal (prompt)."""

from __future__ import annotations

import threading
from collections.abc import Callable

from behaviours.proposal import Answer, Proposal


class AutoApprover:
    """Approves everything at once; for the stub only."""

    def __init__(self) -> None:
        self._proposal: Proposal | None = None

    def request(self, proposal: Proposal) -> None:
        """Remember what was proposed."""
        self._proposal = proposal

    def answer(self) -> Answer | None:
        """Yes."""
        return None if self._proposal is None else Answer(self._proposal.goal_id, True, "auto", "approved without asking")

    def cancel(self) -> None:
        """Forget the proposal."""
        self._proposal = None


class PromptApprover:
    """Asks at the terminal, in a thread of its own, so that the tree goes on ticking while the operator thinks."""

    def __init__(self, ask: Callable[[str], str]) -> None:
        self._ask = ask
        self._answer: Answer | None = None
        self._current: Proposal | None = None

    def request(self, proposal: Proposal) -> None:
        """Ask for y or n."""
        self._current, self._answer = proposal, None
        threading.Thread(target=self._wait, args=(proposal,), daemon=True).start()

    def answer(self) -> Answer | None:
        """The operator's answer to the newest proposal, None while there is none."""
        return self._answer

    def cancel(self) -> None:
        """A late answer will not count."""
        self._current = self._answer = None

    def _wait(self, proposal: Proposal) -> None:
        try:
            what = "goal" if proposal.kind == "goal" else "corrective goal"
            text = self._ask(f"{proposal.reason}\nApprove this {what}? [y/N] ")
        except EOFError:
            text = ""
        yes = text.strip().lower() in ("y", "yes")
        if self._current is proposal:
            comment = "approved at the terminal" if yes else "declined at the terminal"
            self._answer = Answer(proposal.goal_id, yes, "operator", comment)
