"""A node on a ROS 2 graph, by rclpy of the dVRK's workspace. Import this module late: it needs ROS.

Everything is in a context of our own, so that nothing of the process is touched. One thread runs all callbacks, one after the other.
Without a master there is nothing that could be gone but this node itself; peers are known by what they send.
"""

from __future__ import annotations

import importlib
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

from hardware.dvrk.messages import CameraInfo, Message, Picture, Service
from hardware.dvrk.ros_messages import from_ros, receiver, to_ros
from hardware.dvrk.transport import Clock, TransportError

M = TypeVar("M", bound=Message)
Q = TypeVar("Q")
A = TypeVar("A")

FLUSH = 0.05  # [s]; the middleware may send from a thread of its own
LEAVE = 2.0  # [s] for which a callback that hangs may delay our leaving


class PublisherROS2:
    """See `transport.Publisher`."""

    def __init__(self, node: Any, topic: str, kind: type[Message], quality: QoSProfile) -> None:
        self._node, self._topic, self._kind = node, topic, kind
        self._class = _class_of(kind.ROS, "msg")
        self._ros = node.create_publisher(self._class, topic, quality)

    def publish(self, message: Message) -> None:
        """Send it.

        Raises:
            TransportError: the topic is closed, or the node has left the graph.
        """
        if not isinstance(message, self._kind):
            raise TypeError(f"{self._topic} carries {self._kind.__name__}, not {type(message).__name__}")
        if self._ros is None:
            raise TransportError(f"{self._topic} is closed, and cannot be published")
        self._ros.publish(to_ros(message, self._class()))

    def listeners(self) -> int:
        """Count the subscribers that match."""
        return int(self._ros.get_subscription_count()) if self._ros is not None else 0

    def close(self) -> None:
        """Stop publishing."""
        if self._ros is not None:
            self._node.destroy_publisher(self._ros)
            self._ros = None


class SubscriptionROS2:
    """See `transport.Subscription`."""

    def __init__(
        self, node: Any, topic: str, kind: type[M], callback: Callable[[M, float], None], quality: QoSProfile, clock: Clock
    ) -> None:
        self._node, self._topic = node, topic
        receive = receiver(topic, kind, callback, clock)
        self._ros = node.create_subscription(_class_of(kind.ROS, "msg"), topic, receive, quality)

    def sources(self) -> int:
        """Count the publishers of the topic."""
        return int(self._node.count_publishers(self._topic)) if self._ros is not None else 0

    def close(self) -> None:
        """Stop listening."""
        if self._ros is not None:
            self._node.destroy_subscription(self._ros)
            self._ros = None


class TransportROS2:
    """See `transport.Transport`. The graph is that of ROS_DOMAIN_ID."""

    def __init__(self, name: str, clock: Clock = time.monotonic) -> None:
        self._clock = clock
        self._context = Context()
        rclpy.init(context=self._context)
        self._node = rclpy.create_node(name, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._run, name=f"ROS 2 node {name}", daemon=True)
        self._thread.start()

    @property
    def clock(self) -> Clock:
        """The clock of receive times."""
        return self._clock

    def stamp(self) -> float:
        """ROS time [s]."""
        return float(self._node.get_clock().now().nanoseconds * 1e-9)

    def publisher(self, topic: str, kind: type[M], latched: bool = False, queue: int = 1) -> PublisherROS2:
        """Offer a topic."""
        return PublisherROS2(self._node, topic, kind, _quality(queue, latched))

    def subscribe(
        self, topic: str, kind: type[M], callback: Callable[[M, float], None], latched: bool = False, queue: int = 1
    ) -> SubscriptionROS2:
        """Listen to a topic; `latched` must be what its publisher is, or the last message does not come."""
        # Cameras often send as best they can; who insists on reliable delivery is not given anything by them.
        reliable = kind not in (Picture, CameraInfo)
        return SubscriptionROS2(self._node, topic, kind, callback, _quality(queue, latched, reliable), self._clock)

    def serve(self, name: str, service: Service[Q, A], answer: Callable[[Q], A]) -> None:
        """Answer a service, on the thread of the callbacks."""

        def respond(question: Any, response: Any) -> Any:
            return to_ros(answer(from_ros(service.question, question)), response)

        self._node.create_service(_class_of(service.ros, "srv"), name, respond)

    def call(self, name: str, service: Service[Q, A], question: Q, timeout: float) -> A:
        """Ask a service; never from a callback, whose thread would wait for itself."""
        if threading.current_thread() is self._thread:
            raise TransportError(f"{name} was asked from within a callback, which can never be answered; ask from another thread")
        found = _class_of(service.ros, "srv")
        deadline = time.monotonic() + timeout
        client = self._node.create_client(found, name)
        try:
            answered = threading.Event()
            if not client.wait_for_service(timeout_sec=timeout):
                raise TransportError(f"nobody answers {name}; start the robot's node first")
            future = client.call_async(to_ros(question, found.Request()))
            future.add_done_callback(lambda _: answered.set())
            if not answered.wait(max(0.0, deadline - time.monotonic())):
                raise TransportError(f"{name} did not answer within {timeout:.1f} s; is the robot's node running?")
            return from_ros(service.answer, future.result())
        finally:
            self._node.destroy_client(client)

    def kinds(self) -> Mapping[str, str]:
        """What is published; a topic that somebody only listens to is left out."""
        found = self._node.get_topic_names_and_types()
        return {topic: types[0].replace("/msg/", "/") for topic, types in found if self._node.count_publishers(topic) > 0}

    def publishers_of(self, topic: str) -> tuple[str, ...]:
        """Who publishes."""
        peers = self._node.get_publishers_info_by_topic(topic)
        return tuple(f"{peer.node_namespace}/{peer.node_name}".lstrip("/") for peer in peers)

    def alive(self) -> bool:
        """Whether this node still runs."""
        return bool(self._context.ok()) and self._thread.is_alive()

    def close(self) -> None:
        """Leave the graph for good, when what was sent last has gone out."""
        if not self._context.ok():
            return
        time.sleep(FLUSH)
        self._executor.shutdown(timeout_sec=LEAVE)
        self._thread.join(LEAVE)
        self._node.destroy_node()
        rclpy.shutdown(context=self._context)

    def _run(self) -> None:
        try:
            self._executor.spin()
        except ExternalShutdownException:
            return  # the context was shut down, by us or by a signal


def _quality(queue: int, latched: bool, reliable: bool = True) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=max(queue, 1),
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def _class_of(ros: str, folder: str) -> Any:
    package, name = ros.split("/")
    try:
        return getattr(importlib.import_module(f"{package}.{folder}"), name)
    except (ImportError, AttributeError):
        raise TransportError(
            f"this machine has no {ros} of ROS 2; source the setup.bash of the workspace that holds {package}"
        ) from None
