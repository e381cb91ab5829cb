"""Depth from stereo on a textured plane whose depth is known."""

import numpy as np
import pytest

from hardware.interface import CameraModel, StereoFrame
from skills.scene.stereo import (
    DepthMap,
    StereoConfig,
    depth_at,
    depth_from_stereo,
    disparity_range,
    region_around,
    surface_normal_at,
)
from tests.skills.pictures import frame, plane_pair

CAMERA = CameraModel(width=400, height=240, focal=620.0, cu=199.5, cv=119.5, baseline=0.0043)
NORMAL = np.array([0.2, -0.4, -1.0]) / np.linalg.norm([0.2, -0.4, -1.0])


@pytest.fixture(scope="module")
def pair() -> tuple[StereoFrame, np.ndarray]:
    return plane_pair(CAMERA, NORMAL, 0.080)


def test_median_depth_error_on_a_slanted_plane_is_under_a_fifth_of_a_millimetre(pair: tuple[StereoFrame, np.ndarray]) -> None:
    depth_map = depth_from_stereo(pair[0], CAMERA)
    error = np.abs(depth_map.depth - pair[1])
    assert np.nanmedian(error) < 0.2e-3
    assert depth_map.valid_fraction > 0.8
    assert depth_map.stamp == pair[0].left.stamp


def test_refinement_removes_most_of_the_matchers_error(pair: tuple[StereoFrame, np.ndarray]) -> None:
    raw = np.nanmedian(np.abs(depth_from_stereo(pair[0], CAMERA, StereoConfig(refine_window=0)).depth - pair[1]))
    fine = np.nanmedian(np.abs(depth_from_stereo(pair[0], CAMERA).depth - pair[1]))
    assert fine < 0.5 * raw


def test_a_region_gives_the_depth_there_and_nan_elsewhere(pair: tuple[StereoFrame, np.ndarray]) -> None:
    region = (180, 80, 320, 160)
    depth_map = depth_from_stereo(pair[0], CAMERA, region=region)
    inside = np.zeros_like(depth_map.depth, dtype=bool)
    inside[80:160, 180:320] = True
    assert np.isnan(depth_map.depth[~inside]).all()
    assert np.nanmedian(np.abs(depth_map.depth - pair[1])) < 0.2e-3
    assert depth_map.valid_fraction == pytest.approx(np.isfinite(depth_map.depth[inside]).mean())
    assert depth_map.valid_fraction > 0.95


def test_images_without_texture_have_no_depth() -> None:
    flat = np.full((CAMERA.height, CAMERA.width, 3), 120, np.uint8)
    assert depth_from_stereo(StereoFrame(frame(flat, 1), flat), CAMERA).valid_fraction < 0.05


def test_the_disparity_range_spans_the_working_distance() -> None:
    least, number = disparity_range(CAMERA, StereoConfig())
    fb = CAMERA.focal * CAMERA.baseline
    assert least <= fb / 0.130
    assert least + number - 1 >= fb / 0.045
    assert number % 16 == 0


def test_an_image_of_another_size_is_a_programming_error() -> None:
    small = np.zeros((10, 10, 3), np.uint8)
    with pytest.raises(ValueError, match="camera's size"):
        depth_from_stereo(StereoFrame(frame(small, 1), small), CAMERA)


def test_depth_at_is_a_median_that_ignores_outliers_and_unknowns() -> None:
    depth = np.full((40, 50), 0.08)
    depth[20, 20] = 0.5
    depth[18:22, 21:23] = np.nan
    values = depth_at(DepthMap(0.0, depth, 1.0), np.array([[20.0, 20.0], [0.0, 0.0], [60.0, 5.0], [np.nan, 3.0]]))
    assert values[:1] == pytest.approx([0.08])
    assert np.isnan(values[1:]).tolist() == [False, True, True] or values[1] == pytest.approx(0.08)


def test_depth_at_is_nan_where_too_little_is_known() -> None:
    depth = np.full((40, 50), np.nan)
    depth[20, 20] = 0.08
    assert np.isnan(depth_at(DepthMap(0.0, depth, 0.0), np.array([[20.0, 20.0]]))).all()


def test_the_fitted_normal_is_the_planes_and_faces_the_camera(pair: tuple[StereoFrame, np.ndarray]) -> None:
    fitted = surface_normal_at(depth_from_stereo(pair[0], CAMERA), CAMERA, np.array([230.0, 120.0]))
    assert np.degrees(np.arccos(np.clip(fitted @ NORMAL, -1, 1))) < 4.0
    assert fitted[2] < 0


def test_the_normal_survives_a_third_of_outliers() -> None:
    depth = np.full((60, 60), 0.08)
    depth[:, 40:] = 0.11
    camera = CameraModel(60, 60, 620.0, 29.5, 29.5, 0.0043)
    fitted = surface_normal_at(DepthMap(0.0, depth, 1.0), camera, np.array([32.0, 30.0]))
    assert fitted == pytest.approx([0, 0, -1], abs=0.05)


def test_the_normal_of_unknown_depth_is_nan() -> None:
    nothing = DepthMap(0.0, np.full((60, 60), np.nan), 0.0)
    camera = CameraModel(60, 60, 620.0, 29.5, 29.5, 0.0043)
    assert np.isnan(surface_normal_at(nothing, camera, np.array([30.0, 30.0]))).all()
    assert np.isnan(surface_normal_at(nothing, camera, np.array([np.nan, 30.0]))).all()


def test_a_region_around_points_stays_inside_the_image() -> None:
    assert region_around(np.array([[5.0, 5.0], [100.2, 50.0]]), 20.0, (110, 60)) == (0, 0, 110, 60)
