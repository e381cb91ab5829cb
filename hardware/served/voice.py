"""What an arm says on events: in order, and only after all of it has happened, for who hears it may command at once."""

from __future__ import annotations

import math
from collections.abc import Callable

from hardware.dvrk.messages import Message, String

Say = Callable[[str, Message], None]  # topic below the arm's namespace, message

WARN_EVERY = 2.0  # [s], that an arm is not ready
TRIES_PER_WARNING = 1000  # of commands that come too shallow


class Voice:
    """Keeps what is to be said until `flush`. Before `connect` nobody hears it, and nothing is kept."""

    def __init__(self, name: str, now: Callable[[], float]) -> None:
        self._name, self._now = name, now
        self._outbox: list[tuple[str, Message]] = []
        self._say: Say | None = None
        self._not_ready, self._errors = -math.inf, 0
        self._shallow = 0

    def connect(self, say: Say) -> None:
        """Speak through `say` from now on."""
        self._say = say

    def tell(self, topic: str, message: Message) -> None:
        """Say `message` at the next flush."""
        if self._say is not None:
            self._outbox.append((topic, message))

    def error(self, text: str) -> None:
        """Say what went wrong."""
        self.tell("error", String(f"{self._name}: {text}"))

    def warn(self, text: str) -> None:
        """Say what was refused."""
        self.tell("warning", String(f"{self._name}: {text}"))

    def not_ready(self, what: str) -> None:
        """Count a command that was rejected; say so now and then (reference 6.6)."""
        self._errors += 1
        if self._now() - self._not_ready >= WARN_EVERY - 1e-9:
            self._not_ready = self._now()
            self.warn(f"{what}, arm not ready ({self._errors} errors)")

    def too_shallow(self) -> None:
        """Count a command that came too near to the cannula; say so once in a thousand (reference 5)."""
        if self._shallow % TRIES_PER_WARNING == 0:
            self.warn("tool/endoscope needs to be inserted past the cannula to switch to cartesian space")
        self._shallow += 1

    def deep_enough(self) -> None:
        """Begin to count anew."""
        self._shallow = 0

    def flush(self) -> None:
        """Say all of it."""
        while self._outbox and self._say is not None:
            self._say(*self._outbox.pop(0))
