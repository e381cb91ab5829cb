"""The transport over a real ROS 1 graph: a master, a node that echoes, and a node that tries everything, each a process."""

import json
import subprocess
import sys
from collections.abc import Iterator
from typing import Any

import pytest

from tests.hardware.dvrk.conftest import skip_without_ros
from tests.mocks.ros_master import RosMaster, running_master


@pytest.fixture(scope="module")
def seen(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Any]]:
    """What the client saw, with the master, without it, and with another one in its place."""
    skip_without_ros()
    with running_master(tmp_path_factory.mktemp("ros")) as master:
        echo = master.start("-m", "tests.mocks.ros1_nodes", "echo")
        master.wait_for("the echo", lambda: "/echo/state" in master.topics())
        client = master.start("-m", "tests.mocks.ros1_nodes", "client")
        master.wait_for("the client's report", lambda: _reports(master, client) >= 1)
        master.process.kill()
        _go_on(client)
        master.wait_for("the client's second report", lambda: _reports(master, client) >= 2)
        master.restart()
        _go_on(client)
        master.wait_for("the client's third report", lambda: _reports(master, client) >= 3)
        reports = [json.loads(line) for line in master.log_of(client).splitlines() if line.startswith("{")]
        client.wait(10.0)
        yield {**reports[0], **reports[1], **reports[2], "status": client.returncode, "echo": master.log_of(echo)}


def _go_on(client: "subprocess.Popen[bytes]") -> None:
    assert client.stdin is not None
    client.stdin.write(b"\n")
    client.stdin.flush()


def _reports(master: RosMaster, client: "subprocess.Popen[bytes]") -> int:
    return sum(line.startswith("{") and line.endswith("}") for line in master.log_of(client).splitlines())


def test_every_kind_of_message_survives_the_way_there_and_back(seen: dict[str, Any]) -> None:
    assert seen["not_echoed"] == []


def test_one_who_connects_late_is_given_the_last_latched_message_alone(seen: dict[str, Any]) -> None:
    assert seen["latched"] == ["FAULT"]


def test_services_answer(seen: dict[str, Any]) -> None:
    assert seen["forward"] == [1.0, 2.0, 3.0]
    assert seen["inverse"] == [2.0, 4.0, 6.0, 8.0, 10.0, 12.0]
    assert (seen["state"], seen["version"]) == ("FAULT", "1.1.0")


def test_a_service_that_is_not_there_or_too_slow_is_an_error_in_time(seen: dict[str, Any]) -> None:
    assert "/nobody did not answer" in seen["nobody"]
    assert "/echo/slow did not answer within 0.5 s" in seen["slow"]
    assert seen["slow_took"] < 2.0


def test_the_graph_tells_types_and_publishers(seen: dict[str, Any]) -> None:
    assert seen["kinds"]["/echo/state"] == "crtk_msgs/OperatingState"
    assert len(seen["publishers"]) == 1 and seen["publishers"][0].startswith("echo")


def test_a_process_is_one_node(seen: dict[str, Any]) -> None:
    assert "can be only one" in seen["second_node"]


def test_a_topic_carries_its_own_kind_alone(seen: dict[str, Any]) -> None:
    assert seen["wrong_kind"] == "/wrong carries Bool, not Empty"


def test_the_log_of_the_program_is_left_as_it_was(seen: dict[str, Any]) -> None:
    assert seen["own_log_kept"]


def test_stamps_are_ros_time(seen: dict[str, Any]) -> None:
    assert seen["stamp_off_by"] < 0.1


def test_a_master_that_is_gone_is_noticed_while_messages_still_flow(seen: dict[str, Any]) -> None:
    assert seen["alive"] and not seen["alive_without_master"]
    assert "no ROS master answers" in seen["kinds_without_master"]


def test_a_master_that_was_started_anew_does_not_know_us(seen: dict[str, Any]) -> None:
    assert not seen["alive_with_another_master"]


def test_leaving_works_without_a_master_that_knows_us(seen: dict[str, Any]) -> None:
    assert seen["closed_within"] < 3.0
    assert seen["status"] == 0


def test_a_node_that_left_does_nothing_any_more(seen: dict[str, Any]) -> None:
    assert seen["busy_after"] < 0.05  # of 0.5 s; rospy itself leaves a loop running


def test_what_was_sent_just_before_leaving_arrives(seen: dict[str, Any]) -> None:
    assert "last words" in seen["echo"]


def test_no_master_is_one_sentence_at_once() -> None:
    skip_without_ros()
    code = "from hardware.dvrk.choose_transport import make_transport; make_transport('ros1', 'alone')"

    run = subprocess.run(
        [sys.executable, "-c", code], env={"ROS_MASTER_URI": "http://127.0.0.1:9"}, capture_output=True, text=True, timeout=30.0
    )

    assert "TransportError: no ROS master answers at http://127.0.0.1:9" in run.stderr
    assert "start roscore, or set ROS_MASTER_URI" in run.stderr
