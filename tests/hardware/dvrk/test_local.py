"""The graph within one process keeps the rules of a real one, so that tests of the driver on it mean something."""

import pytest

from hardware.dvrk.local import LocalGraph
from hardware.dvrk.messages import TRIGGER, AnswerTrigger, Ask, Bool, Empty, OperatingState, StringStamped
from hardware.dvrk.transport import TransportError


@pytest.fixture
def graph() -> LocalGraph:
    return LocalGraph(lambda: 2.5)


def test_a_message_comes_with_the_time_of_receipt(graph: LocalGraph) -> None:
    came: list[tuple[bool, float]] = []
    graph.node("driver").subscribe("/PSM1/goal_reached", Bool, lambda message, received: came.append((message.data, received)))

    graph.node("robot").publisher("/PSM1/goal_reached", Bool).publish(Bool(True))

    assert came == [(True, 2.5)]


def test_a_message_that_nobody_listens_to_is_lost(graph: LocalGraph) -> None:
    came: list[Empty] = []
    graph.node("driver").publisher("/PSM1/hold", Empty).publish(Empty())

    graph.node("robot").subscribe("/PSM1/hold", Empty, lambda message, _: came.append(message))

    assert came == []


def test_one_who_connects_late_is_given_the_last_latched_message_alone(graph: LocalGraph) -> None:
    latched = graph.node("robot").publisher("/PSM1/operating_state", OperatingState, latched=True)
    latched.publish(OperatingState(1.0, "DISABLED", False, False))
    latched.publish(OperatingState(2.0, "FAULT", True, False))
    came: list[str] = []

    graph.node("driver").subscribe("/PSM1/operating_state", OperatingState, lambda message, _: came.append(message.state))

    assert came == ["FAULT"]


def test_one_of_another_kind_hears_nothing_and_is_not_counted(graph: LocalGraph) -> None:
    came: list[Bool] = []
    listener = graph.node("driver").subscribe("/topic", Bool, lambda message, _: came.append(message))
    sender = graph.node("robot").publisher("/topic", StringStamped)

    sender.publish(StringStamped(1.0, "home"))

    assert came == []
    assert (listener.sources(), sender.listeners()) == (0, 0)


def test_without_the_master_nothing_is_delivered(graph: LocalGraph) -> None:
    came: list[Empty] = []
    node = graph.node("robot")
    node.subscribe("/PSM1/hold", Empty, lambda message, _: came.append(message))
    hold = graph.node("driver").publisher("/PSM1/hold", Empty)
    graph.up = False

    hold.publish(Empty())

    assert came == []
    assert not node.alive()


def test_services_answer_or_are_an_error(graph: LocalGraph) -> None:
    graph.node("robot").serve("/PSM1/crtk_version", TRIGGER, lambda _: AnswerTrigger(True, "1.1.0"))
    driver = graph.node("driver")

    assert driver.call("/PSM1/crtk_version", TRIGGER, Ask(), 1.0).message == "1.1.0"
    with pytest.raises(TransportError, match="nobody answers /PSM2/crtk_version"):
        driver.call("/PSM2/crtk_version", TRIGGER, Ask(), 1.0)


def test_publishers_are_told_by_name_and_forgotten_when_they_leave(graph: LocalGraph) -> None:
    robot, stranger = graph.node("robot"), graph.node("stranger")
    robot.publisher("/PSM1/servo_cp", Bool)
    stranger.publisher("/PSM1/servo_cp", Bool)
    both = robot.publishers_of("/PSM1/servo_cp")

    stranger.close()

    assert both == ("robot", "stranger")
    assert robot.publishers_of("/PSM1/servo_cp") == ("robot",)
    assert robot.kinds() == {"/PSM1/servo_cp": "std_msgs/Bool"}


def test_nodes_may_have_clocks_that_differ(graph: LocalGraph) -> None:
    assert graph.node("robot", stamps_ahead=5.0).stamp() - graph.node("driver").stamp() == 5.0
