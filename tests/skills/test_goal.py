"""Goal files and goals: what is read back, what is refused, and in which words."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hardware.codes import InputError
from skills.scene.goal import Goal, GoalLimits, load_goal, normal, resample, save_goal, validate_goal
from skills.scene.polyline import arc_lengths

GOOD = {"image_size": [640, 480], "polyline": [[160, 240], [320, 236], [480, 240]], "grasp": [320, 180]}


def write(folder: Path, content: object) -> Path:
    path = folder / "goal.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content), encoding="utf-8")
    return path


def goal_of(polyline: Sequence[Sequence[float]], grasp: tuple[float, float] = (320.0, 60.0)) -> Goal:
    return Goal(np.array(polyline, dtype=float), np.array(grasp), (640, 480))


def test_a_saved_goal_is_read_back_exactly(tmp_path: Path) -> None:
    goal = goal_of([[100.25, 200.5], [300.125, 210.0]])
    save_goal(goal, tmp_path / "g.json")
    loaded = load_goal(tmp_path / "g.json")
    assert np.array_equal(loaded.polyline, goal.polyline)
    assert np.array_equal(loaded.grasp, goal.grasp)
    assert loaded.image_size == (640, 480)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"polylin": [[1, 2]]}, "did you mean 'polyline'"),
        ({"grasp": [1]}, "grasp must be one pixel"),
        ({"grasp": [True, 3]}, "grasp must be one pixel"),
        ({"image_size": [640.5, 480]}, "two positive whole numbers"),
        ({"polyline": [[1, "2"], [3, 4]]}, "list of pixels"),
        ({"polyline": [[100, 100]]}, "at least two points"),
        ({"polyline": []}, "at least two points"),
        ({"polyline": [[160, 240], [700, 240]]}, "Point 2 of the goal (700, 240) lies outside"),
        ({"polyline": [[160, 240], [160, 240], [300, 240]]}, "Points 1 and 2 of the goal are the same"),
        ({"polyline": [[160, float("nan")], [300, 240]]}, "Point 1 of the goal is not a finite number"),
        ({"grasp": [float("inf"), 3]}, "grasp point is not a finite number"),
        ({"polyline": [[100, 300], [300, 300], [300, 200]]}, "turns by 90 degrees at point 2; at most 60 degrees"),
        ({"polyline": [[100, 200], [300, 200], [320, 220], [300, 240], [200, 240], [150, 100]]}, "crosses itself"),
        ({"grasp": [320, 231]}, "at least 10 px"),
    ],
)
def test_bad_content_is_refused_in_one_sentence(tmp_path: Path, change: dict[str, object], words: str) -> None:
    with pytest.raises(InputError, match=r".+") as caught:
        load_goal(write(tmp_path, GOOD | change))
    sentence = str(caught.value)
    assert words in sentence
    assert "\n" not in sentence
    assert sentence.endswith((".", "?"))


def test_a_missing_key_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="lacks the key 'grasp'"):
        load_goal(write(tmp_path, {k: v for k, v in GOOD.items() if k != "grasp"}))


@pytest.mark.parametrize("content", ["{", "", "[1, 2]", "\x00\x01", '"text"'])
def test_a_file_that_is_no_goal_is_refused(tmp_path: Path, content: str) -> None:
    with pytest.raises(InputError):
        load_goal(write(tmp_path, content))


def test_an_unreadable_file_is_refused_with_the_reason(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        load_goal(tmp_path / "nothing.json")
    (tmp_path / "binary.json").write_bytes(b"\xff\xfe\xfa")
    with pytest.raises(InputError, match="not a text file"):
        load_goal(tmp_path / "binary.json")


def test_a_goal_for_another_image_size_is_refused() -> None:
    with pytest.raises(InputError, match="640 x 480 pixels, but the camera gives 1280 x 720"):
        validate_goal(goal_of([[100, 200], [300, 200]]), (1280, 720))


def test_an_arc_passes_above_the_radius_limit_and_fails_below_it() -> None:
    limits = GoalLimits()
    for radius, good in ((1.2 * limits.min_radius, True), (0.8 * limits.min_radius, False)):
        angle = np.linspace(0.2, np.pi - 0.2, 60)
        arc = goal_of((np.array([320, 200]) + radius * np.column_stack([np.cos(angle), np.sin(angle)])).tolist())
        if good:
            validate_goal(arc)
        else:
            with pytest.raises(InputError, match=r"curves too tightly.*at least 40 px"):
                validate_goal(arc)


def test_a_hand_drawn_line_with_pixel_jitter_passes() -> None:
    rng = np.random.default_rng(3)
    u = np.arange(150.0, 480.0, 8.0)
    validate_goal(goal_of(np.column_stack([u, np.rint(240 + rng.uniform(-1, 1, len(u)))]).tolist()))


def test_a_goal_that_leaves_the_tissue_is_refused_and_one_on_it_passes() -> None:
    tissue = np.zeros((480, 640), dtype=bool)
    tissue[50:400, 50:500] = True
    validate_goal(goal_of([[100, 200], [300, 200]]), (640, 480), tissue)
    with pytest.raises(InputError, match=r"leaves the tissue near \(500, 200\)"):
        validate_goal(goal_of([[100, 200], [560, 200]]), (640, 480), tissue)
    with pytest.raises(InputError, match=r"grasp point .* is not on the tissue"):
        validate_goal(goal_of([[100, 200], [300, 200]], grasp=(320, 20)), (640, 480), tissue)
    tissue[200, 250] = False
    with pytest.raises(InputError, match="leaves the tissue"):
        validate_goal(goal_of([[100, 200], [300, 200]]), (640, 480), tissue)


@pytest.mark.parametrize(("grasp", "expected"), [((200.0, 100.0), (0.0, -1.0)), ((200.0, 300.0), (0.0, 1.0))])
def test_the_normal_points_to_the_grasp_whichever_way_the_goal_is_drawn(
    grasp: tuple[float, float], expected: tuple[float, float]
) -> None:
    for line in ([[100, 200], [300, 200]], [[300, 200], [100, 200]]):
        assert np.allclose(normal(goal_of(line, grasp)), expected)


@given(st.integers(2, 60), st.lists(st.tuples(st.floats(0, 600), st.floats(0, 400)), min_size=2, max_size=8))
def test_resampling_keeps_the_ends_and_never_lengthens(n: int, points: list[tuple[float, float]]) -> None:
    line = np.array(points)
    if arc_lengths(line)[-1] < 1e-3:
        return
    result = resample(line, n)
    assert result.shape == (n, 2)
    assert np.allclose(result[[0, -1]], line[[0, -1]])
    assert arc_lengths(result)[-1] <= arc_lengths(line)[-1] + 1e-6
