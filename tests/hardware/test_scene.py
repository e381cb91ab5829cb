"""Scenes load, and bad ones are refused with one sentence that says what would be right."""

import numpy as np
import pytest

from hardware.codes import InputError
from hardware.stub.scene import load_scene, scene_names


def test_every_scene_that_comes_with_the_program_loads():
    assert {"silicone", "chicken", "beef", "curved", "long"} <= set(scene_names())
    for name in scene_names():
        assert load_scene(name).name == name


@pytest.mark.parametrize("name", scene_names())
def test_the_goal_of_every_scene_lies_inside_the_image(name):
    scene = load_scene(name)
    rotation, translation = scene.camera_from_table()
    points = np.column_stack([np.vstack([scene.line, scene.goal.grasp]), np.zeros(len(scene.line) + 1)])
    pixels = scene.camera_model().project(points @ rotation.T + translation)

    assert (pixels > 20).all() and (pixels < [620, 460]).all()


def test_the_long_goal_is_76_mm():
    assert np.linalg.norm(np.diff(load_scene("long").line, axis=0), axis=1).sum() == pytest.approx(0.076)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("tissu = 3", "did you mean 'tissue'"),
        ("[tissue]\nwidht = 0.08", "did you mean 'width'"),
        ("[tissue]\nwidth = nan", "finite number"),
        ("[tissue]\nwidth = 3.0", "between 0.03 and 0.2"),
        ("[tissue]\nmaterial = 'steel'", "silicone, chicken, beef"),
        ("[goal]\nline = [[0.0, 0.0], [0.5, 0.0]]", "off the sheet"),
        ("[goal]\nline = [[0.0, 0.0]]", "at least two points"),
        ("[[", "cannot be read"),
    ],
)
def test_a_bad_scene_file_gets_one_clear_sentence(tmp_path, text, sentence):
    path = tmp_path / "mine.toml"
    path.write_text(text)

    with pytest.raises(InputError, match=sentence):
        load_scene(str(path))


def test_an_unknown_scene_names_the_nearest_one():
    with pytest.raises(InputError, match="did you mean chicken"):
        load_scene("chiken")
