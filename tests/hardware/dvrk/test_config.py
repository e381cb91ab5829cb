"""The robot's configuration: the example, every kind of mistake, and what follows from what is written."""

import math
from dataclasses import fields
from pathlib import Path

import pytest

from hardware.codes import InputError
from hardware.dvrk.config import ArmConfig, RobotConfig, load_robot
from hardware.limits import Limits

EXAMPLE = Path(__file__).parents[3] / "docs" / "robot.toml"
LEAST = """
[grasper]
name = "PSM1"
tool_type = "FENESTRATED_BIPOLAR_FORCEPS:400205"
calibration = "PSM1-registration-open-cv.json"
jaw_length = 0.02
{grasper}
[cutter]
name = "PSM2"
tool_type = "POTTS_SCISSORS:400001"
calibration = "PSM2-registration-open-cv.json"
jaw_length = 0.01
{cutter}
{rest}
"""


def write(folder: Path, top: str = "", grasper: str = "", cutter: str = "", rest: str = "") -> Path:
    """A configuration with lines added to its tables."""
    path = folder / "robot.toml"
    path.write_text(top + LEAST.format(grasper=grasper, cutter=cutter, rest=rest), encoding="utf-8")
    return path


def arm(**changes: object) -> ArmConfig:
    """A cutter."""
    values: dict[str, object] = {
        "name": "PSM2",
        "tool_type": "POTTS_SCISSORS:400001",
        "calibration": Path("hand-eye.json"),
        "jaw_length": 0.01,
    }
    return ArmConfig(**{**values, **changes})  # type: ignore[arg-type]


# The example


def test_the_example_is_read() -> None:
    robot = load_robot(EXAMPLE)

    assert (robot.grasper.name, robot.cutter.name) == ("PSM1", "PSM2")
    assert robot.cutter.tool_type == "POTTS_SCISSORS:400001"
    assert robot.console.endoscope_arm == "ECM"


def test_the_example_says_the_defaults_as_they_are(tmp_path: Path) -> None:
    lines = EXAMPLE.read_text(encoding="utf-8").splitlines()
    bare = [line.removeprefix("# ") if line.startswith("# ") and ("=" in line or "[" in line[:4]) else line for line in lines]
    spelt = "\n".join(bare[2:])
    path = tmp_path / "robot.toml"
    path.write_text(spelt, encoding="utf-8")
    (tmp_path / "plain.toml").write_text("\n".join(lines), encoding="utf-8")

    assert load_robot(path) == load_robot(tmp_path / "plain.toml")


def test_the_example_speaks_of_every_key() -> None:
    text = EXAMPLE.read_text(encoding="utf-8")
    robot = load_robot(EXAMPLE)
    tables = [robot, robot.grasper, robot.camera, robot.console, robot.tolerances, robot.speeds, robot.rates, robot.limits]

    missing = [item.name for table in tables for item in fields(table) if item.name not in text and item.name != "role"]

    assert missing == []


# What follows


def test_paths_are_relative_to_the_file(tmp_path: Path) -> None:
    assert load_robot(write(tmp_path)).cutter.calibration == tmp_path / "PSM2-registration-open-cv.json"


def test_the_frame_is_the_arms_own_base_where_none_is_named(tmp_path: Path) -> None:
    robot = load_robot(write(tmp_path, cutter='frame_id = "remote_centre"'))

    assert robot.grasper.frame_id == "PSM1_base"
    assert robot.cutter.frame_id == "remote_centre"


def test_a_prefix_stands_in_front_of_every_topic(tmp_path: Path) -> None:
    assert load_robot(write(tmp_path)).topic("PSM1/measured_cp") == "/PSM1/measured_cp"
    assert load_robot(write(tmp_path, top='prefix = "/dvrk"')).topic("PSM1/measured_cp") == "/dvrk/PSM1/measured_cp"


def test_whole_numbers_are_taken_for_lengths_and_times(tmp_path: Path) -> None:
    frozen = load_robot(write(tmp_path, rest="[rates]\nfrozen = 1")).rates.frozen

    assert frozen == 1.0 and isinstance(frozen, float)


def test_a_cautery_may_cut(tmp_path: Path) -> None:
    path = write(tmp_path)
    path.write_text(path.read_text().replace("POTTS_SCISSORS:400001", "PERMANENT_CAUTERY_SPATULA:400184"))

    assert not load_robot(path).cutter.instrument.has_jaw


# Mistakes


@pytest.mark.parametrize(
    ("where", "line", "said"),
    [
        ("top", 'transprot = "ros1"', r"robot\.toml: the key 'transprot' is unknown; did you mean 'transport'\?"),
        ("cutter", "jawlength = 0.01", r"robot\.toml: cutter: the key 'jawlength' is unknown; did you mean 'jaw_length'\?"),
        ("rest", "[speed]", r"the key 'speed' is unknown; did you mean 'speeds'\?"),
        ("rest", "[speeds]\nzzz = 1", r"speeds: the key 'zzz' is unknown; known keys are ratio, linear, angular$"),
        ("top", "transport = 1", r"transport must be text in quotes, not 1"),
        ("top", 'camera = "stereo"', r"camera must be a table of keys, not 'stereo'"),
        ("rest", '[console]\noperator_presence = "yes"', r"console: operator_presence must be true or false, not 'yes'"),
        ("rest", "[console]\noperator_presence = 1", r"operator_presence must be true or false, not 1"),
        ("rest", '[console]\nconsole = ""', r"operator_presence is true without a console to tell it"),
        ("rest", "[console]\nteleops = 'MTMR_PSM1'", r"teleops must be a list, not 'MTMR_PSM1'"),
        ("rest", "[console]\nteleops = [1]", r"teleops must be text in quotes, not 1"),
        ("rest", "[rates]\nservo = 100.0", r"rates: the key 'servo' is unknown"),
        ("rest", "[rates]\nheartbeat = 50.0", r"rates: the key 'heartbeat' is unknown"),
        ("rest", "[speeds]\njaw = 1.0", r"speeds: the key 'jaw' is unknown"),
        ("rest", "[speeds]\nratio = true", r"speeds: ratio must be a finite number, not True"),
        ("rest", "[speeds]\nratio = nan", r"speeds: ratio must be a finite number, not nan"),
        ("rest", "[tolerances]\nsamples = 2.5", r"tolerances: samples must be a whole number, not 2\.5"),
        ("grasper", "tip_rotation = [0, 0, inf]", r"grasper: tip_rotation must be a finite number, not inf"),
        ("top", 'transport = "ros3"', r"transport is 'ros3'; it must be one of ros1, ros2"),
        ("top", 'prefix = "dvrk/"', r"prefix is 'dvrk/'; it must begin with a slash"),
        ("top", 'prefix = "/dvrk/"', r"prefix is '/dvrk/'"),
        ("rest", "[speeds]\nratio = 1.0", r"speeds: ratio is 1\.0; it must lie from 0\.02 to 0\.3"),
        ("rest", "[tolerances]\nposition = 0.05", r"position is 0\.05; it must lie from 0\.0001 to 0\.005"),
        ("rest", '[camera]\nrig = "/stereo"', r"camera: rig is '/stereo'; it must be a name"),
        ("rest", "[rates]\nstale = 0.5\nfrozen = 0.2", r"frozen is 0\.2; it must be longer than stale, 0\.5"),
        ("grasper", "tip_rotation = [0, 1]", r"tip_rotation is \(0\.0, 1\.0\); it must be three numbers"),
        ("grasper", "tip_rotation = [0, 0, 90]", r"tip_rotation is .* by at most pi"),
        ("grasper", 'calibration_axes = "ros"', r"calibration_axes is 'ros'; it must be 'open-cv' or 'dvrk'"),
        ("cutter", "jaw_closed = -0.8", r"jaw_closed is -0\.8"),
        ("cutter", "jaw_zero = -0.3\njaw_closed = -0.1", r"jaw_closed is -0\.1; it must lie from -0\.698.*to jaw_zero, -0\.3"),
    ],
)
def test_a_mistake_is_one_sentence_that_names_the_key(tmp_path: Path, where: str, line: str, said: str) -> None:
    path = write(tmp_path, **{where: line})

    with pytest.raises(InputError, match=said):
        load_robot(path)


def test_a_missing_key_is_named(tmp_path: Path) -> None:
    path = write(tmp_path)
    path.write_text(path.read_text().replace("jaw_length = 0.01\n", ""))

    with pytest.raises(InputError, match=r"robot\.toml: cutter: the key 'jaw_length' is missing"):
        load_robot(path)


def test_a_missing_arm_is_named(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text('transport = "ros1"')

    with pytest.raises(InputError, match="the key 'grasper' is missing"):
        load_robot(path)


def test_a_missing_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"configuration nowhere\.toml cannot be read"):
        load_robot(tmp_path / "nowhere.toml")


def test_a_file_that_is_no_toml_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "robot.toml"
    path.write_text("transport: ros1")

    with pytest.raises(InputError, match=r"robot\.toml cannot be read"):
        load_robot(path)


def test_one_arm_cannot_be_both(tmp_path: Path) -> None:
    path = write(tmp_path)
    path.write_text(path.read_text().replace('"PSM2"', '"PSM1"'))

    with pytest.raises(InputError, match="grasper and cutter are both PSM1"):
        load_robot(path)


def test_an_unknown_instrument_is_refused() -> None:
    with pytest.raises(InputError, match="'HAMMER:1' is not known"):
        arm(tool_type="HAMMER:1")


def test_cautery_cannot_grasp() -> None:
    cautery = arm(name="PSM1", tool_type="PERMANENT_CAUTERY_SPATULA:400184")

    with pytest.raises(InputError, match="has no jaw; it must be forceps"):
        RobotConfig(grasper=cautery, cutter=arm())


@pytest.mark.parametrize("length", [-0.001, 0.05, math.nan])
def test_a_jaw_has_a_plausible_length(length: float) -> None:
    with pytest.raises(InputError, match=r"jaw_length is .* it must lie from 0 to 0\.04"):
        arm(jaw_length=length)


@pytest.mark.parametrize("name", ["", "/PSM1", "PSM 1", "PSM1/", "1PSM"])
def test_an_arm_has_a_name_that_can_stand_in_a_topic(name: str) -> None:
    with pytest.raises(InputError, match="name is "):
        arm(name=name)


# Limits and names


def test_limits_that_are_left_out_are_the_gates_own(tmp_path: Path) -> None:
    assert load_robot(write(tmp_path)).limits.limits() == Limits()


def test_limits_of_the_file_replace_the_gates_own(tmp_path: Path) -> None:
    rest = "[limits]\nworkspace_lower = [-0.05, -0.05, 0.03]\ntension_stop = 2.5\nmax_speed = 0.006"

    limits = load_robot(write(tmp_path, rest=rest)).limits.limits()

    assert (limits.workspace_lower, limits.tension_stop, limits.max_speed) == ((-0.05, -0.05, 0.03), 2.5, 0.006)
    assert limits.workspace_upper == Limits().workspace_upper


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ("tension_stop = 6.0", "tension_stop is 6.0; it must not exceed tension_abort"),
        ("tension_abort = 50", "tension_abort is 50.0; it must lie from 0.1 to 12"),
        ("workspace_lower = [0.0, 0.0]", "workspace_lower is .* three numbers"),
        ("workspace_lower = [-0.09, -0.07, 0.25]", "workspace_lower .* must lie below workspace_upper"),
        ("workspace_upper = [0.09, 0.07, 2.0]", "none beyond 0.3"),
        ("camera_stale = 1.0", "'camera_stale' is unknown"),
    ],
)
def test_limits_that_guard_nothing_are_refused(tmp_path: Path, line: str, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        load_robot(write(tmp_path, rest=f"[limits]\n{line}"))


def test_people_are_told_what_an_arm_does_and_what_it_is_called(tmp_path: Path) -> None:
    robot = load_robot(write(tmp_path))

    assert [arm.called for arm in robot.arms] == ["grasper (PSM1)", "cutter (PSM2)"]


def test_what_an_arm_does_is_no_key_of_the_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="'role' is unknown"):
        load_robot(write(tmp_path, cutter='role = "grasper"'))
