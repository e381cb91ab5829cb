"""Two ROS 1 nodes for the tests of the transport, each a process: `echo` sends back what it is sent, `client` tries everything.

`python -m tests.mocks.ros1_nodes client` prints one JSON object with what it saw.
"""

from __future__ import annotations

import json
import logging
import sys
import threading
import time
from dataclasses import fields
from typing import Any

import numpy as np

from hardware.dvrk import messages as m
from hardware.dvrk.choose_transport import make_transport
from hardware.dvrk.transport import TransportError

NUMBERS = np.arange(1.0, 13.0)

EXAMPLES: tuple[m.Message, ...] = (
    m.Empty(),
    m.Bool(True),
    m.Float64(-1.25),
    m.String("PSM1: tracking error"),
    m.Matrix(NUMBERS.reshape(6, 2)),
    m.Joy(5.25, (0, 1, 2)),
    m.JointState(1.7e9 + 0.125, ("yaw", "pitch"), NUMBERS[:2], NUMBERS[2:4], NUMBERS[4:6]),
    m.PoseStamped(1.7e9, "PSM1_base", NUMBERS[:3], np.array((0.5, -0.5, 0.5, 0.5))),
    m.TwistStamped(2.0, "PSM1_base", NUMBERS[:3], NUMBERS[3:6]),
    m.WrenchStamped(3.0, "PSM1", NUMBERS[:3], NUMBERS[3:6]),
    m.OperatingState(0.0, "ENABLED", True, False),
    m.StringStamped(4.0, "home"),
    m.Picture(1.5, "left", np.arange(4 * 5 * 3, dtype=np.uint8).reshape(4, 5, 3)),
    m.CameraInfo(1.5, "left", 5, 4, "plumb_bob", NUMBERS[:5], NUMBERS[:9].reshape(3, 3), np.eye(3), NUMBERS.reshape(3, 4)),
)


def same(one: Any, other: Any) -> bool:
    """Whether two messages have the same content."""
    return type(one) is type(other) and all(
        np.array_equal(getattr(one, field.name), getattr(other, field.name)) for field in fields(one)
    )


def topic(example: m.Message) -> str:
    """Where the client sends it; it comes back at the same name with `_back`."""
    return f"/echo/{type(example).__name__}"


def echo() -> None:
    """Send every message back, tell the pose of joints, and have a latched state, until the input closes."""
    node = make_transport("ros1", "echo")
    for example in EXAMPLES:
        back = node.publisher(topic(example) + "_back", type(example), queue=10)
        node.subscribe(topic(example), type(example), lambda message, _, back=back: back.publish(message), queue=10)
    latched = node.publisher("/echo/state", m.OperatingState, latched=True)
    latched.publish(m.OperatingState(1.0, "DISABLED", False, False))
    latched.publish(m.OperatingState(2.0, "FAULT", True, False))
    node.serve("/echo/forward_kinematics", m.FORWARD_KINEMATICS, _forward)
    node.serve("/echo/inverse_kinematics", m.INVERSE_KINEMATICS, lambda ask: m.AnswerJoints(2.0 * ask.jp, True, "found"))
    node.serve("/echo/state", m.TRIGGER_STATE, lambda _: m.AnswerState(m.OperatingState(2.0, "FAULT", True, False)))
    node.serve("/echo/version", m.TRIGGER, lambda _: m.AnswerTrigger(True, "1.1.0"))
    node.serve("/echo/slow", m.TRIGGER, lambda _: time.sleep(5.0) or m.AnswerTrigger(True, ""))
    node.subscribe("/echo/last", m.String, lambda message, _: print(message.data, flush=True))
    sys.stdin.read()
    node.close()


def _forward(ask: m.AskPose) -> m.AnswerPose:
    return m.AnswerPose(m.Pose(ask.jp[:3], np.array((0.0, 0.0, 0.0, 1.0))), True, "reached")


def client() -> None:
    """Try everything that a transport does against `echo`, and print what came of it."""
    heard: list[logging.LogRecord] = []
    own = logging.Handler()
    own.emit = heard.append  # type: ignore[method-assign]
    logging.getLogger().addHandler(own)
    node = make_transport("ros1", "client")
    seen: dict[str, Any] = {"own_log_kept": own in logging.getLogger().handlers, "kinds": dict(node.kinds())}
    seen["not_echoed"] = [type(example).__name__ for example in EXAMPLES if not _comes_back(node, example)]
    late: list[m.OperatingState] = []
    node.subscribe("/echo/state", m.OperatingState, lambda message, _: late.append(message), latched=True)
    _wait(lambda: bool(late))
    seen["latched"] = [state.state for state in late]
    seen["publishers"] = node.publishers_of("/echo/state")
    seen["forward"] = node.call(
        "/echo/forward_kinematics", m.FORWARD_KINEMATICS, m.AskPose(NUMBERS[:6]), 5.0
    ).cp.position.tolist()
    ask = m.AskJoints(m.Pose(NUMBERS[:3], NUMBERS[:4]), NUMBERS[:6])
    seen["inverse"] = node.call("/echo/inverse_kinematics", m.INVERSE_KINEMATICS, ask, 5.0).jp.tolist()
    seen["state"] = node.call("/echo/state", m.TRIGGER_STATE, m.Ask(), 5.0).operating_state.state
    seen["version"] = node.call("/echo/version", m.TRIGGER, m.Ask(), 5.0).message
    seen["nobody"] = _error(lambda: node.call("/nobody", m.TRIGGER, m.Ask(), 0.2))
    started = time.monotonic()
    seen["slow"] = _error(lambda: node.call("/echo/slow", m.TRIGGER, m.Ask(), 0.5))
    seen["slow_took"] = time.monotonic() - started
    seen["second_node"] = _error(lambda: make_transport("ros1", "second"))
    seen["wrong_kind"] = _error(lambda: node.publisher("/wrong", m.Bool).publish(m.Empty()))
    seen["stamp_off_by"] = abs(node.stamp() - time.time())
    seen["alive"] = node.alive()
    last = node.publisher("/echo/last", m.String)
    _wait(lambda: last.listeners() == 1)
    print(json.dumps(seen), flush=True)
    sys.stdin.readline()  # the test ends the master meanwhile
    _wait(lambda: not node.alive())
    seen = {"alive_without_master": node.alive(), "kinds_without_master": _error(node.kinds)}
    print(json.dumps(seen), flush=True)
    sys.stdin.readline()  # the test starts another master meanwhile
    time.sleep(0.5)
    seen = {"alive_with_another_master": node.alive()}
    last.publish(m.String("last words"))
    started = time.monotonic()
    node.close()
    seen["closed_within"] = time.monotonic() - started
    busy = time.process_time()
    time.sleep(0.5)
    seen["busy_after"] = time.process_time() - busy
    print(json.dumps(seen), flush=True)


def _comes_back(node: Any, example: m.Message) -> bool:
    came = threading.Event()
    back: list[Any] = []

    def receive(message: Any, received: float) -> None:
        back.append((message, time.monotonic() - received))
        came.set()

    listener = node.subscribe(topic(example) + "_back", type(example), receive)
    sender = node.publisher(topic(example), type(example))
    _wait(lambda: listener.sources() == 1 and sender.listeners() == 1)
    sender.publish(example)
    came.wait(5.0)
    listener.close()
    sender.close()
    return bool(back) and same(back[0][0], example) and 0.0 <= back[0][1] < 1.0


def _wait(until: Any) -> None:
    deadline = time.monotonic() + 5.0
    while not until() and time.monotonic() < deadline:
        time.sleep(0.005)


def _error(call: Any) -> str:
    try:
        call()
    except (TransportError, TypeError) as error:
        return str(error)
    return ""


if __name__ == "__main__":
    {"echo": echo, "client": client}[sys.argv[1]]()
