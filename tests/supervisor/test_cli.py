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
from skills.estimate.rule import Rule
from supervisor import cli, topics
from supervisor.choices import Choices
from supervisor.cli import Expose, main
from supervisor.experiments import detection
from supervisor.reading import read
from supervisor.replay import timeline
from supervisor.skillset import ExposureKind
from tests.supervisor.experiments.detection_runs import run as made_up_run

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
        (["run", "--rule", "guess"], "likelihood"),
        (["run", "--cover", "clever"], "greedy"),
        (["run", "--tracker", "diss"], "there is no tracker 'diss'"),
        (["run", "--tracker", "nowhere.onnx"], "nowhere.onnx"),
        (["run", "--tracker", "raft"], "raft"),
        (["run", "--tracker", "lk", "--tracker-weights", "raft.pth"], "the tracker lk takes no weights"),
        (["experiment", "detection", "--tracker", "diss"], "did you mean dis?"),
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


def test_the_command_line_knows_every_kind_of_exposure_and_rule():
    assert [kind.value for kind in Expose] == [kind.value for kind in ExposureKind]
    assert [rule.value for rule in cli.Rule] == [rule.value for rule in Rule]


def test_what_is_chosen_of_the_skills_reaches_the_session(monkeypatch, capsys, tmp_path):
    """The run itself is left out: what it would be given is looked at."""
    given = []

    def stopped(options, *rest):
        given.append(options)
        raise InputError("stopped by the test")

    monkeypatch.setattr("supervisor.run.run", stopped)
    where = ["--record", str(tmp_path / "r"), "--view", "none"]

    how = ["--expose", "goal-normal", "--device", "cpu", "--rule", "elongation", "--cover", "greedy", "--tracker", "lk"]
    call(monkeypatch, capsys, "run", *how, *where)
    call(monkeypatch, capsys, "run", *where)

    chosen = [options.choices for options in given]
    assert chosen == [Choices(ExposureKind.GOAL_NORMAL, Rule.ELONGATION, "greedy", "lk", None, "cpu"), Choices()]


def test_a_learned_trackers_weights_reach_the_session(monkeypatch, capsys, tmp_path):
    """Nothing is prepared: its package and its file need not be here."""
    given = []

    def stopped(options):
        given.append(options.choices)
        raise InputError("stopped by the test")

    monkeypatch.setattr("supervisor.run.prepare", stopped)
    where, weights = ["--record", str(tmp_path / "r"), "--view", "none"], tmp_path / "raft.pth"

    call(monkeypatch, capsys, "run", "--tracker", "raft", "--tracker-weights", str(weights), *where)
    call(monkeypatch, capsys, "run", "--tracker", str(tmp_path / "follow.onnx"), *where)

    assert given == [Choices(tracker="raft", tracker_weights=weights), Choices(tracker=str(tmp_path / "follow.onnx"))]
    assert not (tmp_path / "r").exists()


def test_the_command_line_knows_every_cover():
    for cover in cli.Cover:
        assert Choices(cover=cover.value, device="cpu").skills().replan.cover == cover.value


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


# The detection experiment


@pytest.fixture
def made_up(monkeypatch) -> list[detection.Job]:
    """Its runs are made up instead of run; the jobs that were asked for are listed."""
    asked: list[detection.Job] = []

    def results(work, jobs, workers):
        for job in jobs:
            asked.append(job)
            yield made_up_run(job.seed, variant=job.variant)

    monkeypatch.setattr(detection.pool, "results", results)
    return asked


def detect(monkeypatch, capsys, *arguments: str) -> tuple[int, str]:
    """Exit status of the experiment, and all that was printed."""
    return call(monkeypatch, capsys, "experiment", "detection", *arguments)


def test_the_detection_experiment_runs_what_it_is_told_and_writes_figures_and_edges(monkeypatch, capsys, tmp_path, made_up):
    out = tmp_path / "d.json"

    how = ["--cases", "2", "--seed", "107", "--tracker", "lk", "--compare", "--json", str(out)]
    status, said = detect(monkeypatch, capsys, *how)

    assert status == 0
    assert {(job.seed, job.variant) for job in made_up} == {
        (seed, name) for seed in (107, 108) for name in ("lk", "dis-chained", "elongation")
    }
    assert json.loads(out.read_text())["variants"].keys() == {"lk", "dis-chained", "elongation"}
    assert len(out.with_suffix(".edges.jsonl").read_text().splitlines()) == 6
    assert out.with_suffix(".trials.jsonl").exists()
    assert "judged rightly" in said


def test_the_detection_experiment_goes_on_after_the_runs_that_ended(monkeypatch, capsys, tmp_path, made_up):
    how = ["--seed", "107", "--json", str(tmp_path / "d.json")]
    detect(monkeypatch, capsys, "--cases", "2", *how)
    made_up.clear()

    status, _ = detect(monkeypatch, capsys, "--cases", "3", *how)

    assert (status, [job.seed for job in made_up]) == (0, [109])


def test_without_a_file_for_its_figures_the_detection_experiment_leaves_nothing_but_its_journal(
    monkeypatch, capsys, tmp_path, made_up
):
    monkeypatch.chdir(tmp_path)

    status, _ = detect(monkeypatch, capsys, "--cases", "1")

    assert status == 0
    assert [path.name for path in tmp_path.iterdir()] == ["detection.trials.jsonl"]


def test_an_interrupted_detection_experiment_says_how_to_go_on(monkeypatch, capsys, tmp_path):
    def interrupted(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(detection, "run_experiment", interrupted)

    status, said = detect(monkeypatch, capsys, "--json", str(tmp_path / "d.json"))

    assert status == 3
    assert "the same command goes on" in said


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--cases", "0"], "cases"),
        (["--json", "nowhere/d.json"], "cannot be written"),
        (["--tracker", "no.onnx"], "cannot be read"),
    ],
)
def test_bad_input_to_the_detection_experiment_gets_one_sentence_and_nothing_is_pulled(
    monkeypatch, capsys, tmp_path, made_up, arguments, sentence
):
    monkeypatch.chdir(tmp_path)

    status, said = detect(monkeypatch, capsys, *arguments)

    assert status == 2
    assert sentence in said
    assert made_up == []


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
