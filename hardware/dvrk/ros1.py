"""A node on a ROS 1 graph, by Debian's rospy. Import this module late: it needs ROS.

rospy can be one node of a process, once. Callbacks come from a thread for each connection. A master that is restarted no longer knows
the nodes from before, so `alive` asks it for ourselves: a node that it does not know can reach nobody new and must be started again.
"""

from __future__ import annotations

import math
import os
import tempfile
import threading
import time
import warnings
import xmlrpc.client
from collections.abc import Callable, Mapping
from http.client import HTTPConnection, HTTPException
from pathlib import Path
from typing import Any, TypeVar

import rosgraph
import rospy

from hardware.dvrk.messages import Message, Picture, Service
from hardware.dvrk.ros1_classes import message_class, service_class
from hardware.dvrk.ros_messages import from_ros, receiver, to_ros
from hardware.dvrk.transport import Clock, TransportError

M = TypeVar("M", bound=Message)
Q = TypeVar("Q")
A = TypeVar("A")

SILENCE = 0.5  # [s] for which the master may be silent before it counts as gone; one that refuses is gone at once
ASK_EVERY = 0.04  # [s]
KNOWN_FOR = 0.2  # [s] for which it stays known who publishes what
FLUSH = 0.05  # [s]; every connection sends from a thread of its own
LEAVE = 2.0  # [s] for which a master that hangs may delay our leaving
PICTURE_BUFFER = (
    1 << 24
)  # bytes; rospy drops old messages only among those within its buffer, so that small ones make pictures late

_started = threading.Event()


class PublisherROS1:
    """See `transport.Publisher`."""

    def __init__(self, topic: str, kind: type[Message], latched: bool, queue: int) -> None:
        self._class = message_class(kind.ROS)
        self._topic, self._kind = topic, kind
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SyntaxWarning)  # that there is no queue
            self._ros = rospy.Publisher(topic, self._class, latch=latched, queue_size=queue or None, tcp_nodelay=True)

    def publish(self, message: Message) -> None:
        """Send it.

        Raises:
            TransportError: the node has left the graph.
        """
        if not isinstance(message, self._kind):
            raise TypeError(f"{self._topic} carries {self._kind.__name__}, not {type(message).__name__}")
        try:
            self._ros.publish(to_ros(message, self._class()))
        except rospy.ROSException as error:
            raise TransportError(f"{self._topic} is closed, and cannot be published: {error}") from None

    def listeners(self) -> int:
        """Count the connections."""
        return int(self._ros.get_num_connections()) if self._ros.impl is not None else 0

    def close(self) -> None:
        """Stop publishing."""
        if self._ros.impl is not None:
            self._ros.unregister()


class SubscriptionROS1:
    """See `transport.Subscription`."""

    def __init__(self, topic: str, kind: type[M], callback: Callable[[M, float], None], queue: int, clock: Clock) -> None:
        buffer = PICTURE_BUFFER if kind is Picture else 1 << 16
        found = message_class(kind.ROS)
        receive = receiver(topic, kind, callback, clock)
        self._ros = rospy.Subscriber(topic, found, receive, queue_size=queue, buff_size=buffer, tcp_nodelay=True)

    def sources(self) -> int:
        """Count the connections that stand; rospy also keeps those that were reset, and tries them again and again."""
        topic = self._ros.impl
        return sum(_stands(connection) for connection in tuple(topic.connections or ())) if topic is not None else 0

    def close(self) -> None:
        """Stop listening."""
        if self._ros.impl is not None:
            self._ros.unregister()


class TransportROS1:
    """See `transport.Transport`. The master is the one that ROS_MASTER_URI names."""

    def __init__(self, name: str, clock: Clock = time.monotonic) -> None:
        if _started.is_set():
            raise TransportError("this process was a ROS 1 node already, and can be only one; start another process")
        uri = rosgraph.get_master_uri()
        self._master, self._uri = _Master(uri), uri
        self._master.ask("getPid", name)
        _started.set()
        _become_node(name)
        self._clock = clock
        self._knew_us = time.monotonic()  # when the master last said so
        self._turn = threading.Lock()
        self._publishers: dict[str, list[str]] = {}  # of each topic, as the master said at `_asked` [s]
        self._asked = -math.inf
        self._left = threading.Event()
        threading.Thread(target=self._watch_master, name="ROS master", daemon=True).start()

    @property
    def clock(self) -> Clock:
        """The clock of receive times."""
        return self._clock

    def stamp(self) -> float:
        """ROS time [s]."""
        return float(rospy.get_time())

    def publisher(self, topic: str, kind: type[M], latched: bool = False, queue: int = 1) -> PublisherROS1:
        """Offer a topic."""
        return PublisherROS1(topic, kind, latched, queue)

    def subscribe(
        self, topic: str, kind: type[M], callback: Callable[[M, float], None], latched: bool = False, queue: int = 1
    ) -> SubscriptionROS1:
        """Listen to a topic; in ROS 1 its publisher alone decides whether it is latched."""
        return SubscriptionROS1(topic, kind, callback, queue, self._clock)

    def serve(self, name: str, service: Service[Q, A], answer: Callable[[Q], A]) -> None:
        """Answer a service; calls come from threads of their own."""
        found = service_class(service.ros)

        def respond(question: Any) -> Any:
            return to_ros(answer(from_ros(service.question, question)), found._response_class())

        rospy.Service(name, found, respond)  # rospy keeps it

    def call(self, name: str, service: Service[Q, A], question: Q, timeout: float) -> A:
        """Ask a service. rospy itself waits for ever, so a thread of ours asks and is left behind when it is late."""
        found = service_class(service.ros)
        request = to_ros(question, found._request_class())
        answers: list[Any] = []

        def ask() -> None:
            try:
                rospy.wait_for_service(name, timeout)
                answers.append(rospy.ServiceProxy(name, found)(request))
            except (rospy.ROSException, rospy.ServiceException, OSError) as error:
                answers.append(error)

        thread = threading.Thread(target=ask, name=f"call of {name}", daemon=True)
        thread.start()
        thread.join(timeout)
        if not answers:
            raise TransportError(f"{name} did not answer within {timeout:.1f} s; is the robot's node running?")
        if isinstance(answers[0], Exception):
            raise TransportError(f"{name} did not answer: {answers[0]}")
        return from_ros(service.answer, answers[0])

    def kinds(self) -> Mapping[str, str]:
        """What is published, as the master knows it.

        Raises:
            TransportError: the master does not answer.
        """
        return {str(topic): str(kind) for topic, kind in self._master.ask("getPublishedTopics", rospy.get_name(), "")}

    def publishers_of(self, topic: str) -> tuple[str, ...]:
        """Who publishes, as the master knows it.

        Raises:
            TransportError: the master does not answer.
        """
        with self._turn:
            # Who asks, asks of many topics at once; and to read all that a master tells takes it as long as ten looks of the monitor.
            if time.monotonic() - self._asked > KNOWN_FOR:
                self._publishers = dict(self._master.ask("getSystemState", rospy.get_name())[0])
                self._asked = time.monotonic()
            return tuple(str(node).removeprefix("/") for node in self._publishers.get(topic, ()))

    def alive(self) -> bool:
        """Whether the master answers, and knows us."""
        return time.monotonic() - self._knew_us <= 2.0 * SILENCE and not self._left.is_set()

    def close(self) -> None:
        """Leave the graph for good, when what was sent last has gone out."""
        if self._left.is_set():
            return
        time.sleep(FLUSH)
        self._left.set()
        leaving = threading.Thread(target=_leave, daemon=True)
        leaving.start()
        leaving.join(LEAVE)

    def _watch_master(self) -> None:
        watch = _Master(self._uri)
        node, at = rospy.get_name(), rospy.get_node_uri()
        while not self._left.wait(ASK_EVERY):
            try:
                known = watch.ask("lookupNode", node, node) == at
            except TransportError:
                known = False
            self._knew_us = time.monotonic() if known else -math.inf


def _stands(connection: Any) -> bool:
    try:
        return connection.socket is not None and bool(connection.socket.getpeername())
    except (AttributeError, OSError):  # it went away, or is not there yet
        return False


def _leave() -> None:
    """Shut rospy down, but first its server for other nodes: rospy itself closes the socket and leaves the loop running, a core's worth."""
    for hook in tuple(rospy.core._shutdown_hooks or ()):
        node = getattr(hook, "__self__", None)
        if isinstance(node, rosgraph.xmlrpc.XmlRpcNode) and node.server is not None:
            node.is_shutdown = True  # or it starts again
            node.server.shutdown()
    rospy.signal_shutdown("closed")


def _become_node(name: str) -> None:
    """Start rospy without its signal handlers and its log configuration, which would close the log files of the program."""
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder, "logging.yaml")
        config.write_text("version: 1\nincremental: true\n")
        before = os.environ.get("ROS_PYTHON_LOG_CONFIG_FILE")
        os.environ["ROS_PYTHON_LOG_CONFIG_FILE"] = str(config)
        try:
            rospy.init_node(name, anonymous=True, disable_signals=True, disable_rosout=True)
        finally:
            del os.environ["ROS_PYTHON_LOG_CONFIG_FILE"]
            if before is not None:
                os.environ["ROS_PYTHON_LOG_CONFIG_FILE"] = before


class _Master:
    """The master's interface, which may be asked from any thread and never hangs."""

    def __init__(self, uri: str) -> None:
        self._uri = uri
        self._turn = threading.Lock()
        self._proxy = xmlrpc.client.ServerProxy(uri, transport=_Impatient())

    def ask(self, what: str, *arguments: str) -> Any:
        """Its answer.

        Raises:
            TransportError: it does not answer, or only with an error.
        """
        try:
            with self._turn:
                code, text, value = getattr(self._proxy, what)(*arguments)
        except (OSError, HTTPException, xmlrpc.client.Error) as error:
            raise TransportError(
                f"no ROS master answers at {self._uri} ({error}); start roscore, or set ROS_MASTER_URI"
            ) from None
        if code != 1:
            raise TransportError(f"the ROS master at {self._uri} refused {what}: {text}")
        return value


class _Impatient(xmlrpc.client.Transport):
    def make_connection(self, host: Any) -> HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = SILENCE
        return connection
