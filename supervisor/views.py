"""What every live view is: something that is shown each tick's snapshot and closed at the end of the session."""

from typing import Protocol

from supervisor.snapshot import TickSnapshot


class View(Protocol):
    """A live view. Called from the session's thread; it must be cheap and may drop what it has no time to show."""

    def update(self, snapshot: TickSnapshot) -> None:
        """Show this tick."""
        ...

    def close(self) -> None:
        """Let go of the terminal, the file or the connection; idempotent."""
        ...
