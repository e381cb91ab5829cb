"""The transport over rclpy, against a strict stand-in: ROS 2 itself is not in Debian."""

import importlib
import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from hardware.dvrk import messages as m
from hardware.dvrk.transport import Transport, TransportError
from tests.mocks import ros2_graph
from tests.mocks.ros1_nodes import EXAMPLES, same


@pytest.fixture
def graph(monkeypatch: pytest.MonkeyPatch) -> ros2_graph.Graph:
    graph = ros2_graph.install(monkeypatch)
    monkeypatch.delitem(sys.modules, "hardware.dvrk.ros2", raising=False)
    return graph


@pytest.fixture
def node(graph: ros2_graph.Graph) -> Iterator[Callable[[str], Transport]]:
    """Nodes by name, closed with the test."""
    ros2 = importlib.import_module("hardware.dvrk.ros2")
    made: list[Transport] = []

    def make(name: str) -> Transport:
        made.append(ros2.TransportROS2(name, lambda: 12.5))
        return made[-1]

    yield make
    for one in made:
        one.close()
    sys.modules.pop("hardware.dvrk.ros2", None)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: type(example).__name__)
def test_every_kind_of_message_arrives_with_the_time_of_receipt(node: Callable[[str], Transport], example: m.Message) -> None:
    came: list[tuple[m.Message, float]] = []
    node("listener").subscribe("/topic", type(example), lambda message, received: came.append((message, received)))

    node("sender").publisher("/topic", type(example)).publish(example)

    assert len(came) == 1 and same(came[0][0], example) and came[0][1] == 12.5


def test_one_who_connects_late_is_given_the_last_latched_message(node: Callable[[str], Transport]) -> None:
    latched = node("robot").publisher("/PSM1/operating_state", m.OperatingState, latched=True)
    latched.publish(m.OperatingState(1.0, "DISABLED", False, False))
    latched.publish(m.OperatingState(2.0, "FAULT", True, False))
    came: list[str] = []

    node("late").subscribe("/PSM1/operating_state", m.OperatingState, lambda message, _: came.append(message.state), latched=True)

    assert came == ["FAULT"]


def test_a_camera_that_sends_as_best_it_can_is_heard(graph: ros2_graph.Graph, node: Callable[[str], Transport]) -> None:
    node("driver").subscribe("/rig/left/image_raw", m.Picture, lambda *_: None)
    node("driver").subscribe("/PSM1/measured_js", m.JointState, lambda *_: None)

    picture, joints = graph.listeners

    assert (picture.quality.reliability, joints.quality.reliability) == ("best effort", "reliable")


def test_services_answer(node: Callable[[str], Transport]) -> None:
    unit = np.array((0.0, 0.0, 0.0, 1.0))
    node("robot").serve("/fk", m.FORWARD_KINEMATICS, lambda ask: m.AnswerPose(m.Pose(ask.jp[:3], unit), True, "reached"))

    answer = node("driver").call("/fk", m.FORWARD_KINEMATICS, m.AskPose(np.arange(6.0)), 1.0)

    assert answer.result and answer.message == "reached"
    assert answer.cp.position.tolist() == [0.0, 1.0, 2.0]


def test_a_service_that_is_not_there_or_silent_is_an_error(graph: ros2_graph.Graph, node: Callable[[str], Transport]) -> None:
    driver = node("driver")
    node("robot").serve("/silent", m.TRIGGER, lambda _: m.AnswerTrigger(True, ""))
    graph.silent = True

    with pytest.raises(TransportError, match="nobody answers /nobody"):
        driver.call("/nobody", m.TRIGGER, m.Ask(), 0.05)
    with pytest.raises(TransportError, match="/silent did not answer within"):
        driver.call("/silent", m.TRIGGER, m.Ask(), 0.05)


def test_types_are_told_as_in_ros_1_and_only_of_what_is_published(node: Callable[[str], Transport]) -> None:
    driver = node("driver")
    driver.publisher("/PSM1/hold", m.Empty)
    driver.subscribe("/nobody/sends", m.Bool, lambda *_: None)

    assert driver.kinds() == {"/PSM1/hold": "std_msgs/Empty"}
    assert driver.publishers_of("/PSM1/hold") == ("driver",)


def test_connections_are_counted_and_end(node: Callable[[str], Transport]) -> None:
    driver = node("driver")
    sender = driver.publisher("/PSM1/hold", m.Empty)
    listener = driver.subscribe("/PSM1/hold", m.Empty, lambda *_: None)
    before = (sender.listeners(), listener.sources())

    listener.close()
    sender.close()

    assert before == (1, 1)
    assert (sender.listeners(), listener.sources()) == (0, 0)
    with pytest.raises(TransportError, match="/PSM1/hold is closed"):
        sender.publish(m.Empty())


def test_a_node_lives_until_it_is_closed(node: Callable[[str], Transport]) -> None:
    driver = node("driver")
    before = driver.alive()

    driver.close()

    assert before and not driver.alive()


def test_stamps_are_ros_time(node: Callable[[str], Transport]) -> None:
    assert node("driver").stamp() == pytest.approx(1.7e9 + 0.25)


def test_a_picture_that_cannot_be_read_is_dropped_and_said_once(
    graph: ros2_graph.Graph, node: Callable[[str], Transport], caplog: pytest.LogCaptureFixture
) -> None:
    came: list[Any] = []
    node("driver").subscribe("/rig/left/image_raw", m.Picture, lambda message, _: came.append(message))
    strange = ros2_graph.strict(ros2_graph.MESSAGES["sensor_msgs/Image"])()
    strange.encoding = "bayer_rggb8"

    for _ in range(3):
        graph.listeners[0].callback(strange)

    assert came == []
    assert [record.message for record in caplog.records if "bayer_rggb8" in record.message] == [caplog.records[0].message]


def test_a_workspace_without_crtk_is_one_sentence(node: Callable[[str], Transport], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "crtk_msgs.msg", None)

    with pytest.raises(TransportError, match=r"no crtk_msgs/StringStamped of ROS 2; source the setup\.bash"):
        node("driver").publisher("/PSM1/state_command", m.StringStamped)
