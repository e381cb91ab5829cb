"""The surface mesh on depth maps whose truth is a formula: accuracy, holes, what the mesh covers, every refusal."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware.codes import Code
from hardware.interface import Array, CameraModel
from skills.scene.depth_fit import FitConfig
from skills.scene.segments import distances
from skills.scene.stereo import DepthMap
from skills.scene.surface import Surface, SurfaceConfig, reconstruct
from skills.scene.tissue import tissue_outline
from skills.scene.triangles import edges_of, piece_with

CAMERA = CameraModel(width=640, height=480, focal=600.0, cu=319.5, cv=239.5, baseline=0.0044)
FB = CAMERA.focal * CAMERA.baseline
U, V = np.meshgrid(np.arange(640.0), np.arange(480.0))
EVERYWHERE = np.ones((480, 640), bool)
NOWHERE = np.zeros((480, 640), bool)
STRAIGHT = np.array([[170.0, 240.0], [320.0, 240.0], [470.0, 240.0]])
ARC = np.column_stack([np.linspace(180, 460, 15), 260.0 - 40.0 * np.sin(np.linspace(0, np.pi, 15))])
CORNER = np.array([[220.0, 160.0], [320.0, 160.0], [420.0, 160.0], [420.0, 250.0], [420.0, 340.0]])
GRASP = np.array([320.0, 165.0])
AWAY = np.array([100.0, 150.0])


def plane(u: Array, v: Array) -> Array:
    """25 degrees to the line of sight, 75 mm away."""
    x, y = (u - CAMERA.cu) / CAMERA.focal, (v - CAMERA.cv) / CAMERA.focal
    return 0.075 / (1.0 + 0.15 * x - 0.45 * y)


def mound(u: Array, v: Array) -> Array:
    """A paraboloid: 3 mm nearer at the middle than 25 mm from it."""
    r2 = ((u - 320) ** 2 + (v - 240) ** 2) / 200.0**2
    return 0.075 + 0.003 * r2


def look(
    shape: Callable[[Array, Array], Array] = plane,
    depth: Array | None = None,
    tissue: Array = EVERYWHERE,
    tools: Array = NOWHERE,
    polyline: Array = STRAIGHT,
    grasp: Array = GRASP,
    config: SurfaceConfig | None = None,
):
    image = shape(U, V) if depth is None else depth
    return reconstruct(DepthMap(3.0, image, 1.0), CAMERA, tissue, tools, polyline, grasp, config)


def seen(**given) -> Surface:
    outcome = look(**given)
    assert outcome.code is Code.OK, outcome.message
    assert outcome.surface is not None
    return outcome.surface


def errors(surface: Surface, shape: Callable[[Array, Array], Array]) -> Array:
    """Depth errors (V,) [mm]."""
    return 1e3 * np.abs(surface.vertices[:, 2] - shape(*surface.pixels.T))


def on_goal(surface: Surface) -> Array:
    return (surface.lateral == 0) & (surface.station > -1e-6) & (surface.station < surface.goal_length + 1e-6)


def box(u0: float, u1: float, v0: float, v1: float) -> Array:
    return (np.abs(U - (u0 + u1) / 2) <= (u1 - u0) / 2) & (np.abs(V - (v0 + v1) / 2) <= (v1 - v0) / 2)


def samples(surface: Surface) -> Array:
    """Pixels on every triangle, edges and corners included."""
    i, j = np.meshgrid(np.arange(9), np.arange(9))
    i, j = i[i + j <= 8] / 8, j[i + j <= 8] / 8
    return np.einsum("sk,fkc->fsc", np.column_stack([i, j, 1 - i - j]), surface.pixels[surface.triangles]).reshape(-1, 2)


# ---------------------------------------------------------------- accuracy


@pytest.mark.parametrize("goal", [STRAIGHT, ARC, CORNER], ids=["straight", "arc", "corner"])
def test_a_plane_is_found_exactly_whatever_the_goals_shape(goal):
    surface = seen(polyline=goal)

    assert errors(surface, plane).max() < 1e-3
    assert surface.measured.all()
    assert surface.stamp == 3.0


def test_a_mound_is_found_within_a_twentieth_of_a_millimetre():
    assert errors(seen(shape=mound), mound).max() < 0.05


def test_an_opening_along_the_goal_is_bridged_from_its_lips():
    opening = box(190, 450, 225, 255)
    bed = np.where(opening, 0.083, mound(U, V))

    surface = seen(depth=bed, tissue=~opening)

    bridged = on_goal(surface) & (np.abs(surface.pixels[:, 0] - 320) < 110)
    assert errors(surface, mound).max() < 0.15
    assert bridged.sum() > 10
    assert not surface.measured[bridged].any()
    assert surface.measured[np.abs(surface.lateral) > 40].all()


def test_a_hole_in_the_depth_is_filled_and_marked_as_not_measured():
    hole = box(230, 300, 280, 350)

    surface = seen(depth=np.where(hole, np.nan, mound(U, V)))

    within = (np.abs(surface.pixels - (265, 315)) < 15).all(axis=1)
    assert within.sum() >= 2
    assert not surface.measured[within].any()
    assert errors(surface, mound)[within].max() < 0.1


def test_a_tool_does_not_pull_the_surface_up_and_tissue_goes_on_below_it():
    tool = box(300, 340, 0, 185)
    depth = np.where(tool, 0.055, mound(U, V))

    surface = seen(depth=depth, tissue=~tool, tools=tool)

    assert errors(surface, mound).max() < 0.15
    assert (np.abs(surface.pixels - (320, 165)) < 12).all(axis=1).any()


def test_noise_and_wild_depths_leave_a_tenth_of_a_millimetre():
    rng = np.random.default_rng(4)
    disparity = FB / mound(U, V) + rng.normal(0.0, 0.15, U.shape)
    wild = rng.random(U.shape) < 0.12
    disparity[wild] += rng.uniform(-15, 15, U.shape)[wild]

    error = errors(seen(depth=FB / disparity), mound)

    assert np.median(error) < 0.1
    assert error.max() < 0.6


def test_a_patch_of_wrong_depth_is_left_out_and_marked():
    patch = box(380, 440, 290, 340)

    surface = seen(depth=np.where(patch, 0.060, mound(U, V)))

    within = (np.abs(surface.pixels - (410, 315)) < 12).all(axis=1)
    assert within.any()
    assert not surface.measured[within].any()
    assert errors(surface, mound).max() < 0.2


def test_a_raised_lip_is_followed_and_not_taken_for_wrong_depth():
    def raised(u: Array, v: Array) -> Array:
        return mound(u, v) - 0.004 * np.exp(-(((u - 320) / 90) ** 2) - ((v - 185) / 40) ** 2)

    surface = seen(shape=raised)

    assert errors(surface, raised).max() < 0.4
    assert surface.measured.mean() > 0.98


@settings(max_examples=12, deadline=None)
@given(
    slope=st.tuples(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6)),
    distance=st.floats(0.055, 0.11),
    tilt=st.floats(-3.0, 3.0),
    side=st.sampled_from([-1.0, 1.0]),
)
def test_any_plane_under_any_straight_goal_is_found_and_faces_the_camera(slope, distance, tilt, side):
    def shape(u: Array, v: Array) -> Array:
        return distance / (1.0 + slope[0] * (u - 320) / 600 + slope[1] * (v - 240) / 600)

    along, across = np.array([np.cos(tilt), np.sin(tilt)]), np.array([-np.sin(tilt), np.cos(tilt)])
    goal = np.array([320.0, 240.0]) + np.linspace(-90, 90, 5)[:, None] * along

    surface = seen(shape=shape, polyline=goal, grasp=np.array([320.0, 240.0]) + 60 * side * across)

    assert errors(surface, shape).max() < 1e-3
    a, b, c = np.moveaxis(surface.vertices[surface.triangles], 1, 0)
    assert ((np.cross(b - a, c - a) * a).sum(1) < 0).all()


# ---------------------------------------------------------------- the lattice


@pytest.mark.parametrize("goal", [STRAIGHT, ARC, CORNER], ids=["straight", "arc", "corner"])
def test_one_row_of_vertices_lies_exactly_on_the_goal(goal):
    surface = seen(polyline=goal)

    row = np.flatnonzero(on_goal(surface))
    row = row[np.argsort(surface.station[row])]
    assert distances(surface.pixels[row], np.stack([goal[:-1], goal[1:]], axis=1)).min(axis=1).max() < 1e-9
    assert surface.pixels[row[[0, -1]]] == pytest.approx(goal[[0, -1]], abs=1e-9)
    assert surface.station[row[[0, -1]]] == pytest.approx([0.0, surface.goal_length], abs=1e-9)
    inner = {tuple(edge) for edge in edges_of(surface.triangles, 2).tolist()}
    assert all(tuple(sorted(edge)) in inner for edge in zip(row[:-1].tolist(), row[1:].tolist(), strict=True))


def test_beyond_its_ends_the_goals_row_goes_straight_on():
    surface = seen()

    row = surface.lateral == 0
    assert surface.pixels[row, 1] == pytest.approx(240.0)
    assert surface.pixels[row, 0] == pytest.approx(170.0 + surface.station[row])
    # 14 mm at 75 mm and 600 px are 112 px.
    assert surface.station.min() <= -112 and surface.station.max() >= 300 + 112


@pytest.mark.parametrize("v", [165.0, 315.0], ids=["above", "below"])
def test_lateral_is_the_distance_from_the_goal_positive_on_the_grasps_side(v):
    surface = seen(grasp=np.array([320.0, v]))

    assert surface.lateral == pytest.approx((surface.pixels[:, 1] - 240.0) * np.sign(v - 240.0), abs=1e-9)


@pytest.mark.parametrize("grasp", [[320.0, 60.0], [560.0, 230.0]], ids=["far to the side", "beyond the end"])
def test_the_mesh_reaches_ten_millimetres_around_the_grasp(grasp):
    surface = seen(shape=lambda u, v: np.full_like(u, 0.15), grasp=np.array(grasp))

    reach = surface.pixels - grasp
    assert reach.max(axis=0).min() >= 40 and reach.min(axis=0).max() <= -40


@pytest.mark.parametrize("goal", [STRAIGHT, ARC, CORNER], ids=["straight", "arc", "corner"])
@pytest.mark.parametrize("grasp", [[320.0, 115.0], [330.0, 330.0]], ids=["above", "below"])
def test_triangles_face_the_camera_on_both_sides_of_a_bend(goal, grasp):
    surface = seen(polyline=goal, grasp=np.array(grasp))

    a, b, c = np.moveaxis(surface.vertices[surface.triangles], 1, 0)
    normals = np.cross(b - a, c - a)
    assert ((normals * a).sum(1) < 0).all()
    assert np.linalg.norm(normals, axis=1).min() > 0.02 * np.median(np.linalg.norm(normals, axis=1))


def test_a_jagged_line_does_not_fold_the_lattice():
    rng = np.random.default_rng(1)
    line = np.column_stack([np.linspace(170, 470, 40), 240.0 + rng.normal(0.0, 2.0, 40)])

    assert errors(seen(polyline=line), plane).max() < 1e-3


def test_points_drawn_twice_change_nothing():
    twice = seen(polyline=np.repeat(STRAIGHT, 2, axis=0))

    assert np.array_equal(twice.vertices, seen().vertices)


# ---------------------------------------------------------------- what the mesh covers


def test_no_triangle_crosses_the_tissues_outline():
    notch = (U - 560) ** 2 + (V - 300) ** 2 < 60**2
    tissue = ((U - 320) / 260) ** 2 + ((V - 240) / 150) ** 2 < 1
    tissue &= ~notch & ~box(480, 640, 280, 320)

    surface = seen(tissue=tissue)

    at = np.rint(samples(surface)).astype(int)
    assert tissue_outline(tissue)[at[:, 1], at[:, 0]].mean() > 0.995
    corners = np.rint(surface.pixels).astype(int)
    assert tissue[corners[:, 1], corners[:, 0]].all()


def test_the_mesh_ends_at_the_image():
    surface = seen(polyline=STRAIGHT + AWAY, grasp=GRASP + AWAY)

    assert (surface.pixels >= -0.5).all() and (surface.pixels < (639.5, 479.5)).all()
    assert surface.pixels[:, 1].max() > 460


def test_only_the_piece_that_holds_the_goal_is_kept():
    surface = seen(tissue=~box(0, 639, 300, 312))

    assert surface.pixels[:, 1].max() < 300
    assert set(np.unique(surface.triangles)) == set(range(len(surface.vertices)))


def test_the_border_is_where_an_edge_has_one_triangle():
    surface = seen()

    u, v = surface.pixels.T
    rim = np.isclose(u, u.min()) | np.isclose(u, u.max()) | np.isclose(v, v.min()) | np.isclose(v, v.max())
    assert np.array_equal(surface.border, rim)


def test_the_mesh_does_not_go_on_where_no_depth_is_known():
    surface = seen(depth=np.where(U < 80, np.nan, plane(U, V)))

    assert 50 < surface.pixels[:, 0].min() < 80
    assert errors(surface, plane).max() < 1e-3


def test_pieces_are_told_apart_by_edges_not_by_corners():
    triangles = np.array([[0, 1, 2], [1, 3, 2], [3, 4, 5]], np.int32)

    kept = piece_with(np.array([False, False, False, False, True, True]), triangles)

    assert kept.tolist() == [[3, 4, 5]]


# ---------------------------------------------------------------- refusals


def few_depths() -> Array:
    return np.where(box(319, 321, 239, 241), plane(U, V), np.nan)


def patchy() -> Array:
    ring = ~box(90, 550, 110, 370)
    return np.where(ring | box(300, 340, 230, 250), plane(U, V), np.nan)


def noisy() -> Array:
    return FB / (FB / plane(U, V) + np.random.default_rng(0).uniform(-2.0, 2.0, U.shape))


def scattered(across: float) -> Array:
    """Depth along the rays off by 0.65 mm, on a surface whose slope against the picture is `across`."""
    y = (V - CAMERA.cv) / CAMERA.focal
    return 0.075 / (1.0 - across * y) + np.random.default_rng(0).normal(0.0, 0.65e-3, U.shape)


def doubtful() -> Array:
    wild = np.random.default_rng(0).random(U.shape) < 0.35
    return np.where(wild, 0.045, plane(U, V))


def receding() -> Array:
    return FB / np.clip(35.0 + 0.2 * (V - 240), 2.0, None)


@pytest.mark.parametrize(
    ("given_", "code", "words"),
    [
        ({"depth": np.full((480, 640), np.nan)}, Code.DEPTH_INVALID, "No depth is known around the goal"),
        ({"polyline": STRAIGHT + 9 * AWAY}, Code.DEPTH_INVALID, "No depth is known around the goal"),
        ({"tissue": NOWHERE}, Code.DEPTH_INVALID, "No depth is known around the goal"),
        ({"depth": few_depths()}, Code.DEPTH_INVALID, "Too little depth"),
        ({"depth": patchy()}, Code.DEPTH_INVALID, "Depth is known at"),
        ({"tissue": box(280, 360, 200, 280)}, Code.SURFACE_INVALID, "vertices on tissue, 60 are needed"),
        ({"tissue": U < 380}, Code.SURFACE_INVALID, "of the goal has tissue on both sides"),
        ({"tissue": V > 180}, Code.SURFACE_INVALID, "the grasp does not lie on it"),
        ({"depth": noisy()}, Code.SURFACE_INVALID, "scatters about it by"),
        ({"depth": doubtful()}, Code.SURFACE_INVALID, "of the depth lies off it"),
        ({"depth": receding()}, Code.SURFACE_INVALID, "it runs away to a depth of"),
        ({"depth": np.full((480, 640), 90.0)}, Code.SURFACE_INVALID, "would need more than 4000 vertices"),
        (
            {"polyline": np.array([[200.0, 240.0], [440.0, 240.0], [440.0, 250.0], [200.0, 250.0]])},
            Code.SURFACE_INVALID,
            "fold over, because the goal bends too sharply",
        ),
    ],
)
def test_a_picture_that_shows_too_little_is_refused_with_a_sentence(given_, code, words):
    outcome = look(**given_)

    assert outcome.code is code
    assert words in outcome.message
    assert outcome.surface is None


def test_scatter_is_judged_by_the_distance_from_the_surface():
    """The same error along the ray is less of one where the surface is seen at a slant."""
    assert look(depth=scattered(0.0)).code is Code.SURFACE_INVALID
    assert look(depth=scattered(1.2)).code is Code.OK


def test_a_surface_through_a_step_in_depth_is_refused():
    step = np.where(V < 200, 0.060, 0.075)
    config = SurfaceConfig(fit=FitConfig(noise=4.0, stiffness=0.05), max_residual=1.0)

    outcome = look(depth=step, config=config)

    assert outcome.code is Code.SURFACE_INVALID
    assert "seen edge on" in outcome.message


@pytest.mark.parametrize(
    ("given_", "words"),
    [
        ({"polyline": STRAIGHT[:1]}, "at least two finite pixels"),
        ({"polyline": np.array([[1.0, 2.0], [np.nan, 3.0]])}, "at least two finite pixels"),
        ({"polyline": STRAIGHT[[0, 0]]}, "no length"),
        ({"grasp": np.array([np.inf, 0.0])}, "one finite pixel"),
        ({"tissue": EVERYWHERE[:100]}, "the tissue mask must have the camera's size"),
        ({"tools": NOWHERE[:, :5]}, "the tool mask must have the camera's size"),
        ({"depth": np.ones((4, 4))}, "the depth map must have the camera's size"),
    ],
)
def test_malformed_arguments_are_an_error(given_, words):
    with pytest.raises(ValueError, match=words):
        look(**given_)


@pytest.mark.parametrize("change", [{"spacing_along": 0.0}, {"margin_across": -1e-3}, {"min_measured": 1.2}])
def test_a_configuration_out_of_range_is_an_error(change):
    with pytest.raises(ValueError, match="surface's configuration"):
        replace(SurfaceConfig(), **change)


def test_a_fit_without_stiffness_is_an_error():
    with pytest.raises(ValueError, match="positive"):
        FitConfig(stiffness=0.0)


def test_the_same_picture_gives_the_same_mesh_bit_for_bit():
    rng = np.random.default_rng(2)
    depth = mound(U, V) + rng.normal(0.0, 2e-4, U.shape)

    one, two = seen(depth=depth.copy()), seen(depth=depth.copy())

    assert np.array_equal(one.vertices, two.vertices)
    assert np.array_equal(one.triangles, two.triangles)
