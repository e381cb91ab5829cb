"""The command line as a user meets it: one clear sentence for bad input, no motion, and records that survive a kill."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hardware.codes import InputError
from hardware.stub.bench import StubBench
from supervisor import topics
from supervisor.cli import Expose, main
from supervisor.reading import read
from supervisor.replay import timeline
from supervisor.skillset import ExposureKind

GOAL = {"image_size": [640, 480], "polyline": [[250, 240], [390, 240]], "grasp": [320, 190]}


def call(monkeypatch, capsys, *arguments: str) -> tuple[int, str]:
    """Exit status and all that was printed, on one line."""
    monkeypatch.setattr(sys, "argv", ["dissect", *arguments])
    with pytest.raises(SystemExit) as end:
        main()
    out, err = capsys.readouterr()
    return int(end.value.code or 0), " ".join((out + err).split())


@pytest.fixture
def motionless(monkeypatch):
    """Fails the test if bench time passes."""

    def moved(self, duration):
        raise AssertionError("the bench was set in motion")

    monkeypatch.setattr(StubBench, "advance", moved)


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"polyline": [[250, 240]]}, "at least two points [u, v] are needed"),
        ({"polyline": [[250, 240], [700, 240]]}, "outside the image"),
        ({"polyline": [[250, 10], [390, 10]], "grasp": [320, 60]}, "tissue"),
        ({"polyline": [[250, 240], [float("nan"), 240]]}, "finite"),
        ({"polyline": [[200, 240], [300, 240], [360, 200], [330, 150], [270, 170], [262, 300]]}, "crosses itself"),
        ({"polyline": [[250, 240], [320, 240], [320, 300]]}, "degrees"),
        ({"image_size": [1280, 720]}, "1280 x 720"),
        ({"polylin": [[1, 2]]}, "polyline"),
    ],
)
def test_a_bad_goal_gets_one_sentence_and_nothing_moves(monkeypatch, capsys, tmp_path, motionless, change, sentence):
    goal = tmp_path / "goal.json"
    goal.write_text(json.dumps({**GOAL, **change}))

    status, said = call(monkeypatch, capsys, "run", "--goal", str(goal), "--record", str(tmp_path / "r"), "--view", "none")

    assert status == 2
    assert sentence in said
    assert said.count("dissect:") == 1
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["run", "--scene", "silicon"], "did you mean silicone"),
        (["run", "--goal", "nowhere.json"], "cannot be read"),
        (["run", "--agent", "magic"], "planning"),
        (["run", "--attempts", "0"], "attempts"),
        (["run", "--expose", "sideways"], "goal-normal"),
        (["run", "--device", "cuda:77"], "there is no device 'cuda:77' here; there is cpu"),
        (["experiment", "autonomy", "--expose", "sideways"], "goal-normal"),
        (["replay", "nowhere"], "nowhere"),
        (["watch", "nowhere"], "No session is running".lower()),
        (["experiment", "autonomy", "--scene", "nothing"], "no scene named"),
    ],
)
def test_other_bad_input_gets_one_sentence_and_status_2(monkeypatch, capsys, motionless, arguments, sentence):
    status, said = call(monkeypatch, capsys, *arguments)

    assert status == 2
    assert sentence in said.lower() or sentence in said


def test_the_command_line_knows_every_kind_of_exposure():
    assert [kind.value for kind in Expose] == [kind.value for kind in ExposureKind]


def test_the_choice_of_exposure_and_device_reaches_the_session(monkeypatch, capsys, tmp_path):
    """The run itself is left out: what it would be given is looked at."""
    given = []

    def stopped(options, *rest):
        given.append(options)
        raise InputError("stopped by the test")

    monkeypatch.setattr("supervisor.run.run", stopped)
    where = ["--record", str(tmp_path / "r"), "--view", "none"]

    call(monkeypatch, capsys, "run", "--expose", "goal-normal", "--device", "cpu", *where)
    call(monkeypatch, capsys, "run", *where)

    chosen = [(options.exposure, options.device) for options in given]
    assert chosen == [(ExposureKind.GOAL_NORMAL, "cpu"), (ExposureKind.OPTIMAL, "auto")]


def test_the_experiment_is_told_how_to_expose(monkeypatch, capsys, tmp_path):
    given = []

    def stopped(settings, *rest):
        given.append(settings)
        raise InputError("stopped by the test")

    monkeypatch.setattr("supervisor.experiments.autonomy.run_experiment", stopped)
    monkeypatch.chdir(tmp_path)

    call(monkeypatch, capsys, "experiment", "autonomy", "--expose", "naive")
    call(monkeypatch, capsys, "experiment", "autonomy")

    assert [settings.expose for settings in given] == ["naive", "optimal"]


def test_doctor_says_that_this_machine_can_run_the_stub(monkeypatch, capsys, tmp_path):
    status, said = call(monkeypatch, capsys, "doctor", "--json", str(tmp_path / "d.json"))

    assert status == 0
    assert "warp-lang" in said
    assert any(check["name"] == "Python" for check in json.loads((tmp_path / "d.json").read_text()))


def test_a_session_killed_in_the_middle_of_cutting_leaves_a_readable_record(small_scene, tmp_path):
    folder = tmp_path / "record"
    command = [sys.executable, "-m", "supervisor.cli", "run", "--scene", str(small_scene), "--seed", "4", "--record", str(folder)]
    child = subprocess.Popen(
        [*command, "--view", "none"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=Path(__file__).parents[2]
    )
    try:
        for _ in range(1200):
            time.sleep(0.05)
            status = folder / "status.json"
            if status.exists() and "snip 2" in status.read_text():
                break
        else:
            raise AssertionError("the session never came to its second snip")
        os.kill(child.pid, signal.SIGKILL)
    finally:
        child.kill()
        child.wait()

    record = read(folder)
    text = "\n".join(str(line) for line in timeline(record))
    assert not record.closed
    assert "not closed" in text.lower()
    assert "dissect" in text
    assert any(entry.payload["command"] == "move_jaw" and entry.payload["accepted"] for entry in record.topic(topics.DECISIONS))
