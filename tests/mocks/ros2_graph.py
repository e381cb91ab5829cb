"""rclpy for tests: a graph within the process, whose messages check the types of their attributes as those of ROS 2 do."""

from __future__ import annotations

import sys
import threading
from array import array
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar

import pytest

FLOATS = "floats"
WORDS = "words"
INTS = "ints"
BYTES = "bytes"

# Field by field, as in the definitions of ROS 2; a dictionary is a message within.
TIME = {"sec": int, "nanosec": int}
HEADER = {"stamp": TIME, "frame_id": str}
XYZ = {"x": float, "y": float, "z": float}
POSE = {"position": XYZ, "orientation": {**XYZ, "w": float}}
STATE = {"header": HEADER, "state": str, "is_homed": bool, "is_busy": bool}
MESSAGES: dict[str, dict[str, Any]] = {
    "std_msgs/Empty": {},
    "std_msgs/Bool": {"data": bool},
    "std_msgs/Float64": {"data": float},
    "std_msgs/String": {"data": str},
    "std_msgs/MultiArrayDimension": {"label": str, "size": int, "stride": int},
    "std_msgs/Float64MultiArray": {"layout": {"dim": list, "data_offset": int}, "data": FLOATS},
    "sensor_msgs/Joy": {"header": HEADER, "axes": FLOATS, "buttons": INTS},
    "sensor_msgs/JointState": {"header": HEADER, "name": WORDS, "position": FLOATS, "velocity": FLOATS, "effort": FLOATS},
    "sensor_msgs/Image": {
        "header": HEADER,
        "height": int,
        "width": int,
        "encoding": str,
        "is_bigendian": int,
        "step": int,
        "data": BYTES,
    },
    "sensor_msgs/CameraInfo": {
        **{"header": HEADER, "height": int, "width": int, "distortion_model": str},
        **{"d": FLOATS, "k": FLOATS, "r": FLOATS, "p": FLOATS},
    },
    "geometry_msgs/PoseStamped": {"header": HEADER, "pose": POSE},
    "geometry_msgs/TwistStamped": {"header": HEADER, "twist": {"linear": XYZ, "angular": XYZ}},
    "geometry_msgs/WrenchStamped": {"header": HEADER, "wrench": {"force": XYZ, "torque": XYZ}},
    "crtk_msgs/OperatingState": STATE,
    "crtk_msgs/StringStamped": {"header": HEADER, "string": str},
}
SERVICES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "crtk_msgs/QueryForwardKinematics": ({"jp": FLOATS, "cp": POSE}, {"cp": POSE, "result": bool, "message": str}),
    "crtk_msgs/QueryInverseKinematics": ({"cp": POSE, "jp": FLOATS}, {"jp": FLOATS, "result": bool, "message": str}),
    "crtk_msgs/TriggerOperatingState": ({}, {"operating_state": STATE}),
    "std_srvs/Trigger": ({}, {"success": bool, "message": str}),
}
ELEMENTS = {FLOATS: float, WORDS: str, INTS: int}


class Strict:
    """A message that takes nothing but what its definition says."""

    FIELDS: ClassVar[dict[str, Any]] = {}

    def __init__(self) -> None:
        for name, kind in self.FIELDS.items():
            object.__setattr__(self, name, _empty(kind))

    def __setattr__(self, name: str, value: Any) -> None:
        kind = self.FIELDS[name]
        if kind in ELEMENTS:
            right = isinstance(value, list) and all(type(one) is ELEMENTS[kind] for one in value)
        else:
            right = type(value) is (array if kind == BYTES else kind)
        assert right, f"{name} must be {kind}, not {value!r}"
        object.__setattr__(self, name, value)


def strict(fields: dict[str, Any]) -> type[Strict]:
    """The class of messages with these fields."""
    return type("Strict", (Strict,), {"FIELDS": fields})


def _empty(kind: Any) -> Any:
    if isinstance(kind, dict):
        return strict(kind)()
    if kind == BYTES:
        return array("B")
    return [] if kind in ELEMENTS else kind()


class Graph:
    """Nodes find each other by topic; a message comes at once, and late to who asks for it as its publisher offers it."""

    def __init__(self) -> None:
        self.publishers: list[Publisher] = []
        self.listeners: list[Listener] = []
        self.services: dict[str, Any] = {}
        self.silent = False  # True: services do not answer


class Publisher:
    def __init__(self, graph: Graph, node: str, kind: type, topic: str, quality: Any) -> None:
        self.graph, self.node, self.kind, self.topic, self.quality = graph, node, kind, topic, quality
        self.last: Any = None

    def publish(self, message: Any) -> None:
        self.last = message
        for listener in self.graph.listeners:
            if self.matches(listener):
                listener.callback(message)

    def matches(self, listener: Listener) -> bool:
        asked, offered = listener.quality, self.quality
        reliable = offered.reliability == "reliable" or asked.reliability == "best effort"
        durable = offered.durability == "transient local" or asked.durability == "volatile"
        return listener.topic == self.topic and reliable and durable

    def get_subscription_count(self) -> int:
        return sum(self.matches(listener) for listener in self.graph.listeners)


class Listener(SimpleNamespace):
    topic: str
    quality: Any
    callback: Any


class Node:
    def __init__(self, graph: Graph, name: str) -> None:
        self.graph, self.name = graph, name

    def create_publisher(self, kind: type, topic: str, quality: Any) -> Publisher:
        self.graph.publishers.append(Publisher(self.graph, self.name, kind, topic, quality))
        return self.graph.publishers[-1]

    def destroy_publisher(self, publisher: Publisher) -> None:
        self.graph.publishers.remove(publisher)

    def create_subscription(self, kind: type, topic: str, callback: Any, quality: Any) -> Listener:
        listener = Listener(kind=kind, topic=topic, callback=callback, quality=quality)
        self.graph.listeners.append(listener)
        for publisher in self.graph.publishers:
            if publisher.last is not None and publisher.matches(listener) and quality.durability == "transient local":
                callback(publisher.last)
        return listener

    def destroy_subscription(self, listener: Listener) -> None:
        self.graph.listeners.remove(listener)

    def create_service(self, kind: Any, name: str, respond: Any) -> None:
        self.graph.services[name] = lambda question: respond(question, kind.Response())

    def create_client(self, kind: Any, name: str) -> Any:
        def call_async(question: Any) -> Any:
            answer = None if self.graph.silent else self.graph.services[name](question)
            return SimpleNamespace(
                result=lambda: answer, add_done_callback=lambda done: None if self.graph.silent else done(None)
            )

        return SimpleNamespace(wait_for_service=lambda timeout_sec: name in self.graph.services, call_async=call_async)

    def destroy_client(self, client: Any) -> None:
        pass

    def destroy_node(self) -> None:
        pass

    def count_publishers(self, topic: str) -> int:
        return sum(publisher.topic == topic for publisher in self.graph.publishers)

    def get_topic_names_and_types(self) -> list[tuple[str, list[str]]]:
        topics = {one.topic: one.kind for one in (*self.graph.publishers, *self.graph.listeners)}
        return [(topic, [kind.ROS]) for topic, kind in topics.items()]

    def get_publishers_info_by_topic(self, topic: str) -> list[Any]:
        found = [publisher for publisher in self.graph.publishers if publisher.topic == topic]
        return [SimpleNamespace(node_namespace="/", node_name=publisher.node) for publisher in found]

    def get_clock(self) -> Any:
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=1_700_000_000_250_000_000))


class Context:
    def __init__(self) -> None:
        self.up = True

    def ok(self) -> bool:
        return self.up


class Executor:
    def __init__(self, context: Context) -> None:
        self.ended = threading.Event()

    def add_node(self, node: Node) -> None:
        pass

    def spin(self) -> None:
        self.ended.wait(60.0)

    def shutdown(self, timeout_sec: float) -> None:
        self.ended.set()


def install(patch: pytest.MonkeyPatch) -> Graph:
    """Make `import rclpy` and the message packages give these, until the test ends."""
    graph = Graph()
    packages: dict[str, dict[str, Any]] = {}
    for ros, fields in MESSAGES.items():
        package, name = ros.split("/")
        kind = strict(fields)
        kind.ROS = f"{package}/msg/{name}"  # type: ignore[attr-defined]
        packages.setdefault(f"{package}.msg", {})[name] = kind
    for ros, (question, answer) in SERVICES.items():
        package, name = ros.split("/")
        packages.setdefault(f"{package}.srv", {})[name] = SimpleNamespace(Request=strict(question), Response=strict(answer))
    packages |= {f"{name.split('.')[0]}": {} for name in tuple(packages)}
    packages["rclpy"] = {
        "init": lambda context: None,
        "create_node": lambda name, context: Node(graph, name),
        "shutdown": lambda context: setattr(context, "up", False),
    }
    packages["rclpy.context"] = {"Context": Context}
    packages["rclpy.executors"] = {"SingleThreadedExecutor": Executor, "ExternalShutdownException": RuntimeError}
    packages["rclpy.qos"] = {
        "QoSProfile": SimpleNamespace,
        "HistoryPolicy": SimpleNamespace(KEEP_LAST="keep last"),
        "ReliabilityPolicy": SimpleNamespace(RELIABLE="reliable", BEST_EFFORT="best effort"),
        "DurabilityPolicy": SimpleNamespace(TRANSIENT_LOCAL="transient local", VOLATILE="volatile"),
    }
    for name, content in packages.items():
        module = ModuleType(name)
        module.__dict__.update(content)
        patch.setitem(sys.modules, name, module)
    return graph
