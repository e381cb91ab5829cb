"""`dissect serve-stub`: in real time, and on a real graph."""

import json
import signal

import pytest
from typer.testing import CliRunner

from hardware.codes import InputError
from hardware.dvrk.choose_transport import TransportError
from hardware.dvrk.config import load_robot
from skills.scene.goal import load_goal
from supervisor import serve_stub
from supervisor.cli import app
from tests.hardware.served.conftest import scene
from tests.mocks.ros_master import ros_is_missing, running_master


class Watch:
    """A clock that goes on when it is waited for, by the time that a step of the bench takes, and stops the loop in the end."""

    def __init__(self, step_takes: float, end: float) -> None:
        self.time, self.step_takes, self.end, self.bench, self.most = 0.0, step_takes, end, 0.0, 0.0

    def clock(self) -> float:
        if self.time > self.end:
            raise KeyboardInterrupt
        return self.time

    def wait(self, duration: float) -> None:
        self.time += duration

    def now(self) -> float:
        return self.bench

    def advance(self, duration: float) -> None:
        self.bench += duration
        self.time += self.step_takes
        self.most = max(self.most, self.bench - self.time)


def test_the_bench_keeps_time_with_the_clock():
    watch = Watch(0.002, 3.0)
    with pytest.raises(KeyboardInterrupt):
        serve_stub.keep_time(watch, watch.clock, watch.wait)

    assert abs(watch.bench - 3.0) < 0.02
    assert watch.most < 0.02


def test_a_slow_machine_makes_bench_time_slow_and_never_makes_it_rush():
    watch = Watch(0.02, 3.0)
    with pytest.raises(KeyboardInterrupt):
        serve_stub.keep_time(watch, watch.clock, watch.wait)
    lost = watch.time - watch.bench
    watch.step_takes, watch.end = 0.0, watch.time + 1.0
    with pytest.raises(KeyboardInterrupt):
        serve_stub.keep_time(watch, watch.clock, watch.wait)

    assert lost > 1.5
    assert abs(watch.time - watch.bench - lost) < 0.05


def test_without_ros_one_sentence_says_what_to_do(tmp_path, monkeypatch):
    def no_ros(kind, name):
        raise TransportError("ROS 1 is not installed for this Python")

    monkeypatch.setattr(serve_stub, "make_transport", no_ros)

    with pytest.raises(InputError, match="ROS 1 is not installed"):
        serve_stub.serve(serve_stub.ServeOptions(scene(), 0, tmp_path), lambda robot, goal: None)


def test_the_command_explains_itself():
    result = CliRunner().invoke(app, ["serve-stub", "--help"])

    assert result.exit_code == 0 and "ROS graph" in result.output


def test_the_stub_is_a_robot_on_a_real_graph(tmp_path):
    """Two processes and a master: states, a move, pictures, a service and an injected fault."""
    if reason := ros_is_missing():
        pytest.skip(reason)
    folder = tmp_path / "site"
    with running_master(tmp_path) as master:
        server = master.start("-m", "supervisor.cli", "serve-stub", "--folder", str(folder))
        master.wait_for("the stub's topics", lambda: "/PSM2/measured_cp" in master.topics(), 60.0)
        client = master.start("-m", "tests.mocks.served_client")
        master.wait_for("the client's end", lambda: client.poll() is not None, 90.0)
        said = master.log_of(client)
        assert client.returncode == 0, said + master.log_of(server)
        seen = json.loads(said.strip().splitlines()[-1])
        server.send_signal(signal.SIGINT)
        server.wait(60.0)
        printed = master.log_of(server)

    assert server.returncode == 0, printed
    assert seen["rate"] > 60.0 and seen["pictures"] > 0.5
    assert seen["error"] < 5e-3 and seen["reached"] is True and seen["homed"] is True
    assert seen["tool"] == "POTTS_SCISSORS:400001" and seen["focal"] == 620.0
    command = next(line for line in printed.splitlines() if line.startswith("dissect run"))
    assert command == f"dissect run --bench dvrk --config {folder / 'robot.toml'} --goal {folder / 'goal.json'}"
    assert load_goal(folder / "goal.json").image_size == (640, 480)
    assert json.loads((folder / "truth.json").read_text())["success"] is False
    assert load_robot(folder / "robot.toml").grasper.name == "PSM1"
