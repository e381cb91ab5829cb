"""A graph within one process: for tests of the driver without ROS, where every message and every second is decided by the test."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

from hardware.dvrk.messages import Message, Service
from hardware.dvrk.transport import Clock, TransportError

M = TypeVar("M", bound=Message)
Q = TypeVar("Q")
A = TypeVar("A")


@dataclass
class LocalGraph:
    """The topics and services; messages are delivered at once, on the thread that publishes them."""

    clock: Clock
    epoch: float = 1.7e9  # [s] what ROS time is when the clock says 0
    up: bool = True  # False: the master is gone; nothing is delivered
    listeners: dict[str, list[LocalSubscription]] = field(default_factory=lambda: defaultdict(list))
    offers: dict[str, list[LocalPublisher]] = field(default_factory=lambda: defaultdict(list))
    services: dict[str, Callable[[Any], Any]] = field(default_factory=dict)

    def node(self, name: str, stamps_ahead: float = 0.0) -> LocalTransport:
        """A node on this graph, whose own ROS clock is `stamps_ahead` [s] of the others'."""
        return LocalTransport(self, name, stamps_ahead)


class LocalPublisher:
    """See `transport.Publisher`."""

    def __init__(self, graph: LocalGraph, node: str, topic: str, kind: type[Message], latched: bool) -> None:
        self.graph, self.node, self.topic, self.kind, self.latched = graph, node, topic, kind, latched
        self.last: Message | None = None
        graph.offers[topic].append(self)

    def publish(self, message: Message) -> None:
        """Deliver to all listeners of the same kind."""
        if not self.graph.up:
            return
        if not isinstance(message, self.kind):
            raise TypeError(f"{self.topic} carries {self.kind.__name__}, not {type(message).__name__}")
        if self.latched:
            self.last = message
        for listener in tuple(self.graph.listeners[self.topic]):
            listener.deliver(message)

    def listeners(self) -> int:
        """Count them."""
        return sum(listener.kind is self.kind for listener in self.graph.listeners[self.topic])

    def close(self) -> None:
        """Stop publishing."""
        if self in self.graph.offers[self.topic]:
            self.graph.offers[self.topic].remove(self)


class LocalSubscription:
    """See `transport.Subscription`."""

    def __init__(self, graph: LocalGraph, topic: str, kind: type[Message], callback: Callable[[Any, float], None]) -> None:
        self.graph, self.topic, self.kind, self.callback = graph, topic, kind, callback
        graph.listeners[topic].append(self)
        for offer in graph.offers[topic]:
            if offer.last is not None:
                self.deliver(offer.last)

    def deliver(self, message: Message) -> None:
        """Call back with the message; one of another kind does not get through, as on a real graph."""
        if self.graph.up and isinstance(message, self.kind):
            self.callback(message, self.graph.clock())

    def sources(self) -> int:
        """Count the publishers."""
        return sum(offer.kind is self.kind for offer in self.graph.offers[self.topic])

    def close(self) -> None:
        """Stop listening."""
        if self in self.graph.listeners[self.topic]:
            self.graph.listeners[self.topic].remove(self)


class LocalTransport:
    """See `transport.Transport`."""

    def __init__(self, graph: LocalGraph, name: str, stamps_ahead: float) -> None:
        self._graph, self._name, self._ahead = graph, name, stamps_ahead
        self._mine: list[LocalPublisher | LocalSubscription] = []

    @property
    def clock(self) -> Clock:
        """The graph's clock."""
        return self._graph.clock

    def stamp(self) -> float:
        """ROS time of this node [s]."""
        return self._graph.epoch + self._graph.clock() + self._ahead

    def publisher(self, topic: str, kind: type[M], latched: bool = False, queue: int = 1) -> LocalPublisher:
        """Offer a topic."""
        publisher = LocalPublisher(self._graph, self._name, topic, kind, latched)
        self._mine.append(publisher)
        return publisher

    def subscribe(
        self, topic: str, kind: type[M], callback: Callable[[M, float], None], latched: bool = False, queue: int = 1
    ) -> LocalSubscription:
        """Listen to a topic."""
        subscription = LocalSubscription(self._graph, topic, kind, callback)
        self._mine.append(subscription)
        return subscription

    def serve(self, name: str, service: Service[Q, A], answer: Callable[[Q], A]) -> None:
        """Answer a service."""
        self._graph.services[name] = answer

    def call(self, name: str, service: Service[Q, A], question: Q, timeout: float) -> A:
        """Ask a service."""
        if not self._graph.up or name not in self._graph.services:
            raise TransportError(f"nobody answers {name}; start the robot's node first")
        answer: A = self._graph.services[name](question)
        return answer

    def kinds(self) -> Mapping[str, str]:
        """What is published."""
        return {topic: offers[0].kind.ROS for topic, offers in self._graph.offers.items() if offers}

    def publishers_of(self, topic: str) -> tuple[str, ...]:
        """Who publishes."""
        return tuple(offer.node for offer in self._graph.offers[topic])

    def alive(self) -> bool:
        """Whether the graph is up."""
        return self._graph.up

    def close(self) -> None:
        """Leave the graph."""
        for one in self._mine:
            one.close()
        self._mine.clear()
