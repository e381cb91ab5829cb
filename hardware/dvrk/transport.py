"""What the driver needs of a ROS graph, whatever its version: topics, services, and what else is on the graph.

Topics are absolute names (`/PSM1/measured_cp`). A callback is given the message and when it was received, by the transport's own
`clock`; clocks of the robot and of this machine may differ, so ages are told by receive times alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Protocol, TypeVar

from hardware.dvrk.messages import Message, Service

M = TypeVar("M", bound=Message)
M_in = TypeVar("M_in", bound=Message, contravariant=True)
Q = TypeVar("Q")
A = TypeVar("A")

Clock = Callable[[], float]  # monotonic [s]


class TransportError(RuntimeError):
    """The graph cannot be reached or used; one sentence that says what to do."""


class Publisher(Protocol[M_in]):
    """One topic that we publish."""

    def publish(self, message: M_in) -> None:
        """Send `message` now; it is lost where nobody listens, unless the topic is latched."""
        ...

    def listeners(self) -> int:
        """How many subscribers are connected."""
        ...

    def close(self) -> None:
        """Stop publishing."""
        ...


class Subscription(Protocol):
    """One topic that we listen to."""

    def sources(self) -> int:
        """How many publishers are connected."""
        ...

    def close(self) -> None:
        """Stop listening."""
        ...


class Transport(Protocol):
    """One node on one graph. Callbacks may come from any thread, those of one topic one after the other."""

    @property
    def clock(self) -> Clock:
        """The monotonic clock by which receive times are told."""
        ...

    def stamp(self) -> float:
        """ROS time now [s], for the headers of what we send."""
        ...

    def publisher(self, topic: str, kind: type[M], latched: bool = False, queue: int = 1) -> Publisher[M]:
        """Offer `topic`; `latched` ones give their last message to whoever connects later.

        `queue` messages wait for a slow listener, and the newest ones stay. With 0 none wait: `publish` sends by itself, at half the cost,
        and a listener that stood still for minutes would hold it up. Nothing that commands may do so.
        """
        ...

    def subscribe(
        self, topic: str, kind: type[M], callback: Callable[[M, float], None], latched: bool = False, queue: int = 1
    ) -> Subscription:
        """Listen to `topic`."""
        ...

    def serve(self, name: str, service: Service[Q, A], answer: Callable[[Q], A]) -> None:
        """Answer calls of the service `name`."""
        ...

    def call(self, name: str, service: Service[Q, A], question: Q, timeout: float) -> A:
        """Ask the service `name`.

        Raises:
            TransportError: it is not there, or did not answer within `timeout` [s].
        """
        ...

    def kinds(self) -> Mapping[str, str]:
        """The type's name (`pkg/Name`) of every topic that is published on the graph."""
        ...

    def publishers_of(self, topic: str) -> tuple[str, ...]:
        """The names of the nodes that publish `topic`, ours too."""
        ...

    def alive(self) -> bool:
        """Whether the graph still answers."""
        ...

    def close(self) -> None:
        """Leave the graph."""
        ...
