"""A session on a robot as far as it goes without tissue: prepared, refused, recorded without truth, and ended in hold."""

import gc
import json
import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from behaviours.proposal import Answer, Proposal
from hardware.codes import Code, InputError
from hardware.dvrk.config import LimitsConfig
from hardware.dvrk.doctor import Finding
from hardware.dvrk.messages import Picture
from hardware.dvrk.transport import TransportError
from supervisor import topics
from supervisor.cli import main
from supervisor.doctor import Check
from supervisor.reading import read
from supervisor.robot import agree_to_power, diagnose_robot, fitted, stay_prompt
from supervisor.run import RunOptions, prepare_robot, run
from supervisor.skillset import SkillConfig
from tests.mocks.robot import Rig, camera_info, robot_config

FOCAL = 600.0
K = np.array([[FOCAL, 0.0, 319.5], [0.0, FOCAL, 239.5], [0.0, 0.0, 1.0]])
SIZE = (640, 480)


class Decline:
    """An operator who says no."""

    def __init__(self) -> None:
        self._proposal: Proposal | None = None

    def request(self, proposal: Proposal) -> None:
        self._proposal = proposal

    def answer(self) -> Answer | None:
        return None if self._proposal is None else Answer(self._proposal.goal_id, False, "operator", "not today")

    def cancel(self) -> None:
        self._proposal = None


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    """A robot whose camera sees a pink sheet on a dark table; its arms stand well inside the workspace."""
    folder = tmp_path / "robot"
    folder.mkdir()
    rig = Rig(folder, opened=False)
    picture = np.full((480, 640, 3), 15, dtype=np.uint8)
    picture[90:390, 120:520] = (205, 120, 110)

    def look() -> None:
        for eye in ("left", "right"):
            stamp = rig.robot.node.stamp()
            rig.robot.infos[eye].publish(camera_info(eye, stamp, K, SIZE))
            rig.robot.eyes[eye].publish(Picture(stamp, eye, picture))

    rig.robot.look = look  # type: ignore[method-assign]
    return rig


def goal_file(folder: Path) -> Path:
    path = folder / "goal.json"
    line = [[260.0 + 20 * k, 240.0] for k in range(7)]
    path.write_text(json.dumps({"image_size": SIZE, "polyline": line, "grasp": [320.0, 180.0]}))
    return path


def options(tmp_path: Path, goal: Path | None) -> RunOptions:
    return RunOptions(None, goal, "planning", 1, True, 3, tmp_path / "record", True)


def test_a_session_that_the_operator_declines_is_recorded_without_truth_and_ends_in_hold(rig: Rig, tmp_path: Path):
    chosen = options(tmp_path, goal_file(tmp_path))
    bench, goal = prepare_robot(chosen, rig.bench)

    result = run(chosen, bench, goal, Decline())

    record = read(tmp_path / "record")
    assert result.code != Code.COMPLETE and (result.success, result.attachments, result.scene) == (None, None, None)
    assert record.closed and not record.topic(topics.TRUTH)
    assert (record.header["bench"], record.header["scene"]) == ("dvrk", None)
    assert record.header["configuration"]["robot"]["cutter"]["tool_type"] == "POTTS_SCISSORS:400001"
    assert record.header["configuration"]["robot"]["cutter"]["calibration"] == "PSM2-registration-open-cv.json"
    assert "hand-eye" in record.header["calibration"]
    rates = {one["topic"]: one["rate"] for one in record.outcome["bench"]["topics"]}
    assert rates["/PSM1/measured_cp"] > 90
    assert (tmp_path / "record" / "report.html").exists()
    assert str(tmp_path) not in (tmp_path / "record" / "session.json").read_text()
    assert all(arm.heard[-1][0] == "hold" for arm in rig.robot.arms.values())
    assert not any(name == "servo_cp" for arm in rig.robot.arms.values() for name, _ in arm.heard)


def test_on_a_robot_the_goal_is_the_operators_own(rig: Rig, tmp_path: Path):
    with pytest.raises(InputError, match="--goal"):
        prepare_robot(options(tmp_path, None), rig.bench)


def test_a_robot_that_is_not_ready_makes_no_record(rig: Rig, tmp_path: Path):
    rig.deadman = None

    with pytest.raises(InputError, match="deadman"):
        prepare_robot(options(tmp_path, goal_file(tmp_path)), rig.bench)

    assert not (tmp_path / "record").exists()


def test_nothing_is_powered_or_homed_before_a_person_agrees(rig: Rig, tmp_path: Path):
    bench, _ = prepare_robot(options(tmp_path, goal_file(tmp_path)), rig.bench)
    asked: list[str] = []

    def decline(question: str) -> str:
        asked.append(question)
        return ""

    with pytest.raises(InputError, match="nothing was powered"):
        agree_to_power(bench, decline)

    assert "grasper (PSM1) and cutter (PSM2)" in asked[0]
    assert not any(name == "state_command" for arm in rig.robot.arms.values() for name, _ in arm.heard)
    assert bench.deadman == "idle"


def test_where_nobody_can_be_asked_nobody_agrees(rig: Rig, tmp_path: Path):
    bench, _ = prepare_robot(options(tmp_path, goal_file(tmp_path)), rig.bench)

    def closed(question: str) -> str:
        raise EOFError

    with pytest.raises(InputError, match="nothing was powered"):
        agree_to_power(bench, closed)


def test_a_person_who_agrees_is_asked_once(rig: Rig, tmp_path: Path):
    bench, _ = prepare_robot(options(tmp_path, goal_file(tmp_path)), rig.bench)

    agree_to_power(bench, lambda question: "y")

    assert bench.deadman == "watching"


def test_arms_that_are_enabled_and_homed_need_no_word(tmp_path: Path):
    def ask(question: str) -> str:
        raise AssertionError(question)

    agree_to_power(Rig(tmp_path).bench, ask)


def test_the_limits_of_the_robot_are_those_of_its_session(tmp_path: Path, rig: Rig):
    rig.bench._config = replace(rig.config, limits=LimitsConfig(tension_warn=1.0, tension_stop=1.5, max_speed=5e-3))
    chosen = options(tmp_path, goal_file(tmp_path))
    bench, goal = prepare_robot(chosen, rig.bench)

    run(chosen, bench, goal, Decline())

    limits = read(tmp_path / "record").header["limits"]
    assert (limits["tension_stop"], limits["max_speed"], limits["camera_stale"]) == (1.5, 5e-3, 0.2)


def test_potts_scissors_snip_shorter_because_they_open_less(tmp_path: Path):
    skills = fitted(SkillConfig(), robot_config(tmp_path))

    planning = skills.planning
    reach = 10e-3 - planning.depth
    opening = 2 * math.atan((planning.snip + planning.overlap) / 2 / reach)
    assert opening <= planning.most_jaw + 1e-9 < math.radians(30.0)
    assert 1e-3 < planning.snip < SkillConfig().planning.snip


def test_scissors_that_open_wide_change_nothing(tmp_path: Path):
    config = robot_config(tmp_path)
    wide = replace(config, cutter=replace(config.cutter, tool_type="CURVED_SCISSORS:400178", jaw_closed=-0.3))

    assert fitted(SkillConfig(), wide) == SkillConfig()


def test_scissors_that_open_too_little_are_refused(tmp_path: Path):
    config = robot_config(tmp_path)
    narrow = replace(config, cutter=replace(config.cutter, jaw_zero=0.35))

    with pytest.raises(InputError, match="too little for any snip"):
        fitted(SkillConfig(), narrow)


def test_a_process_on_a_graph_takes_short_turns_and_collects_no_more_what_it_began_with():
    turn = sys.getswitchinterval()
    try:
        stay_prompt()
        assert sys.getswitchinterval() < 1e-3
        assert gc.get_freeze_count() > 10_000
    finally:
        sys.setswitchinterval(turn)
        gc.unfreeze()


# ------------------------------------------------------------ the command line


def refusal(monkeypatch, capsys, *arguments: str) -> str:
    monkeypatch.setattr(sys, "argv", ["dissect", *arguments])
    with pytest.raises(SystemExit) as ended:
        main()
    assert ended.value.code == 2
    return " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("run", "--bench", "dvrk"), "--bench dvrk needs the robot's configuration"),
        (("doctor", "--bench", "dvrk"), "--bench dvrk needs the robot's configuration"),
        (("run", "--config", "robot.toml"), "--config is for a robot"),
        (("run", "--bench", "dvrk", "--config", "robot.toml", "--approve", "auto"), "approved by the operator"),
        (("doctor", "--bench", "dvrk", "--config", "nowhere.toml"), "nowhere.toml cannot be read"),
    ],
)
def test_the_command_line_refuses_in_one_sentence(monkeypatch, capsys, tmp_path, arguments: tuple[str, ...], said: str):
    monkeypatch.chdir(tmp_path)

    assert said in refusal(monkeypatch, capsys, *arguments)


def test_without_ros_the_doctor_says_how_to_get_it(monkeypatch, tmp_path):
    def missing(kind: str, name: str):
        raise TransportError("ROS 1 is not installed for this Python")

    monkeypatch.setattr("supervisor.robot.make_transport", missing)
    monkeypatch.setattr("supervisor.robot.load_robot", lambda file: robot_config(tmp_path))

    (check,) = diagnose_robot(tmp_path / "robot.toml")

    assert not check.ok and check.required and "ROS 1 is not installed" in check.remedy


def test_the_doctor_of_a_robot_is_a_list_of_checks(monkeypatch, rig: Rig, tmp_path):
    monkeypatch.setattr("supervisor.robot.make_transport", lambda kind, name: rig.graph.node(name))
    monkeypatch.setattr("supervisor.robot.load_robot", lambda file: rig.config)
    monkeypatch.setattr("supervisor.robot.examine", lambda bench: [Finding("deadman", False, "not running", "Start it.")])

    assert diagnose_robot(tmp_path / "robot.toml") == [Check("deadman", False, "not running", "Start it.", True)]


def test_the_deadman_is_told_the_arms_of_the_configuration(monkeypatch, tmp_path):
    told: list[list[str]] = []
    config = replace(robot_config(tmp_path), prefix="/dvrk", transport="ros2")
    monkeypatch.setattr("hardware.dvrk.config.load_robot", lambda file: config)
    monkeypatch.setattr("hardware.dvrk.deadman.main", lambda arguments: told.append(arguments) or 0)
    monkeypatch.setattr(sys, "argv", ["dissect", "deadman", "--config", "robot.toml"])

    with pytest.raises(SystemExit) as ended:
        main()

    assert ended.value.code == 0
    assert told == [["/dvrk/PSM1", "/dvrk/PSM2", "--transport", "ros2", "--budget", "0.1"]]
