"""A whole session through the dVRK driver on a real ROS graph: four processes, judged by the truth that the served bench tells at its end.

In slow motion (see `tests.mocks.slow_motion`), for two cores that others use, too. Run it alone: `pytest -m slow` and this file's name.
"""

import json
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

PACE = 0.25  # seconds of the session per second
SEED = 4
PICTURES = 15  # pairs per slow second
DEADMAN = 0.1 / PACE  # [s]; the deadman's own clock is not slow
WITHIN = 500.0  # [s]; 75 slow seconds, and starting
# The two runs are not alike to the last snip: Potts scissors open less, so their snips are shorter; arms hear each other later and
# less evenly; and images are older. Either cut strays from the goal by tenths of a millimetre, and what is left differs by at most one
# strand, the one that a last snip does or does not reach.
DEVIATION = 1.0e-3  # [m]
STRANDS = 1

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(bool(ros_is_missing()), reason=ros_is_missing() or "ROS 1 is there"),
]


def in_process(scene: Path, folder: Path) -> RunResult:
    choices = Choices(exposure=ExposureKind.GOAL_NORMAL)
    options = RunOptions(load_scene(str(scene)), None, "planning", 1, True, SEED, folder, False, choices)
    return run(options, *prepare(options), AutoApprover())


def over_ros(scene: Path, folder: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """What the session says of itself, and the truth."""
    site, told = folder / "site", folder / "result.json"
    slow = ("-m", "tests.mocks.slow_motion", str(PACE))
    serve = ("serve-stub", "--scene", str(scene), "--seed", str(SEED), "--folder", str(site), "--pictures", str(PICTURES))
    session = ("--seed", str(SEED), "--attempts", "1", "--expose", "goal-normal", "--view", "none")
    where = ("--config", str(site / "robot.toml"), "--goal", str(site / "goal.json"))
    with running_master(folder) as master:
        server = master.start(*slow, *serve)
        master.wait_for("the served bench", lambda: "dissect run" in master.log_of(server), 60.0)
        master.start("-m", "hardware.dvrk.deadman", "/PSM1", "/PSM2", "--budget", str(DEADMAN))
        operator = master.start(
            *slow, "run", "--bench", "dvrk", *where, *session, "--record", str(folder / "record"), "--json", str(told)
        )
        assert operator.stdin is not None
        operator.stdin.write(b"y\n" * 5)
        operator.stdin.flush()
        master.wait_for("the session's end", lambda: operator.poll() is not None, WITHIN)
        assert told.exists(), master.log_of(operator)
        server.send_signal(signal.SIGINT)
        server.wait(20.0)
        assert server.returncode == 0, master.log_of(server)
    return json.loads(told.read_text()), json.loads((site / "truth.json").read_text())


def test_a_session_over_ros_ends_as_it_does_in_process(small_scene: Path, tmp_path: Path, monkeypatch):
    monkeypatch.setitem(os.environ, "OPENCV_FOR_THREADS_NUM", "1")
    (graph := tmp_path / "graph").mkdir()
    expected = in_process(small_scene, tmp_path / "expected")

    result, truth = over_ros(small_scene, graph)

    record = read(graph / "record")
    assert record.closed and result["code"] in (Code.COMPLETE, Code.ATTEMPTS_USED), result["message"]
    assert (result["attempts"], result["success"]) == (1, None) and not record.topic(topics.TRUTH)
    assert expected.attachments is not None and abs(truth["attachments"] - expected.attachments) <= STRANDS
    assert expected.length_deviation_m is not None
    assert abs(truth["length_deviation_m"] - expected.length_deviation_m) < DEVIATION
    bench = record.outcome["bench"]
    rates = {one["topic"]: one for one in bench["topics"]}
    assert rates["/PSM1/measured_cp"]["rate"] > 80.0 and rates["/stereo/left/image_rect_color"]["rate"] > 10.0
    assert all({"delay_median", "delay_p99", "dropped", "longest_gap"} <= one.keys() for one in bench["topics"])
    assert bench["monitor"]["longest_gap"] < 0.1
