"""The model-based tracker against a search through all triangles written in NumPy, and against motions whose picture is known."""

import numpy as np
import pytest
from numpy.typing import NDArray

from hardware.interface import Array, CameraModel
from skills.tracking.model_based import SurfacePoints, model_tracked_pixels, raycast, track

CAMERA = CameraModel(width=640, height=480, focal=600.0, cu=319.5, cv=239.5, baseline=0.0044)


def sheet(rows: int = 9, columns: int = 13, depth: float = 0.075) -> tuple[Array, NDArray[np.int32]]:
    """A wavy, tilted sheet seen between pixels (120, 90) and (520, 390): vertices (V, 3) [m] and triangles facing the camera."""
    u, v = np.meshgrid(np.linspace(120, 520, columns), np.linspace(90, 390, rows))
    z = depth * (1 + 0.08 * np.sin(u / 60) * np.cos(v / 50) + 2e-4 * (v - 240))
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = (q.ravel() for q in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    triangles = np.concatenate([np.column_stack([a, c, b]), np.column_stack([a, d, c])]).astype(np.int32)
    return CAMERA.unproject(np.column_stack([u.ravel(), v.ravel()]), z.ravel()), triangles


def moller_trumbore(pixels: Array, vertices: Array, triangles: NDArray[np.int32]) -> tuple[NDArray[np.int64], Array]:
    """Nearest triangle (N,) on each pixel's ray, -1 for none, and its distance (N,), by trying them all; both faces count."""
    rays = CAMERA.unproject(pixels, np.ones(len(pixels)))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    v0 = vertices[triangles[:, 0]]
    e1, e2 = vertices[triangles[:, 1]] - v0, vertices[triangles[:, 2]] - v0
    h = np.cross(rays[:, None], e2[None])
    det = (h * e1).sum(-1)
    s = -v0
    u = (h * s).sum(-1) / det
    q = np.cross(s, e1)
    v = rays @ q.T / det
    t = (e2 * q).sum(-1) / det
    hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)
    t = np.where(hit, t, np.inf)
    nearest = np.argmin(t, axis=1)
    distance = t[np.arange(len(t)), nearest]
    return np.where(np.isfinite(distance), nearest, -1), distance


def scattered(count: int, low: tuple[float, float], high: tuple[float, float], seed: int = 0) -> Array:
    return np.random.default_rng(seed).uniform(low, high, (count, 2))


def rotation(axis: Array, angle: float) -> Array:
    k = np.asarray(axis) / np.linalg.norm(axis)
    K = np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def test_raycasting_agrees_with_a_search_through_all_triangles():
    vertices, triangles = sheet()
    # A second sheet in front of part of the first, at an angle to it.
    front = (vertices - vertices.mean(axis=0)) @ rotation(np.array([0.2, 1.0, 0.1]), 0.3).T * 0.5 + (0.004, 0.002, 0.065)
    both = np.vstack([vertices, front])
    faces = np.vstack([triangles, triangles + len(vertices)]).astype(np.int32)
    pixels = scattered(3000, (60, 40), (580, 440))

    points = raycast(pixels, both, faces, CAMERA)

    expected, distance = moller_trumbore(pixels, both, faces)
    assert np.array_equal(points.triangle, expected)
    assert (expected >= len(triangles)).sum() > 200 and (expected < 0).sum() > 200
    on = points.on_mesh
    assert np.linalg.norm(track(points, both, faces)[on], axis=1) == pytest.approx(distance[on], rel=1e-9)


def test_a_pixel_comes_back_to_itself():
    vertices, triangles = sheet()
    pixels = scattered(2000, (125, 95), (515, 385))

    points = raycast(pixels, vertices, triangles, CAMERA)

    assert points.on_mesh.all()
    assert np.abs(model_tracked_pixels(points, vertices, triangles, CAMERA) - pixels).max() < 1e-3


def test_barycentric_coordinates_are_not_negative_and_sum_to_one():
    vertices, triangles = sheet()
    points = raycast(scattered(500, (125, 95), (515, 385)), vertices, triangles, CAMERA)

    assert (points.barycentric >= 0).all()
    assert points.barycentric.sum(axis=1) == pytest.approx(1.0)


def test_pixels_on_inner_vertices_and_edges_are_on_the_mesh():
    vertices, triangles = sheet()
    index = np.arange(9 * 13).reshape(9, 13)
    inner = CAMERA.project(vertices[index[1:-1, 1:-1].ravel()])
    edges = CAMERA.project((vertices[index[1:-1, 1:-2].ravel()] + vertices[index[1:-1, 2:-1].ravel()]) / 2)
    pixels = np.vstack([inner, edges])

    points = raycast(pixels, vertices, triangles, CAMERA)

    assert points.on_mesh.all()
    assert np.abs(model_tracked_pixels(points, vertices, triangles, CAMERA) - pixels).max() < 1e-3


def test_a_translated_mesh_takes_its_points_with_it():
    vertices, triangles = sheet()
    pixels = scattered(200, (125, 95), (515, 385))
    points = raycast(pixels, vertices, triangles, CAMERA)
    shift = np.array([0.003, -0.005, 0.010])

    seen = model_tracked_pixels(points, vertices + shift, triangles, CAMERA)

    expected = CAMERA.project(track(points, vertices, triangles) + shift)
    assert np.abs(seen - expected).max() < 1e-9


def test_a_rotated_mesh_takes_its_points_with_it():
    vertices, triangles = sheet()
    points = raycast(scattered(200, (125, 95), (515, 385)), vertices, triangles, CAMERA)
    turn, centre = rotation(np.array([1.0, 0.4, -0.3]), 0.5), vertices.mean(axis=0)

    moved = track(points, (vertices - centre) @ turn.T + centre, triangles)

    assert np.abs(moved - ((track(points, vertices, triangles) - centre) @ turn.T + centre)).max() < 1e-12


def test_a_stretched_mesh_moves_a_point_by_the_share_of_its_corners():
    vertices, triangles = sheet()
    points = raycast(np.array([[300.0, 200.0]]), vertices, triangles, CAMERA)
    corners = triangles[points.triangle[0]]
    moved = vertices.copy()
    moved[corners[1]] += (0.0, 0.0, 0.004)

    lift = track(points, moved, triangles) - track(points, vertices, triangles)

    assert lift[0] == pytest.approx([0.0, 0.0, 0.004 * points.barycentric[0, 1]])


def test_leading_dimensions_are_kept_and_each_state_is_its_own():
    vertices, triangles = sheet()
    pixels = scattered(50, (100, 70), (540, 410))
    points = raycast(pixels, vertices, triangles, CAMERA)
    shifts = np.random.default_rng(1).normal(0.0, 1e-3, (4, 3, 1, 3))

    seen = model_tracked_pixels(points, vertices + shifts, triangles, CAMERA)

    assert seen.shape == (4, 3, 50, 2)
    one = model_tracked_pixels(points, vertices + shifts[2, 1], triangles, CAMERA)
    assert np.array_equal(seen[2, 1], one, equal_nan=True)


def test_rays_that_miss_are_off_the_mesh_and_stay_unknown():
    vertices, triangles = sheet()
    pixels = np.array([[20.0, 20.0], [300.0, 200.0], [630.0, 470.0], [np.nan, 200.0], [np.inf, 1.0]])

    points = raycast(pixels, vertices, triangles, CAMERA)

    assert (points.triangle[[0, 2, 3, 4]] == -1).all() and points.triangle[1] >= 0
    assert np.isnan(points.barycentric[[0, 2, 3, 4]]).all()
    seen = model_tracked_pixels(points, vertices, triangles, CAMERA)
    assert np.array_equal(np.isnan(seen).all(axis=1), ~points.on_mesh)
    assert np.array_equal(points.on_mesh, [False, True, False, False, False])


def test_of_two_layers_the_nearer_is_taken():
    vertices, triangles = sheet()
    both = np.vstack([vertices, vertices * 0.8])
    faces = np.vstack([triangles, triangles + len(vertices)]).astype(np.int32)

    points = raycast(scattered(300, (125, 95), (515, 385)), both, faces, CAMERA)

    assert (points.triangle >= len(triangles)).all()


def test_a_surface_seen_from_behind_is_off_the_mesh_even_where_another_lies_below():
    vertices, triangles = sheet()
    both = np.vstack([vertices, vertices * 0.8])
    faces = np.vstack([triangles, (triangles + len(vertices))[:, ::-1]]).astype(np.int32)

    points = raycast(scattered(300, (125, 95), (515, 385)), both, faces, CAMERA)

    assert (points.triangle == -1).all()


def test_a_mesh_behind_the_camera_is_not_hit_and_a_point_that_goes_there_has_no_pixel():
    vertices, triangles = sheet()
    pixels = scattered(20, (125, 95), (515, 385))
    points = raycast(pixels, vertices, triangles, CAMERA)

    assert np.isnan(model_tracked_pixels(points, vertices - (0.0, 0.0, 0.2), triangles, CAMERA)).all()
    assert (raycast(pixels, vertices - (0.0, 0.0, 0.2), triangles, CAMERA).triangle == -1).all()


def test_nothing_to_look_at_and_nothing_to_look_for_are_allowed():
    vertices, triangles = sheet()

    assert (raycast(np.array([[300.0, 200.0]]), vertices, triangles[:0], CAMERA).triangle == -1).all()
    assert model_tracked_pixels(raycast(np.zeros((0, 2)), vertices, triangles, CAMERA), vertices, triangles, CAMERA).shape == (
        0,
        2,
    )


def test_the_same_rays_give_the_same_points():
    vertices, triangles = sheet()
    pixels = scattered(500, (100, 70), (540, 410))

    one, two = raycast(pixels, vertices, triangles, CAMERA), raycast(pixels, vertices, triangles, CAMERA)

    assert np.array_equal(one.triangle, two.triangle)
    assert np.array_equal(one.barycentric, two.barycentric, equal_nan=True)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"pixels": np.zeros((4, 3))}, "pixels must be"),
        ({"vertices": np.zeros((4, 2))}, "vertices must be"),
        ({"vertices": np.full((200, 3), np.nan)}, "vertices must be"),
        ({"triangles": np.zeros((4, 3))}, "triangles must be"),
        ({"triangles": np.array([[0, 1, 999]], np.int32)}, "triangles must name vertices 0 to 116"),
    ],
)
def test_malformed_arguments_are_an_error(change, words):
    vertices, triangles = sheet()
    given = {"pixels": np.zeros((1, 2)), "vertices": vertices, "triangles": triangles} | change

    with pytest.raises(ValueError, match=words):
        raycast(given["pixels"], given["vertices"], given["triangles"], CAMERA)


def test_tracking_on_too_few_vertices_is_an_error():
    vertices, triangles = sheet()
    points = SurfacePoints(np.array([len(triangles) - 1], np.int32), np.full((1, 3), 1 / 3))

    with pytest.raises(ValueError, match="there are only 10 vertices"):
        track(points, vertices[:10], triangles)
    with pytest.raises(ValueError, match="positions must end in"):
        track(points, vertices[:, :2], triangles)
