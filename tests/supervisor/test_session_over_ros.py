"""A whole session through the dVRK driver on a real ROS graph: four processes, judged by the truth that the served bench tells at its end.

The time of the graph waits for whoever is late (`tests.mocks.slow_motion`), so that few and busy cores make the test long, and not wrong.
"""

import json
import math
import os
import signal
from pathlib import Path
from typing import Any

import pytest

from hardware.codes import Code
from hardware.stub.scene import load_scene
from supervisor import topics
from supervisor.approvers import AutoApprover
from supervisor.choices import Choices
from supervisor.reading import read
from supervisor.run import RunOptions, RunResult, prepare, run
from supervisor.skillset import ExposureKind
from tests.mocks.ros_master import ros_is_missing, running_master

SEED = 3
# Small, and without what makes a session fail now and then: arms that are off, tissue that is tougher here and there.
SCENE = """
[tissue]
width = 0.056
height = 0.050
fine_spacing = 1.0e-3
coarse_spacing = 3.0e-3
puncture_variation = 0.0

[camera]
noise = 1.0

[arms]
bias = 0.0
backlash = 0.0

[goal]
line = [[-0.005, 0.0], [0.005, 0.0]]
grasp = [0.0, 0.008]
"""
# As fast as the configuration of a robot may be, as nobody stands beside this one.
SPEEDS = "\n[speeds]\nratio = 0.3\nlinear = 0.05\nangular = 1.5\n"
CUTTER = "CURVED_SCISSORS:400178"  # they open as wide as those of the stub; Potts scissors would take twice as many snips
PICTURES = 10  # pairs per second
WITHIN = 500.0  # [s]
ANSWERS = b"y\n" * 2  # to power and home the arms, and to the goal
# The two runs are not alike to the last snip: arms hear each other later and less evenly, and images come less often. Either cut
# strays from the goal by a millimetre or two.
DEVIATION = 2.0e-3  # [m]

pytestmark = pytest.mark.skipif(bool(ros_is_missing()), reason=ros_is_missing() or "ROS 1 is there")


def in_process(scene: Path, folder: Path) -> RunResult:
    choices = Choices(exposure=ExposureKind.GOAL_NORMAL)
    options = RunOptions(load_scene(str(scene)), None, "planning", 1, True, SEED, folder, False, choices)
    return run(options, *prepare(options), AutoApprover())


def over_ros(scene: Path, folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """What the session says of itself, and the truth."""
    # It needs ROS when it is imported.
    from tests.mocks.slow_motion import SharedTime

    site, told, clock = folder / "site", folder / "result.json", folder / "clock"
    SharedTime.create(clock)
    start = ("-m", "tests.mocks.slow_motion", str(clock))
    shown = ("--scene", str(scene), "--seed", str(SEED), "--pictures", str(PICTURES), "--cutter", CUTTER)
    where = ("--config", str(site / "robot.toml"), "--goal", str(site / "goal.json"))
    session = ("--seed", str(SEED), "--attempts", "1", "--expose", "goal-normal", "--view", "none")
    with running_master(folder) as master:
        server = master.start(*start, "serve-stub", *shown, "--folder", str(site))
        master.wait_for("the served bench", lambda: "dissect run" in master.log_of(server), 100.0)
        with (site / "robot.toml").open("a") as configuration:
            configuration.write(SPEEDS)
        deadman = master.start(*start, "deadman", "--config", str(site / "robot.toml"))
        operator = master.start(
            *start, "run", "--bench", "dvrk", *where, *session, "--record", str(folder / "record"), "--json", str(told)
        )
        assert operator.stdin is not None
        operator.stdin.write(ANSWERS)
        operator.stdin.flush()
        master.wait_for("the session's end", lambda: operator.poll() is not None, WITHIN)
        assert told.exists(), master.log_of(operator)
        assert [line.split()[-1] for line in master.log_of(deadman).splitlines()] == ["watching", "idle"]
        server.send_signal(signal.SIGINT)
        server.wait(30.0)
        assert server.returncode == 0, master.log_of(server)
    return json.loads(told.read_text()), json.loads((site / "truth.json").read_text())


def test_a_session_over_ros_ends_as_it_does_in_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(os.environ, "OPENCV_FOR_THREADS_NUM", "1")
    (scene := tmp_path / "scene.toml").write_text(SCENE)
    (graph := tmp_path / "graph").mkdir()
    expected = in_process(scene, tmp_path / "expected")
    assert (expected.code, expected.success) == (Code.COMPLETE, True), expected.message

    result, truth = over_ros(scene, graph)

    assert (result["code"], result["attempts"]) == (Code.COMPLETE, expected.attempts), result["message"]
    assert truth["success"] and truth["attachments"] == expected.attachments
    assert expected.length_deviation_m is not None
    assert abs(truth["length_deviation_m"] - expected.length_deviation_m) < DEVIATION
    record = read(graph / "record")
    assert record.closed and not record.topic(topics.TRUTH)
    for told in (result["bench"], record.outcome["bench"], record.topic(topics.BENCH)[-1].payload):
        check_figures(told)


def check_figures(bench: dict[str, Any]) -> None:
    """Rates, delays and losses of all that the session rests on are told, and good."""
    told = {one["topic"]: one for one in bench["topics"]}
    assert {topic.split("/")[1] for topic in told} == {"PSM1", "PSM2", "stereo"} and len(told) == 16
    for topic, one in told.items():
        wanted = 0.8 * PICTURES if topic.startswith("/stereo") else 80.0
        assert one["rate"] > wanted and one["received"] > 100, (topic, one)
        assert 0.0 <= one["delay_median"] <= one["delay_p99"] < 0.1 and math.isfinite(one["longest_gap"]), (topic, one)
        assert one["dropped"] < 0.1 * one["received"] and one["invalid"] >= 0, (topic, one)
    assert bench["monitor"]["rate"] > 50.0 and bench["monitor"]["longest_gap"] < 0.1
    assert bench["unpaired_images"] >= 0 and bench["late_ticks"] >= 0
