from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hardware.interface import Array, CameraModel
from skills.expose.region import RegionConfig, region_around
from skills.scene.polyline import arc_lengths, at_length, directions
from skills.scene.surface import Surface
from skills.tracking.model_based import model_tracked_pixels, track

CAMERA = CameraModel(width=640, height=480, focal=600.0, cu=319.5, cv=239.5, baseline=5e-3)
DEPTH = 0.075  # [m], where 8 px are 1 mm
LENGTH = 160.0  # [px]


def straight_goal(angle: float = 0.0, centre: tuple[float, float] = (319.5, 239.5)) -> Array:
    """Make a goal (9, 2) of LENGTH px whose left normal, its near side, points down the image when `angle` is 0."""
    along = np.array([np.cos(angle), np.sin(angle)])
    return np.asarray(np.array(centre) + np.linspace(-LENGTH / 2, LENGTH / 2, 9)[:, None] * along)


def bent_goal(radius: float, turn: float) -> Array:
    """Make a goal that turns by `turn` [rad] on a circle of `radius` [px]; its left normal, the near side, points inwards."""
    t = np.linspace(-turn / 2, turn / 2, 41)
    return np.column_stack([319.5 + radius * np.sin(t), 239.5 - radius * np.cos(t) + radius])


def surface_along(polyline: Array, tilt: float = 0.0) -> Surface:
    """Make a plane mesh that follows `polyline`, near on its left, tilted by `tilt` [rad] about the image's horizontal at its middle."""
    length = float(arc_lengths(polyline)[-1])
    stations = np.concatenate([[-70.0, -35.0], np.linspace(0.0, length, 9), [length + 35.0, length + 70.0]])
    laterals = np.arange(-5, 6) * 14.0
    line = at_length(polyline, stations)
    ends = directions(polyline)
    line += np.minimum(stations, 0.0)[:, None] * ends[0] + np.maximum(stations - length, 0.0)[:, None] * ends[-1]
    along = directions(line)
    normal = np.column_stack([-along[:, 1], along[:, 0]])
    pixels = (line[None] + laterals[:, None, None] * normal[None]).reshape(-1, 2)
    rays = CAMERA.unproject(pixels, np.ones(len(pixels)))
    plane = np.array([0.0, -np.sin(tilt), np.cos(tilt)])
    vertices = rays * (DEPTH * np.cos(tilt) / (rays @ plane))[:, None]
    index = np.arange(len(pixels)).reshape(len(laterals), len(stations))
    a, b, c, d = (q.ravel() for q in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    border = np.ones(index.shape, bool)
    border[1:-1, 1:-1] = False
    return Surface(
        stamp=0.0,
        vertices=vertices,
        triangles=np.concatenate([np.stack([a, c, b], 1), np.stack([a, d, c], 1)]).astype(np.int32),
        pixels=pixels,
        station=np.tile(stations, len(laterals)),
        lateral=np.repeat(laterals, len(stations)),
        border=border.ravel(),
        measured=np.ones(len(pixels), bool),
        goal_length=length,
    )


def grasp_at(u: float, v: float) -> Array:
    """Make a grasp [m] on the untilted surface at the pixel (u, v)."""
    return CAMERA.unproject(np.array([u, v]), np.array(DEPTH))


NEAR = grasp_at(319.5, 239.5 + 150.0)  # too far from the goal to exclude a pixel
FAR = grasp_at(319.5, 239.5 - 150.0)


def test_rows_lie_at_half_offsets_across_the_goal_and_columns_at_the_middle_of_equal_parts_of_it():
    region = region_around(straight_goal(), NEAR, surface_along(straight_goal()), CAMERA)

    assert region.shape == (8, 13)  # 10 mm in 8 rows, 20 mm at about 1.5 mm
    np.testing.assert_allclose(region.lateral, [-35, -25, -15, -5, 5, 15, 25, 35])
    np.testing.assert_allclose(region.station, (np.arange(13) + 0.5) * LENGTH / 13)
    np.testing.assert_allclose(region.spacing, (10.0, LENGTH / 13))
    assert region.used.all()


@pytest.mark.parametrize("angle", [0.0, 0.7, 2.5, -1.6])
@pytest.mark.parametrize(("grasp", "side"), [(1.0, 1.0), (-1.0, -1.0)])
def test_the_normal_points_to_the_side_of_the_grasp(angle, grasp, side):
    goal = straight_goal(angle)
    left = np.array([-np.sin(angle), np.cos(angle)])
    region = region_around(goal, grasp_at(*(goal.mean(0) + grasp * 120.0 * left)), surface_along(goal), CAMERA)

    np.testing.assert_allclose(region.normal, np.tile(side * left, (13, 1)), atol=1e-9)
    np.testing.assert_allclose(region.tangent, np.tile([np.cos(angle), np.sin(angle)], (13, 1)), atol=1e-9)
    across = region.pixels.reshape(8, 13, 2) - region.origin
    np.testing.assert_allclose((across * region.normal).sum(-1), np.tile(region.lateral[:, None], (1, 13)), atol=1e-9)


def test_the_points_are_seen_at_the_lattice_s_pixels():
    goal, tilted = straight_goal(0.4), surface_along(straight_goal(0.4), tilt=0.4)
    region = region_around(goal, NEAR, tilted, CAMERA)

    seen = model_tracked_pixels(region.points, tilted.vertices, tilted.triangles, CAMERA)

    assert region.points.on_mesh.all()
    np.testing.assert_allclose(seen, region.pixels, atol=1e-6)


def test_pixels_within_four_millimetres_of_the_grasp_are_excluded_and_no_others():
    goal, surface = straight_goal(), surface_along(straight_goal())
    grasp = grasp_at(330.0, 239.5 + 30.0)
    region = region_around(goal, grasp, surface, CAMERA)

    distance = np.linalg.norm(track(region.points, surface.vertices, surface.triangles) - grasp, axis=1).reshape(region.shape)

    assert 0 < (~region.used).sum() < region.used.size / 2
    np.testing.assert_array_equal(region.used, distance > 4e-3)


def test_pixels_off_the_mesh_are_unused():
    goal, surface = straight_goal(), surface_along(straight_goal())
    corner = surface.vertices[surface.triangles].mean(axis=1)[:, 0]
    half = replace(surface, triangles=surface.triangles[corner < 0])  # nothing on the right half
    region = region_around(goal, NEAR, half, CAMERA)

    left = region.origin[:, 0] < 319.5 - 20.0
    assert region.used[:, left].all()
    assert not region.used[:, region.origin[:, 0] > 319.5 + 20.0].any()
    np.testing.assert_array_equal(region.used.ravel(), region.points.on_mesh)


def test_pixels_outside_the_image_are_unused():
    goal = straight_goal(centre=(319.5, 20.0))
    region = region_around(goal, NEAR, surface_along(goal), CAMERA)

    outside = region.pixels[:, 1].reshape(region.shape) < 0
    assert outside.any()
    np.testing.assert_array_equal(region.used, ~outside)


def test_the_frame_follows_a_bent_goal():
    goal = bent_goal(radius=120.0, turn=1.2)
    region = region_around(goal, NEAR, surface_along(goal), CAMERA)

    inwards = np.array([319.5, 239.5 + 120.0]) - region.origin
    inwards /= np.linalg.norm(inwards, axis=1, keepdims=True)
    np.testing.assert_allclose((region.normal * inwards).sum(1), 1.0, atol=1e-3)
    np.testing.assert_allclose((region.normal * region.tangent).sum(1), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(region.tangent, axis=1), 1.0)
    assert region.used.all()


def test_pixels_that_a_tight_bend_brings_to_another_part_of_the_goal_are_unused():
    corner = np.array([[249.5, 169.5], [319.5, 239.5], [389.5, 169.5]])  # turns by 90 degrees, the grasp inside
    region = region_around(corner, grasp_at(319.5, 60.0), surface_along(straight_goal()), CAMERA)

    middle = np.argsort(np.abs(region.station - arc_lengths(corner)[-1] / 2))[:2]
    assert not region.used[-1, middle].any()
    assert region.used[4, 3]


def test_the_size_is_in_millimetres_at_the_depth_of_the_goal():
    goal, surface = straight_goal(), surface_along(straight_goal())
    deeper = replace(surface, vertices=surface.vertices * 2.0)  # the same picture, twice as far
    region = region_around(goal, 2.0 * NEAR, deeper, CAMERA, RegionConfig(band=6e-3, rows=4, column_spacing=2e-3))

    assert region.shape == (4, 20)  # 40 mm
    np.testing.assert_allclose(region.lateral, [-18, -6, 6, 18])


@pytest.mark.parametrize(
    "wrong", [{"rows": 7}, {"rows": 0}, {"band": 0.0}, {"column_spacing": -1e-3}, {"exclusion": float("nan")}]
)
def test_a_lattice_that_cannot_be_laid_is_refused(wrong):
    with pytest.raises(ValueError):
        RegionConfig(**wrong)


@pytest.mark.parametrize(
    ("goal", "grasp"),
    [
        (np.zeros((1, 2)), NEAR),
        (np.full((3, 2), 100.0), NEAR),
        (np.array([[0.0, 0.0], [np.nan, 1.0]]), NEAR),
        (np.array([[100.0, 100.0], [200.0, 100.0], [100.0, 100.0]]), NEAR),
        (straight_goal(), np.array([100.0, 100.0])),
        (straight_goal(), np.array([0.0, 0.0, -0.1])),
    ],
)
def test_a_malformed_goal_or_grasp_is_refused(goal, grasp):
    with pytest.raises(ValueError):
        region_around(goal, grasp, surface_along(straight_goal()), CAMERA)


def test_a_surface_without_the_goal_is_refused():
    surface = surface_along(straight_goal())
    with pytest.raises(ValueError, match="no vertex on the goal"):
        region_around(straight_goal(), NEAR, replace(surface, lateral=surface.lateral + 1.0), CAMERA)
