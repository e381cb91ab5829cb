"""Segments lifted to 3D: on the tissue that still holds, and not on rims that a pull has lifted."""

import numpy as np
import pytest

from hardware.interface import CameraModel
from skills.dissect.path import Path, held_part, on_tissue
from skills.scene.stereo import DepthMap
from skills.tracking.tracks import TrackedGoal

CAMERA = CameraModel(640, 480, 600.0, 320.0, 240.0, 5e-3)
SURFACE = 0.08  # [m], where the tissue lies
OPEN = slice(200, 320)  # [px], columns where the cut has opened: the bed shows, and the near rim is lifted
WHOLE = np.array([[0.0, 0.0], [1.0, 0.0]])


def goal() -> TrackedGoal:
    """240 px along u; where it is open the near row is pulled far up."""
    u = np.linspace(200, 440, 31)
    line = np.column_stack([u, np.full(31, 240.0)])
    aside = np.array([0.0, 18.0])
    near, far = line - aside, line + aside
    near[u < OPEN.stop, 1] -= 60.0
    return TrackedGoal(0.0, (near + far) / 2, near, far, np.ones(31, bool), np.array([320.0, 150.0]), True, False, float("nan"))


def scene() -> tuple[DepthMap, np.ndarray]:
    depth = np.full((480, 640), SURFACE)
    depth[:235, OPEN] = SURFACE - 0.012
    tissue = np.ones((480, 640), dtype=bool)
    tissue[180:258, OPEN] = False
    return DepthMap(0.0, depth, 1.0), tissue


def test_a_corrective_segment_lies_on_the_tissue_that_holds():
    path = on_tissue(goal(), scene()[0], CAMERA, WHOLE, scene()[1])

    assert path is not None
    assert path.points[:, 2] == pytest.approx(np.full(25, SURFACE), abs=1e-6)
    _, tangent, normal = path.frame_at(0.7 * path.length, 4e-3)
    assert tangent == pytest.approx([1.0, 0.0, 0.0], abs=0.02)
    assert normal == pytest.approx([0.0, 0.0, -1.0], abs=1e-3)


def tilted_towards_one_end(step: float) -> DepthMap:
    """A flat surface, and a `step` [m] in its depth in the middle of a short segment from 350 px to 362 px."""
    depth = np.full((480, 640), SURFACE)
    depth[:, 357:] -= step
    depth[:, 369:] += step
    return DepthMap(0.0, depth, 1.0)


def test_a_few_wrong_depths_hardly_tilt_the_normal_of_a_short_segment():
    short = (np.array([[350.0], [362.0]]) - 200.0) / 240.0 * np.array([1.0, 0.0])

    path = on_tissue(goal(), tilted_towards_one_end(0.6e-3), CAMERA, short, scene()[1])

    assert path is not None
    _, _, normal = path.frame_at(path.length / 2, 2e-3)
    assert np.degrees(np.arccos(-normal[2])) < 10.0
    assert path.pixels[[0, -1], 0] == pytest.approx([350.0, 362.0])
    assert path.length == pytest.approx(12.0 * SURFACE / CAMERA.focal, rel=0.1)


def test_what_lies_past_the_goals_end_does_not_bend_its_last_segment():
    depth = np.full((480, 640), SURFACE)
    depth[:, 446:] += np.linspace(0.0, 6e-3, 194)  # whole tissue, that is bent towards what still holds
    last = np.array([[0.95, 0.0], [1.0, 0.0]])

    path = on_tissue(goal(), DepthMap(0.0, depth, 1.0), CAMERA, last, scene()[1])

    assert path is not None
    assert path.points[:, 2] == pytest.approx(np.full(25, SURFACE), abs=0.05e-3)


def test_a_web_that_hangs_lower_than_what_is_around_is_cut_where_it_hangs():
    depth = np.full((480, 640), SURFACE)
    depth[:, 390:412] += 2e-3
    web = (np.array([[394.0], [408.0]]) - 200.0) / 240.0 * np.array([1.0, 0.0])

    path = on_tissue(goal(), DepthMap(0.0, depth, 1.0), CAMERA, web, scene()[1])

    assert path is not None
    assert path.points[12, 2] == pytest.approx(SURFACE + 2e-3, abs=0.3e-3)


def test_a_part_of_a_path_keeps_its_course():
    x = np.linspace(0.0, 0.04, 25)
    points = np.column_stack([x, np.zeros(25), np.full(25, SURFACE)])
    whole = Path(points, np.tile([0.0, -1.0, 0.0], (25, 1)), np.column_stack([x * 1e4, x]), x)

    part = whole.part(0.25, 0.75)

    assert len(part.points) == 25
    assert part.points[[0, -1], 0] == pytest.approx([0.01, 0.03])
    assert part.pixels[[0, -1], 0] == pytest.approx([100.0, 300.0])
    assert part.arc[[0, -1]] == pytest.approx([0.0, 0.02])


def test_where_no_tissue_is_seen_there_is_no_such_path():
    depth, tissue = scene()

    assert on_tissue(goal(), depth, CAMERA, WHOLE, np.zeros_like(tissue)) is None


def test_only_the_part_that_holds_is_cut_and_a_little_of_what_is_open():
    depth, tissue = scene()

    part = held_part(goal(), depth, CAMERA, WHOLE, tissue)

    assert 240.0 * part[:, 0] + 200.0 == pytest.approx([OPEN.stop - 10.0, 440.0], abs=10.0)


def test_a_segment_of_which_no_tissue_is_seen_is_left_as_it_is():
    depth, tissue = scene()

    assert held_part(goal(), depth, CAMERA, WHOLE, np.zeros_like(tissue)).tolist() == WHOLE.tolist()


def test_places_outside_the_image_hold_nothing():
    depth, tissue = scene()
    beyond = np.array([[0.5, 0.0], [2.5, 0.0]])

    part = held_part(goal(), depth, CAMERA, beyond, tissue)

    assert part[0] == pytest.approx(beyond[0])
    assert 1.6 < part[1, 0] < 2.0
