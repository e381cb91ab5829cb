"""What every skill is: one generator that advances a little at each tick and returns its outcome.

A skill receives a `Lease`, never an arm, and knows nothing about trees. Long computations go to the executor it was given; it
yields until they are done. Whatever happens, its `finally` leaves the arms holding.
"""

from collections.abc import Callable, Generator
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from hardware.codes import Code

T = TypeVar("T")


@dataclass(frozen=True)
class Progress:
    """What a skill is doing now, in words a surgeon understands, and how far it is (0..1, or None if unknown)."""

    message: str
    fraction: float | None = None


class Outcome(Protocol):
    """Every skill's result: a code and a sentence, beside what the skill gives."""

    @property
    def code(self) -> Code:
        """`Code.OK` on success."""
        ...

    @property
    def message(self) -> str:
        """One sentence for people."""
        ...


Steps = Generator[Progress, None, T]


def computed(executor: Executor, doing: str, function: Callable[..., T], *args: Any) -> Steps[T]:
    """Run `function(*args)` on `executor`, yielding until it is done; a result that comes after the skill ended is dropped."""
    future: Future[T] = executor.submit(function, *args)
    try:
        while not future.done():
            yield Progress(doing)
        return future.result()
    finally:
        future.cancel()


class ImmediateExecutor(Executor):
    """Runs each call at once in the caller's thread: the executor of tests and experiments."""

    def submit(self, fn: Callable[..., T], /, *args: Any, **kwargs: Any) -> Future[T]:  # type: ignore[override]
        """Run `fn` now and return its finished future."""
        future: Future[T] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future
