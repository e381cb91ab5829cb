"""Hand-eye files in every form that they are written in, and the one place where frames change."""

import json
import math
import os
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from hardware.codes import InputError
from hardware.dvrk.calibration import (
    ArmFrames,
    HandEye,
    arm_frames,
    as_matrix,
    as_pose,
    force_to_camera,
    load_hand_eye,
    to_base,
    to_camera,
    vector_to_base,
    vector_to_camera,
)
from hardware.dvrk.config import ArmConfig
from hardware.dvrk.instruments import instrument
from hardware.dvrk.kinematics import forward
from hardware.interface import Array, Pose

FLIP = np.diag([-1.0, -1.0, 1.0, 1.0])


def rigid(vector: tuple[float, float, float], position: tuple[float, float, float]) -> Array:
    """A (4, 4) from a rotation vector and a position."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = Rotation.from_rotvec(vector).as_matrix(), position
    return matrix


# Camera to base, OpenCV axes: a remote centre 0.13 m from the camera
TRUE = rigid((2.0, -0.4, 0.3), (0.0907, -0.0966, 0.0247))
ENDOSCOPE = rigid((0.3, 2.9, -0.2), (0.02, -0.03, -0.12))


def body(matrix: Array, key: str = "base-frame", inner: str = "reference-frame", frame: str = "camera") -> str:
    """The text that the registration tool writes, without its braces."""
    return f'"{key}": ' + json.dumps({inner: frame, "transform": matrix.tolist()})


def save(folder: Path, text: str, name: str = "PSM1-registration-open-cv.json") -> Path:
    path = folder / name
    path.write_text(text + "\n", encoding="utf-8")
    return path


def cutter(jaw_length: float = 0.010, **changes: object) -> ArmConfig:
    return ArmConfig("PSM1", "POTTS_SCISSORS:400001", Path("none.json"), jaw_length, **changes)  # type: ignore[arg-type]


# The tool's files


def test_the_open_cv_file_is_taken_as_it_is(tmp_path: Path) -> None:
    path = save(tmp_path, "{\n" + body(TRUE, frame="/decklink_frame") + "\n}")

    hand_eye = load_hand_eye(path, "PSM1")

    np.testing.assert_allclose(hand_eye.camera_from_base, TRUE, atol=1e-12)
    assert hand_eye.reference_frame == "/decklink_frame"


def test_the_dvrk_file_is_a_fragment_in_the_dvrks_axes(tmp_path: Path) -> None:
    path = save(tmp_path, body(FLIP @ TRUE), "PSM1-registration-dVRK.json")

    np.testing.assert_allclose(load_hand_eye(path, "PSM1").camera_from_base, TRUE, atol=1e-12)


def test_the_dvrk_file_may_have_been_given_braces(tmp_path: Path) -> None:
    path = save(tmp_path, "{" + body(FLIP @ TRUE) + "}", "PSM1-registration-dVRK.json")

    np.testing.assert_allclose(load_hand_eye(path, "PSM1").camera_from_base, TRUE, atol=1e-12)


def test_a_fragment_cut_from_the_middle_of_a_file_may_end_with_a_comma(tmp_path: Path) -> None:
    path = save(tmp_path, body(FLIP @ TRUE) + ",", "PSM1-registration-dVRK.json")

    np.testing.assert_allclose(load_hand_eye(path, "PSM1").camera_from_base, TRUE, atol=1e-12)


def test_keys_may_have_underscores(tmp_path: Path) -> None:
    path = save(tmp_path, "{" + body(TRUE, "base_frame", "reference_frame", "left_camera") + "}")

    hand_eye = load_hand_eye(path, "PSM1")

    np.testing.assert_allclose(hand_eye.camera_from_base, TRUE, atol=1e-12)
    assert hand_eye.reference_frame == "left_camera"


def test_an_entry_of_suj_fixed_is_seen_from_the_endoscopes_base(tmp_path: Path) -> None:
    written = ENDOSCOPE @ FLIP @ TRUE
    path = save(tmp_path, json.dumps({"name": "PSM1", "measured_cp": written.tolist()}), "PSM1-registration-dVRK.json")

    hand_eye = load_hand_eye(path, "PSM1", endoscope=ENDOSCOPE)

    np.testing.assert_allclose(hand_eye.camera_from_base, TRUE, atol=1e-12)


def test_an_entry_of_suj_fixed_needs_the_endoscopes_pose(tmp_path: Path) -> None:
    path = save(tmp_path, json.dumps({"name": "PSM1", "measured_cp": TRUE.tolist()}), "PSM1-registration-dVRK.json")

    with pytest.raises(InputError, match=r"seen from the endoscope arm's base; set endoscope_arm"):
        load_hand_eye(path, "PSM1")


def test_an_endoscope_whose_pose_is_not_known_calibrates_nothing(tmp_path: Path) -> None:
    path = save(tmp_path, json.dumps({"name": "PSM1", "measured_cp": TRUE.tolist()}), "PSM1-registration-dVRK.json")

    with pytest.raises(InputError, match="the pose of the endoscope arm must be four rows"):
        load_hand_eye(path, "PSM1", endoscope=np.full((4, 4), math.nan))


def test_the_age_is_that_of_the_file(tmp_path: Path) -> None:
    path = save(tmp_path, "{" + body(TRUE) + "}")
    os.utime(path, (1_700_000_000, 1_700_000_000))

    hand_eye = load_hand_eye(path, "PSM1")

    assert hand_eye.written == 1_700_000_000
    assert hand_eye.age(1_700_003_600.0) == 3600.0


def test_digits_lost_in_copying_do_not_leave_a_crooked_rotation(tmp_path: Path) -> None:
    path = save(tmp_path, "{" + body(TRUE.round(4)) + "}")

    rotation = load_hand_eye(path, "PSM1").camera_from_base[:3, :3]

    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(rotation, TRUE[:3, :3], atol=1e-4)


# Axes are never guessed


def test_a_file_whose_axes_nobody_tells_is_refused(tmp_path: Path) -> None:
    path = save(tmp_path, "{" + body(TRUE) + "}", "PSM1.json")

    with pytest.raises(InputError, match="does not say which axes it has; name it -open-cv or -dVRK, or set calibration_axes"):
        load_hand_eye(path, "PSM1")


@pytest.mark.parametrize(("axes", "written"), [("open-cv", TRUE), ("dvrk", FLIP @ TRUE)])
def test_the_configuration_may_tell_the_axes(tmp_path: Path, axes: str, written: Array) -> None:
    path = save(tmp_path, "{" + body(written) + "}", "left-arm.json")

    np.testing.assert_allclose(load_hand_eye(path, "PSM1", axes).camera_from_base, TRUE, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "text", "axes"),
    [
        ("PSM1-registration-open-cv.json", "{" + body(TRUE) + "}", "dvrk"),
        ("PSM1-registration-dVRK.json", "{" + body(TRUE) + "}", "open-cv"),
        ("PSM1-registration-open-cv.json", body(TRUE), ""),  # the tool never writes these axes without braces
    ],
)
def test_a_contradiction_about_the_axes_is_refused(tmp_path: Path, name: str, text: str, axes: str) -> None:
    with pytest.raises(InputError, match="both open-cv and dvrk"):
        load_hand_eye(save(tmp_path, text, name), "PSM1", axes)


# Whose file it is


def test_the_file_of_another_arm_is_refused(tmp_path: Path) -> None:
    path = save(tmp_path, "{" + body(TRUE) + "}", "PSM2-registration-open-cv.json")

    with pytest.raises(InputError, match="of PSM1 bears the name of PSM2"):
        load_hand_eye(path, "PSM1")


def test_the_entry_of_another_arm_is_refused(tmp_path: Path) -> None:
    path = save(tmp_path, json.dumps({"name": "PSM2", "measured_cp": TRUE.tolist()}), "suj.json")

    with pytest.raises(InputError, match="is about 'PSM2'; it must be about PSM1"):
        load_hand_eye(path, "PSM1", endoscope=ENDOSCOPE)


# What is no calibration


def spoilt(row: int, column: int, value: object) -> str:
    rows: list[list[object]] = TRUE.tolist()
    rows[row][column] = value
    return "{" + '"base-frame": ' + json.dumps({"reference-frame": "camera", "transform": rows}) + "}"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (spoilt(0, 0, 0.9), r"is no rotation: its rows must be orthonormal"),
        ("{" + body(np.diag([1.0, 1.0, -1.0, 1.0]) @ TRUE) + "}", r"with determinant \+1 \(it is -1\.000\)"),
        (spoilt(3, 3, 2.0), r"has the last row \[0\.0, 0\.0, 0\.0, 2\.0\]; it must be 0, 0, 0, 1"),
        (spoilt(3, 0, 0.09), r"has the last row"),
        (spoilt(0, 3, math.nan), r"must be four rows of four finite numbers"),
        (spoilt(0, 3, "left"), r"must be four rows of four finite numbers"),
        ("{" + body(TRUE[:3]) + "}", r"must be four rows of four finite numbers"),
        ("{" + body(rigid((2.0, -0.4, 0.3), (90.7, -96.6, 24.7))) + "}", r"134\.789 m from the camera; .*metres"),
        ("{" + body(np.eye(4)) + "}", r"0\.000 m from the camera; .*not a placeholder"),
        ('{"base-frame": {"reference-frame": "camera"}}', r"must be four rows of four finite numbers"),
        ('{"base-frame": {"reference-frame": 3, "transform": []}}', r"has the reference-frame 3"),
        ('{"arms": []}', r"holds arms; it must hold base-frame, or name and measured_cp"),
        ("{}", r"holds nothing; it must hold base-frame"),
        ('{"base-frame": {', r"is not what dvrk_camera_registration writes"),
        ("", r"holds nothing|is not what"),
        ("[1, 2]", r"is not what dvrk_camera_registration writes"),
    ],
)
def test_what_is_no_calibration_is_refused_in_one_sentence(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said):
        load_hand_eye(save(tmp_path, text), "PSM1", "")


def test_a_missing_file_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"the hand-eye file none\.json of PSM1 cannot be read"):
        load_hand_eye(tmp_path / "none.json", "PSM1")


# Changes of frame

unit = st.floats(-1.0, 1.0)


@st.composite
def poses(draw: st.DrawFn) -> Pose:
    """Any pose within reach."""
    turn = Rotation.from_rotvec([3.0 * draw(unit), 2.0 * draw(unit), draw(unit)])
    return Pose(0.2 * np.array([draw(unit), draw(unit), draw(unit)]), turn.as_quat())


@pytest.fixture(scope="module")
def frames() -> ArmFrames:
    return arm_frames(HandEye(TRUE, "camera", 0.0), cutter())


@given(pose=poses())
@settings(max_examples=100, deadline=None)
def test_to_the_base_and_back_changes_nothing(frames: ArmFrames, pose: Pose) -> None:
    back = to_camera(frames, to_base(frames, pose))

    np.testing.assert_allclose(back.position, pose.position, atol=1e-12)
    np.testing.assert_allclose(back.rotation(), pose.rotation(), atol=1e-9)
    assert np.linalg.norm(back.quaternion) == pytest.approx(1.0, abs=1e-12)


def test_the_tool_frame_lies_at_the_jaw_tip_with_z_out_of_it(frames: ArmFrames) -> None:
    tip = as_pose(forward(instrument("POTTS_SCISSORS:400001"), np.array([0.0, 0.0, 0.12, 0.0, 0.0, 0.0])))

    tool = as_matrix(to_camera(frames, tip))

    in_base = np.linalg.inv(TRUE) @ tool
    np.testing.assert_allclose(in_base[:3, 3], [0.0, 0.0, -0.1235], atol=1e-9)  # 10 mm beyond the wrist, down the shaft
    np.testing.assert_allclose(in_base[:3, 2], [0.0, 0.0, -1.0], atol=1e-9)


def test_the_jaws_open_along_the_tools_x() -> None:
    """A jaw turns about the wrist-yaw axis, so its tip leaves along the way that a wrist-yaw motion takes the tool's tip."""
    potts, q, step = instrument("POTTS_SCISSORS:400001"), np.array([0.3, -0.2, 0.15, 0.5, 0.4, -0.3]), 1e-6
    frames = arm_frames(HandEye(TRUE, "camera", 0.0), cutter())

    before = to_camera(frames, as_pose(forward(potts, q)))
    after = to_camera(frames, as_pose(forward(potts, q + step * np.eye(6)[5])))

    way = before.rotation().T @ (after.position - before.position) / (step * 0.010)
    np.testing.assert_allclose(np.abs(way), [1.0, 0.0, 0.0], atol=1e-4)


def test_another_rotation_of_the_tip_may_be_configured() -> None:
    frames = arm_frames(HandEye(TRUE, "camera", 0.0), cutter(tip_rotation=(0.0, 0.0, 0.0)))
    tip = as_pose(np.eye(4))

    tool = to_camera(frames, tip)

    np.testing.assert_allclose(tool.rotation(), TRUE[:3, :3], atol=1e-12)


def test_the_calibration_is_applied_once(frames: ArmFrames) -> None:
    """The remote centre, seen from the camera, is where the hand-eye file puts it."""
    bare = arm_frames(HandEye(TRUE, "camera", 0.0), cutter(jaw_length=0.0))

    assert to_camera(bare, as_pose(np.eye(4))).position == pytest.approx(TRUE[:3, 3])


def test_vectors_turn_and_do_not_shift(frames: ArmFrames) -> None:
    vector = np.array([0.1, -0.2, 0.3])

    np.testing.assert_allclose(vector_to_camera(frames, vector), TRUE[:3, :3] @ vector, atol=1e-12)
    np.testing.assert_allclose(vector_to_base(frames, vector_to_camera(frames, vector)), vector, atol=1e-12)


def test_a_force_along_the_tip_is_told_along_the_cameras_axes(frames: ArmFrames) -> None:
    tip = as_pose(forward(instrument("POTTS_SCISSORS:400001"), np.array([0.3, -0.2, 0.15, 0.5, 0.4, -0.3])))

    force = force_to_camera(frames, tip, np.array([0.0, 0.0, 2.0]))

    np.testing.assert_allclose(force, 2.0 * to_camera(frames, tip).rotation()[:, 2], atol=1e-9)
