"""Energy of a cautery instrument. The dVRK only reads the pedals and drives no generator, so whoever applies energy stands outside it."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Protocol


class Application(Protocol):
    """One application of energy that was asked for."""

    def applied(self) -> bool | None:
        """True once energy was applied, False when it was not and will not be, None while nobody knows."""
        ...


class Energy(Protocol):
    """What applies energy where the spatula is now."""

    def apply(self, arm: str) -> Application:
        """Ask for one application at the tip of `arm`; returns at once."""
        ...


class OperatorApplication:
    """See `Application`: the answer comes from a person, on a thread of its own."""

    def __init__(self, ask: Callable[[str], str], question: str) -> None:
        self._ask, self._question = ask, question
        self._answer: bool | None = None
        threading.Thread(target=self._wait, name="energy", daemon=True).start()

    def applied(self) -> bool | None:
        """What the operator said."""
        return self._answer

    def _wait(self) -> None:
        try:
            text = self._ask(self._question)
        except EOFError:
            text = ""
        self._answer = text.strip().lower() in ("y", "yes")


class OperatorEnergy:
    """The default: the operator presses the generator's own pedal and confirms. No answer is no energy."""

    def __init__(self, ask: Callable[[str], str]) -> None:
        self._ask = ask

    def apply(self, arm: str) -> OperatorApplication:
        """Ask the operator."""
        return OperatorApplication(self._ask, f"Apply energy with the instrument of {arm} now. Was it applied? [y/N] ")


class NoAnswer:
    """An application that nobody will make."""

    def applied(self) -> bool | None:
        """No."""
        return False


class NoEnergy:
    """Where nobody applies energy: every application fails, and so does the cut."""

    def apply(self, arm: str) -> NoAnswer:
        """Nothing happens."""
        return NoAnswer()
