"""`dissect look`: the picture that a goal is drawn on, of the stub and of a robot, which nobody commands meanwhile."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from hardware.codes import InputError
from hardware.dvrk.config import CameraConfig
from hardware.dvrk.transport import TransportError
from hardware.stub.bench import StubBench
from hardware.stub.scene import load_scene
from supervisor import look
from supervisor.cli import app
from tests.mocks.robot import Rig


@pytest.fixture
def rig(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Rig:
    """A robot on a graph of its own, which `look` finds there; time passes only while it waits."""
    rig = Rig(tmp_path, opened=False)
    monkeypatch.setattr(look, "make_transport", lambda kind, name: rig.graph.node(name))
    monkeypatch.setattr(look, "load_robot", lambda file: rig.config)
    monkeypatch.setattr(look, "time", SimpleNamespace(sleep=rig.wait))
    return rig


def test_the_picture_of_the_stub_is_the_first_that_its_session_sees(small_scene: Path, tmp_path: Path) -> None:
    file = tmp_path / "look.png"

    result = CliRunner().invoke(app, ["look", "--scene", str(small_scene), "--seed", "2", "--out", str(file)])

    assert result.exit_code == 0 and '"image_size": [640, 480]' in result.output
    expected = StubBench(load_scene(str(small_scene)), 2).endoscope.left().image
    assert np.array_equal(cv2.imread(str(file))[:, :, ::-1], expected)


def test_the_picture_of_a_robot_is_its_newest_and_no_arm_is_commanded(rig: Rig) -> None:
    image = look.look_at_robot(Path("robot.toml"))

    assert image.shape == (48, 64, 3) and (image == image[0, 0, 0]).all()
    assert not any(arm.heard for arm in rig.robot.arms.values())


def test_a_camera_that_shows_nothing_is_named(rig: Rig) -> None:
    rig.robot.look = lambda: None  # type: ignore[method-assign]

    with pytest.raises(InputError, match="camera has not told its calibration"):
        look.look_at_robot(Path("robot.toml"))


def test_eyes_that_do_not_belong_together_are_no_picture(rig: Rig) -> None:
    rig.config = replace(rig.config, camera=CameraConfig(max_skew=0.005))
    rig.robot.skew = 0.015  # of the 30 ms between two images

    with pytest.raises(InputError, match="no two of them within max_skew"):
        look.look_at_robot(Path("robot.toml"))


def test_without_ros_it_says_how_to_get_it(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(kind: str, name: str) -> None:
        raise TransportError("ROS 1 is not installed for this Python")

    monkeypatch.setattr(look, "make_transport", missing)

    with pytest.raises(InputError, match="ROS 1 is not installed"):
        look.look_at_robot(Path("robot.toml"))


@pytest.mark.parametrize(("name", "sentence"), [("no/folder.png", "cannot be written"), ("look.xyz", "end it with .png")])
def test_a_place_where_no_picture_can_be_is_refused(tmp_path: Path, name: str, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        look.save_picture(np.zeros((4, 4, 3), np.uint8), tmp_path / name)
