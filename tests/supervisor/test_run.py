"""Whole sessions on the real stub: recorded, judged, repeatable, and stopped by faults."""

import json
from dataclasses import fields
from pathlib import Path

import pytest

from hardware.codes import Code, InputError
from hardware.interface import CUTTER, GRASPER
from hardware.stub.bench import StubBench
from hardware.stub.scene import load_scene
from skills.estimate.rule import Rule
from skills.expose.xpbd import choose_device
from skills.tracking.choose import TrackerChoice
from supervisor import topics
from supervisor.approvers import AutoApprover
from supervisor.choices import Choices
from supervisor.history import exposures
from supervisor.reading import read
from supervisor.record import Recorder
from supervisor.replay import timeline
from supervisor.run import RunOptions, RunResult, exit_status, header, prepare, run
from supervisor.session import Session, SessionSetup
from supervisor.skillset import ExposureKind, SkillConfig
from supervisor.stub_goal import drawn_goal


def options(scene: Path, folder: Path, **changes) -> RunOptions:
    values = {
        "scene": load_scene(str(scene)),
        "goal_file": None,
        "agent": "planning",
        "attempts": 2,
        "feedback": True,
        "seed": 4,
        "record": folder,
        "in_real_time": False,
    }
    return RunOptions(**{**values, **changes})


def commands(folder: Path) -> list[dict]:
    return [entry.payload for entry in read(folder).topic(topics.DECISIONS)]


@pytest.fixture(scope="module")
def ran(tmp_path_factory) -> tuple[RunResult, Path]:
    from tests.supervisor.conftest import SMALL

    folder = tmp_path_factory.mktemp("session")
    scene = folder / "small.toml"
    scene.write_text(SMALL)
    chosen = options(scene, folder / "record")
    return run(chosen, *prepare(chosen), AutoApprover()), folder


def test_a_session_ends_with_a_truthful_result(ran):
    result, folder = ran

    assert {f.name for f in fields(result)} >= {
        "outcome",
        "code",
        "message",
        "attempts",
        "attachments",
        "length_deviation_m",
        "success",
    }
    assert result.code in (Code.COMPLETE, Code.ATTEMPTS_USED)
    assert 1 <= result.attempts <= 2
    assert (folder / "record" / "report.html").stat().st_size > 50_000


def test_the_record_holds_the_whole_session(ran):
    result, folder = ran
    record = read(folder / "record")

    assert record.closed
    assert record.outcome["code"] == result.code
    assert len(record.topic(topics.TRUTH)) == result.attempts
    text = "\n".join(str(line) for line in timeline(record))
    for word in ("checklist", "approve", "dissect", "expose", "estimate", "retreat"):
        assert word in text


def test_the_exposure_is_planned_unless_told_otherwise_and_the_choice_is_on_record(ran):
    result, folder = ran
    header = read(folder / "record").header

    assert (result.exposure, result.device) == ("optimal", choose_device("auto"))
    assert (header["exposure"], header["device"]) == (result.exposure, result.device)
    skills = header["configuration"]["skills"]
    assert (skills["exposure"], skills["optimal"]["device"]) == (result.exposure, result.device)


def test_each_planned_step_is_on_record_once_with_what_came_of_the_pull(ran):
    _, folder = ran
    record = read(folder / "record")
    pulls = [entry.payload for entry in record.topic(topics.EXPOSED)]
    planned: dict[int, list[int]] = {}
    for entry in record.topic(topics.EXPOSURE):
        planned.setdefault(entry.payload["exposure"], []).append(entry.payload["number"])

    assert pulls and len(record.topic(topics.EXPOSURE_MESH)) == len(planned)
    assert all(numbers == list(range(1, len(numbers) + 1)) for numbers in planned.values())
    for exposure, pull in zip(exposures(record), pulls, strict=True):
        assert exposure.steps == len(pull["path"]) == len(pull["forecast"]["separation"]) == len(exposure.series["opening"])
        assert exposure.message == pull["message"] and exposure.area is not None


def test_a_straight_pull_judged_by_the_papers_rule_is_on_record_with_what_was_expected_and_no_plan(small_scene, tmp_path):
    choices = Choices(ExposureKind.NAIVE, Rule.ELONGATION, "greedy", "lk")
    chosen = options(small_scene, tmp_path / "record", attempts=1, choices=choices)

    result = run(chosen, *prepare(chosen), AutoApprover())

    record = read(tmp_path / "record")
    assert result.exposure == record.header["exposure"] == "naive"
    assert [record.header[key] for key in ("rule", "cover", "tracker")] == ["elongation", "greedy", "lk"]
    assert not record.topic(topics.EXPOSURE)
    # Where the first look leaves too much unknown there is a second one.
    pulls = [entry.payload for entry in record.topic(topics.EXPOSED)]
    assert 1 <= len(pulls) <= 2
    assert all("planned" not in pull and len(pull["tension"]) == pull["steps"] > 0 for pull in pulls)
    assert len(pulls[0]["forecast"]["separation"]) == pulls[0]["steps"]


def test_the_record_of_a_session_names_no_folder_of_this_machine(ran):
    _, folder = ran
    record = read(folder / "record")

    written = [path.read_text() for path in (folder / "record").iterdir() if path.suffix in (".json", ".html")]
    noted = [entry.payload for entries in record.messages.values() for entry in entries]
    told = json.dumps([record.header, record.outcome, noted], default=str)

    assert len(written) >= 3
    for text in (*written, told):
        assert str(folder) not in text
        assert str(Path.home()) + "/" not in text


def test_the_tracker_rule_and_cover_of_an_ordinary_session_are_on_record(ran):
    _, folder = ran
    told = read(folder / "record").header

    assert [told[key] for key in ("rule", "cover", "tracker")] == ["likelihood", "optimal", "dis"]
    skills = told["configuration"]["skills"]
    assert (skills["rule"], skills["replan"]["cover"]) == ("likelihood", "optimal")
    assert (skills["choice"]["kind"], skills["choice"]["weights"]) == ("dis", None)
    assert skills["likelihood"]["weights"]["bed"] > 0


def test_choices_become_settings_of_the_skills():
    weights = Path("nets") / "raft.pth"

    skills = Choices(ExposureKind.GOAL_NORMAL, Rule.ELONGATION, "greedy", "raft", weights, "cpu").skills(threads=3)

    assert (skills.exposure, skills.rule, skills.replan.cover) == (ExposureKind.GOAL_NORMAL, Rule.ELONGATION, "greedy")
    assert skills.choice == TrackerChoice("raft", str(weights), "cpu")
    assert (skills.optimal.device, skills.optimal.threads) == ("cpu", 3)


def test_nothing_chosen_are_the_defaults_of_the_skills():
    skills, defaults = Choices(device="cpu").skills(), SkillConfig()

    assert (skills.exposure, skills.rule, skills.replan) == (defaults.exposure, defaults.rule, defaults.replan)
    assert skills.choice == defaults.choice == TrackerChoice()


@pytest.mark.parametrize(
    ("choice", "tracker", "weights"),
    [
        (lambda home: Choices(tracker=str(home / "follow.onnx"), device="cpu"), "follow.onnx", None),
        (lambda home: Choices(tracker=str(home / "flow.pt2"), device="cpu"), "flow.pt2", None),
        (lambda home: Choices(tracker="raft", tracker_weights=home / "raft.pth", device="cpu"), "raft", "raft.pth"),
        (
            lambda home: Choices(tracker="cotracker3", tracker_weights=Path("scaled.pth"), device="cpu"),
            "cotracker3",
            "scaled.pth",
        ),
    ],
    ids=["onnx", "pt2", "weights", "weights here"],
)
def test_of_the_users_files_only_the_names_are_on_record(small_scene, tmp_path, choice, tracker, weights):
    home = tmp_path / "home" / "anna"
    chosen = options(small_scene, tmp_path / "record", goal_file=home / "goal.json", choices=choice(home))
    goal = drawn_goal(StubBench(chosen.scene, 4))

    told = header(chosen, SessionSetup(goal, 4, skills=chosen.choices.skills()))
    recorder = Recorder(tmp_path / "record", told)
    recorder.close({"record": ""})

    kept = told["configuration"]["skills"]["choice"]
    assert (told["tracker"], kept["kind"], kept["weights"]) == (tracker, tracker, weights)
    assert "anna" not in (tmp_path / "record" / "session.json").read_text()
    assert chosen.choices.skills().choice.kind == chosen.choices.tracker  # the session itself is given the whole path


@pytest.mark.parametrize(
    ("choices", "sentence"),
    [
        (Choices(device="gpu9"), "there is no device 'gpu9' here"),
        (Choices(tracker="diss"), "did you mean dis?"),
        (Choices(tracker="nowhere.onnx"), "nowhere.onnx"),
        (Choices(tracker="lk", tracker_weights=Path("raft.pth")), "takes no weights"),
    ],
    ids=["device", "tracker", "file", "weights"],
)
def test_what_cannot_be_had_here_is_refused_before_anything_is_made(small_scene, tmp_path, monkeypatch, choices, sentence):
    def made(*_):
        raise AssertionError("a bench was made")

    monkeypatch.setattr("supervisor.run.StubBench", made)

    with pytest.raises(InputError, match=sentence):
        prepare(options(small_scene, tmp_path / "record", choices=choices))
    assert not (tmp_path / "record").exists()


def test_every_cut_in_the_record_came_after_an_approval_and_the_record_ends_in_hold(ran):
    _, folder = ran
    decisions = commands(folder / "record")
    approved = [e.stamp for e in read(folder / "record").topic(topics.APPROVAL) if e.payload.get("event") == "approved"]

    cuts = [d for d in decisions if d["arm"] == CUTTER and d["command"] == "move_jaw" and d["target"] == [0.0] and d["accepted"]]
    assert cuts
    assert approved and min(approved) <= min(d["stamp"] for d in cuts)
    assert decisions[-1]["command"] == "hold"


def test_one_seed_gives_the_same_outcome_and_the_same_commands(ran, tmp_path):
    first, folder = ran
    chosen = options(folder / "small.toml", tmp_path / "again")

    second = run(chosen, *prepare(chosen), AutoApprover())

    assert (first.code, first.attachments, first.length_deviation_m) == (
        second.code,
        second.attachments,
        second.length_deviation_m,
    )
    assert len(commands(tmp_path / "again")) > 100
    assert commands(folder / "record") == commands(tmp_path / "again")


def stopped_by(small_scene: Path, when: float, fault) -> tuple[Session, StubBench, list[float]]:
    """Run a session in which `fault(bench)` strikes at bench time `when`; also the instants of all motions sent."""
    bench = StubBench(load_scene(str(small_scene)), 4)
    sent: list[float] = []
    for arm in bench.arms.values():
        for name in ("servo_cp", "move_cp", "move_jaw"):
            original = getattr(arm, name)

            def spy(*args, original=original):
                sent.append(bench.now())
                return original(*args)

            setattr(arm, name, spy)
    session = Session(bench, SessionSetup(drawn_goal(bench), 4, 1), AutoApprover())
    struck = [False]

    def strike() -> None:
        if bench.now() >= when and not struck[0]:
            struck[0] = True
            fault(bench)

    bench.observe(strike)
    return session, bench, sent


@pytest.mark.parametrize("when", [3.0, 8.0, 12.0])
@pytest.mark.parametrize(
    ("fault", "code"),
    [
        (lambda bench: bench.inject(CUTTER, "fault"), Code.ARM_FAULT),
        (lambda bench: bench.inject(GRASPER, "fault"), Code.ARM_FAULT),
        (lambda bench: bench.press_emergency_stop(), Code.EMERGENCY_STOP),
    ],
)
def test_a_latched_fault_ends_the_session_in_hold_and_nothing_moves_after_it(small_scene, when, fault, code):
    session, bench, sent = stopped_by(small_scene, when, fault)

    outcome = session.run()

    assert outcome.code is code
    assert session.gate.lease is None
    assert max(sent) <= when + 1e-6
    before = [arm.true_pose().position.copy() for arm in bench.arms.values()]
    bench.advance(1.0)
    after = [arm.true_pose().position for arm in bench.arms.values()]
    assert max(abs(a - b).max() for a, b in zip(after, before, strict=True)) < 1e-6


def test_a_frozen_camera_holds_and_the_session_goes_on_when_it_is_back(small_scene):
    def freeze(bench: StubBench) -> None:
        bench.inject("endoscope", "stale")

    session, bench, sent = stopped_by(small_scene, 8.0, freeze)
    bench.observe(lambda: bench.inject("endoscope", "clear") if 10.0 <= bench.now() < 10.01 else None)

    outcome = session.run()

    assert not [t for t in sent if 8.6 < t < 10.0]
    assert [t for t in sent if t > 10.0]
    assert outcome.code is not Code.CAMERA_STALE


def test_exit_statuses_tell_complete_incomplete_and_stopped_apart():
    assert [exit_status(code) for code in ("complete", "attempts_used", "arm_fault", "aborted")] == [0, 1, 3, 3]
