from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pytest
import warp as wp
from numpy.typing import NDArray

from hardware.interface import Array
from skills.expose.region import Region, region_around
from skills.expose.visibility import Expansion, Lips, LossWeights, Terms, Visibility, VisibilityConfig, cost, lips_of
from skills.expose.visibility_kernels import pack
from skills.scene.surface import Surface
from skills.tracking.model_based import model_tracked_pixels
from tests.skills.test_region import CAMERA, DEPTH, LENGTH, NEAR, bent_goal, grasp_at, straight_goal, surface_along

LAYOUTS = pytest.mark.parametrize("lanes", [8, 1], ids=["blocks of 8", "single samples"])
PAPER = VisibilityConfig(stretch_weight=1.0, shear_weight=0.5, expansion=Expansion.SQUARED)


@dataclass(frozen=True)
class Case:
    """A sheet at rest, split along the goal: the first vertices are the surface's, the last the far copies."""

    surface: Surface
    region: Region
    rest: Array
    triangles: NDArray[np.int32]
    far: NDArray[np.bool_]  # (V,) belongs to the far side
    lips: Lips


def case(polyline: Array | None = None, grasp: Array = NEAR, tilt: float = 0.0, parted: bool = False) -> Case:
    """Make a sheet around `polyline`, split within the goal, or, if `parted`, from border to border."""
    polyline = straight_goal() if polyline is None else polyline
    surface = surface_along(polyline, tilt)
    region = region_around(polyline, grasp, surface, CAMERA)
    inner = (surface.lateral == 0) & (parted | (surface.station > 1e-6) & (surface.station < surface.goal_length - 1e-6))
    split = np.flatnonzero(inner)
    copies = len(surface.vertices) + np.arange(len(split))
    renamed = np.arange(len(surface.vertices))
    renamed[split] = copies
    below = surface.lateral[surface.triangles].mean(axis=1) < 0
    triangles = np.where(below[:, None], renamed[surface.triangles], surface.triangles).astype(np.int32)
    seams = np.column_stack([split, copies]).astype(np.int32)
    return Case(
        surface,
        region,
        np.vstack([surface.vertices, surface.vertices[split]]),
        triangles,
        np.append(surface.lateral < 0, np.ones(len(split), bool)),
        lips_of(surface, seams),
    )


def judge(
    c: Case, positions: Array, config: VisibilityConfig | None = None, lanes: int = 8, lips: bool = True, threads: int = 1
) -> Terms:
    """Terms of `positions` (h, K, V, 3)."""
    visibility = Visibility(c.region, c.triangles, CAMERA, c.lips if lips else None, config, threads=threads)
    return visibility.judge(pack(positions, lanes), positions.shape[1])


def judge_one(
    c: Case, state: Array, config: VisibilityConfig | None = None, lips: bool = True
) -> tuple[float, float, bool, float]:
    """Camera, deform, visible, opening of one state (V, 3)."""
    t = judge(c, state[None, None], config, lips=lips)
    return float(t.camera[0, 0]), float(t.deform[0, 0]), bool(t.visible[0, 0]), float(t.opening[0, 0])


def in_plane(rest: Array, across: Array | float = 0.0, along: Array | float = 0.0) -> Array:
    """Move `rest`, which faces the camera at DEPTH, by pixels across (towards near, down the image) and along a horizontal goal."""
    moved = rest.copy()
    moved[:, 0] += along * DEPTH / CAMERA.focal
    moved[:, 1] += across * DEPTH / CAMERA.focal
    return moved


def pixels_of(rest: Array) -> tuple[Array, Array]:
    """Along and across coordinate [px] from the image's middle, where the horizontal goal has its own."""
    p = CAMERA.project(rest)
    return p[:, 0] - CAMERA.cu, p[:, 1] - CAMERA.cv


def crumpled(c: Case, steps: int, samples: int, seed: int = 3) -> Array:
    """Make random states (h, K, V, 3): waves, noise, an opened cut; some fold over, some leave the image."""
    rng = np.random.default_rng(seed)
    states = np.empty((steps, samples, *c.rest.shape))
    for t in range(steps):
        for k in range(samples):
            phase, amplitude = rng.uniform(0, 6, (3, 3)), rng.uniform(0, 1.5e-3, 3)
            wave = np.sin(c.rest @ rng.normal(0, 120.0, (3, 3)) + phase.sum(0)) * amplitude
            opened = np.where(c.far, -0.5, 0.5)[:, None] * rng.normal(0, 2e-3, 3)
            shift = rng.normal(0, 14e-3, 3) * [1.0, 1.0, 0.3]
            states[t, k] = c.rest + wave + opened + shift + rng.normal(0, 2e-4, c.rest.shape)
    return states


def reference(c: Case, x: Array, config: VisibilityConfig, lips: bool = True) -> tuple[complex, complex, bool, complex]:
    """Camera, deform, visible, opening of one state (V, 3), by loops; it may be complex, to be differentiated by its imaginary part."""
    rows, columns = c.region.shape
    used = c.region.used

    def pixel(point: Array) -> Array:
        return np.array([CAMERA.focal * point[0] / point[2] + CAMERA.cu, CAMERA.focal * point[1] / point[2] + CAMERA.cv])

    p, facing, visible = {}, [], True
    for r in range(rows):
        for k in range(columns):
            if used[r, k]:
                i = r * columns + k
                a, b, d = x[c.triangles[c.region.points.triangle[i]]]
                point = c.region.points.barycentric[i] @ np.stack([a, b, d])
                p[r, k] = pixel(point)
                normal = np.cross(b - a, d - a)
                facing.append(normal[2] / np.sqrt((normal**2).sum()))
                u, v = p[r, k].real
                visible &= bool(0 <= u < CAMERA.width and 0 <= v < CAMERA.height and point[2].real > 0)
    p0 = c.region.pixels.reshape(rows, columns, 2)
    losses = []
    for r, k in p:
        before_r, after_r = ((r - 1, k) if (r - 1, k) in p else (r, k)), ((r + 1, k) if (r + 1, k) in p else (r, k))
        before_k, after_k = ((r, k - 1) if (r, k - 1) in p else (r, k)), ((r, k + 1) if (r, k + 1) in p else (r, k))
        if before_r == after_r or before_k == after_k:
            continue
        D = np.column_stack([p[after_r] - p[before_r], p[after_k] - p[before_k]])
        D0 = np.column_stack([p0[after_r] - p0[before_r], p0[after_k] - p0[before_k]])
        F = D @ np.linalg.inv(D0)
        n, m = c.region.normal[k], c.region.tangent[k]
        nFn, nFm = n @ F @ n, n @ F @ m
        sign = np.sign(nFn.real) if config.expansion is Expansion.SIGNED else 1.0
        losses.append(-config.stretch_weight * sign * nFn**2 + config.shear_weight * nFm**2)
    opening = 0.0
    for k in range(columns):
        n = c.region.normal[k]
        far = [n @ p[r, k] for r in range(rows) if (r, k) in p and c.region.lateral[r] < 0]
        near = [n @ p[r, k] for r in range(rows) if (r, k) in p and c.region.lateral[r] > 0]
        closed = 0.0
        s = c.region.station[k]
        if lips and c.lips.station[0] <= s <= c.lips.station[-1]:
            j = min(int(np.searchsorted(c.lips.station, s, side="right")) - 1, len(c.lips.station) - 2)
            w = (s - c.lips.station[j]) / (c.lips.station[j + 1] - c.lips.station[j])
            far.append(n @ pixel((1 - w) * x[c.lips.far[j]] + w * x[c.lips.far[j + 1]]))
            near.append(n @ pixel((1 - w) * x[c.lips.near[j]] + w * x[c.lips.near[j + 1]]))
        elif far and near:
            inner = [c.region.lateral[r] for r in range(rows) if (r, k) in p]
            closed = min(q for q in inner if q > 0) - max(q for q in inner if q < 0)
        else:
            continue
        gap = min(near, key=lambda q: q.real) - max(far, key=lambda q: q.real) - closed
        opening += gap * c.region.spacing[1] if gap.real > 0 else 0.0
    return np.mean(facing), np.mean(losses), visible, opening


def assert_agrees(c: Case, states: Array, found: Terms, config: VisibilityConfig, lips: bool = True) -> None:
    steps, samples = states.shape[:2]
    for t in range(steps):
        for k in range(samples):
            camera, deform, visible, opening = reference(c, states[t, k], config, lips)
            np.testing.assert_allclose(found.camera[t, k], camera, atol=2e-5)
            np.testing.assert_allclose(found.deform[t, k], deform, rtol=1e-4, atol=1e-4)
            np.testing.assert_allclose(found.opening[t, k], opening, rtol=1e-4, atol=0.5)
            assert found.visible[t, k] == visible


@LAYOUTS
@pytest.mark.parametrize("config", [PAPER, VisibilityConfig(0.7, 2.0, Expansion.SIGNED)], ids=["squared", "signed"])
def test_the_terms_agree_with_plain_numpy_on_crumpled_sheets(lanes, config):
    c = case(straight_goal(0.5), grasp=grasp_at(330.0, 270.0), tilt=0.3)  # some pixels excluded
    states = crumpled(c, steps=2, samples=11)
    found = judge(c, states, config, lanes)

    assert 0 < found.visible.sum() < found.visible.size
    assert (found.opening > 0).any() and (found.opening == 0).any()
    assert_agrees(c, states, found, config)


@pytest.mark.parametrize("lips", [True, False])
def test_the_terms_agree_with_plain_numpy_around_a_bent_goal(lips):
    c = case(bent_goal(radius=90.0, turn=1.4), tilt=-0.2)
    states = crumpled(c, steps=1, samples=9, seed=8)
    assert_agrees(c, states, judge(c, states, PAPER, lips=lips), PAPER, lips)


def test_pixels_alone_across_the_goal_have_no_gradient_and_columns_with_one_side_no_gap():
    c = case()
    used = np.random.default_rng(5).random(c.region.shape) < 0.4
    used[:, 4] = False
    used[:4, 7], used[4:, 7] = False, True
    c = replace(c, region=replace(c.region, used=used))
    states = crumpled(c, steps=1, samples=8, seed=2)
    for lips in (True, False):
        assert_agrees(c, states, judge(c, states, PAPER, lips=lips), PAPER, lips)


def test_both_layouts_give_the_same():
    c = case(tilt=0.2)
    states = crumpled(c, steps=2, samples=13)
    wide, single = judge(c, states, lanes=8), judge(c, states, lanes=1)
    for name in ("camera", "deform", "opening"):
        np.testing.assert_allclose(getattr(wide, name), getattr(single, name), rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(wide.visible, single.visible)


def test_a_gpu_gives_the_same():
    if not wp.is_cuda_available():
        pytest.skip("needs a GPU")
    c = case(tilt=0.2)
    states = crumpled(c, steps=2, samples=13)
    found = Visibility(c.region, c.triangles, CAMERA, c.lips, device="cuda:0").judge(pack(states, 1, "cuda:0"), 13)
    assert_agrees(c, states, found, VisibilityConfig())


def test_a_rest_state_has_the_identity_as_its_gradient_on_straight_and_bent_goals():
    for polyline in (straight_goal(), straight_goal(1.1), bent_goal(radius=90.0, turn=1.4)):
        c = case(polyline, tilt=0.3)
        _, deform, visible, opening = judge_one(c, c.rest, replace(PAPER, shear_weight=10.0))
        assert deform == pytest.approx(-1.0, abs=1e-5)
        assert visible and opening == pytest.approx(0.0, abs=0.05)


def test_a_translation_in_the_plane_deforms_nothing():
    c = case()
    camera, deform, _, opening = judge_one(c, in_plane(c.rest, across=13.0, along=-21.0), replace(PAPER, shear_weight=10.0))
    assert camera == pytest.approx(-1.0, abs=1e-6)
    assert deform == pytest.approx(-1.0, abs=1e-5)
    assert opening == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize("s", [0.6, 1.0, 1.7])
def test_a_widening_by_s_across_the_goal_gains_s_squared(s):
    c = case()
    _, across = pixels_of(c.rest)
    widened = in_plane(c.rest, across=(s - 1.0) * across)
    for expansion in Expansion:
        _, deform, _, _ = judge_one(c, widened, VisibilityConfig(2.0, 1.0, expansion))
        assert deform == pytest.approx(-2.0 * s**2, rel=1e-4)


def test_a_lengthening_along_the_goal_gains_nothing():
    c = case()
    along, _ = pixels_of(c.rest)
    _, deform, _, _ = judge_one(c, in_plane(c.rest, along=0.5 * along), PAPER)
    assert deform == pytest.approx(-1.0, rel=1e-4)


def test_shear_across_the_goal_costs_its_square_and_shear_along_it_nothing():
    c = case()
    along, across = pixels_of(c.rest)
    config = VisibilityConfig(0.0, 3.0)
    _, tilted, _, _ = judge_one(c, in_plane(c.rest, across=0.3 * along), config)
    _, slid, _, _ = judge_one(c, in_plane(c.rest, along=0.3 * across), config)
    assert tilted == pytest.approx(3.0 * 0.3**2, rel=1e-3)
    assert slid == pytest.approx(0.0, abs=1e-6)


def test_tissue_turned_inside_out_is_rewarded_by_the_squared_form_only():
    c = case()
    _, across = pixels_of(c.rest)
    folded = in_plane(c.rest, across=-2.0 * across)
    assert judge_one(c, folded, PAPER)[1] == pytest.approx(-1.0, rel=1e-4)
    assert judge_one(c, folded, replace(PAPER, expansion=Expansion.SIGNED))[1] == pytest.approx(1.0, rel=1e-4)


@pytest.mark.parametrize("degrees", [0.0, 25.0, 70.0, 120.0])
def test_a_sheet_turned_away_by_phi_has_the_camera_loss_minus_cos_phi(degrees):
    c = case()
    phi = np.deg2rad(degrees)
    turn = np.array([[1, 0, 0], [0, np.cos(phi), -np.sin(phi)], [0, np.sin(phi), np.cos(phi)]])
    centre = np.array([0.0, 0.0, DEPTH])
    camera, _, visible, _ = judge_one(c, (c.rest - centre) @ turn.T + centre)
    assert camera == pytest.approx(-np.cos(phi), abs=1e-5)
    assert visible


@pytest.mark.parametrize("gap", [4.0, 20.0])
def test_a_gap_of_g_pixels_over_the_whole_goal_opens_g_times_its_length(gap):
    c = case(parted=True)
    opened = in_plane(c.rest, across=np.where(c.far, -gap / 3, 2 * gap / 3))
    assert judge_one(c, opened)[3] == pytest.approx(gap * LENGTH, rel=1e-3)
    assert judge_one(c, opened, lips=False)[3] == pytest.approx(gap * LENGTH, rel=1e-3)


def test_lips_that_meet_at_the_tips_open_a_spindle():
    c = case()
    along, _ = pixels_of(c.rest)
    half = 10.0 * np.clip(1.0 - np.abs(along) / (LENGTH / 2), 0.0, None)
    on_line = np.append(c.surface.lateral == 0, np.zeros(len(c.rest) - len(c.surface.lateral), bool))
    lip = on_line | (np.arange(len(c.rest)) >= len(c.surface.vertices))
    opened = in_plane(c.rest, across=np.where(lip, np.where(c.far, -half, half), 0.0))
    assert judge_one(c, opened)[3] == pytest.approx(0.5 * 20.0 * LENGTH, rel=0.02)


def test_a_near_side_folded_over_the_far_one_opens_nothing():
    c = case()
    _, across = pixels_of(c.rest)
    folded = in_plane(c.rest, across=np.where(c.far, 0.0, -2.0 * across))
    folded[~c.far, 2] -= 1e-4  # on top
    assert judge_one(c, folded)[3] == 0.0
    assert judge_one(c, folded, lips=False)[3] == 0.0


def test_a_flap_that_hangs_over_an_open_cut_hides_what_it_covers():
    c = case()
    row = np.append(c.surface.lateral, np.zeros(len(c.rest) - len(c.surface.lateral)))
    opened = np.where(c.far, -15.0, 15.0)
    flap = (row > 0) & (row < 40)  # the near side's two rows next to the lip come to lie 10 px from the far lip
    hanging = in_plane(c.rest, across=np.where(flap, -row - 5.0, opened))
    full, left = judge_one(c, in_plane(c.rest, across=opened))[3], judge_one(c, hanging)[3]
    assert 0.2 * full < left < 0.6 * full
    assert left == pytest.approx(reference(c, hanging, PAPER)[3], rel=1e-3)


def test_the_derivatives_by_the_vertices_are_those_of_the_formulas():
    """Central differences of the kernel against the reference's complex step, along random directions."""
    c = case(tilt=0.3)
    rng = np.random.default_rng(11)
    base = in_plane(c.rest, across=np.where(c.far, -6.0, 6.0)) + rng.normal(0, 1e-4, c.rest.shape)
    step = 1e-4
    for _ in range(6):
        direction = rng.normal(0, 1, 3) * np.sin(c.rest @ rng.normal(0, 100.0, 3) + rng.uniform(0, 6))[:, None]
        pair = np.stack([base - step * direction, base + step * direction])[None]
        found = judge(c, pair, PAPER)
        camera, deform, _, opening = reference(c, base + 1e-20j * direction, PAPER)
        for name, value in (("camera", camera), ("deform", deform), ("opening", opening)):
            slope = np.diff(getattr(found, name)[0])[0] / (2 * step)
            assert slope == pytest.approx(value.imag / 1e-20, rel=0.02, abs=0.2 if name != "opening" else 200.0)


@pytest.mark.parametrize(
    ("axis", "edge", "inwards"), [("u", 0.0, 1.0), ("u", CAMERA.width, -1.0), ("v", 0.0, 1.0), ("v", CAMERA.height, -1.0)]
)
def test_visibility_ends_exactly_where_the_image_does(axis, edge, inwards):
    c = case()
    k = "uv".index(axis)
    outermost = c.region.pixels[:, k].min() if inwards > 0 else c.region.pixels[:, k].max()
    for inside in (0.002, -0.002):
        shift = edge - outermost + inwards * inside
        moved = in_plane(c.rest, **{("along", "across")[k]: shift})
        seen = model_tracked_pixels(c.region.points, moved, c.triangles, CAMERA)[:, k]
        assert abs((seen.min() if inwards > 0 else seen.max()) - edge) == pytest.approx(0.002, abs=1e-6)
        assert judge_one(c, moved)[2] == (inside > 0)


def test_a_pixel_behind_the_camera_or_without_a_place_is_not_visible():
    c = case()
    behind, nowhere = c.rest.copy(), c.rest.copy()
    behind[:, 2] -= 2 * DEPTH
    nowhere[c.triangles[c.region.points.triangle[0], 0]] = np.nan
    terms = judge(c, np.stack([behind, nowhere, c.rest])[None])
    assert terms.visible[0].tolist() == [False, False, True]
    assert np.isfinite([terms.camera[0, 0], terms.deform[0, 0], terms.opening[0, 0]]).all()


def test_unused_pixels_do_not_count():
    c = case()
    used = c.region.used.copy()
    used[:, -5:] = False
    c = replace(c, region=replace(c.region, used=used))
    touched = np.unique(c.triangles[c.region.points.triangle[used.ravel()]])
    moved = c.rest + np.array([0.0, 0.0, 1.0]) * np.random.default_rng(0).normal(0, 5e-3, (len(c.rest), 1))
    moved[:, 0] += 1.0  # far outside the image
    moved[touched] = c.rest[touched]
    assert judge_one(c, moved, lips=False) == judge_one(c, c.rest, lips=False)
    assert judge_one(c, moved, lips=False)[2]


@LAYOUTS
def test_a_sample_s_terms_depend_neither_on_the_batch_nor_on_its_place_in_it(lanes):
    c = case(tilt=0.2)
    states = crumpled(c, steps=2, samples=19)
    order = np.random.default_rng(4).permutation(19)
    whole, shuffled, few = (
        judge(c, states, lanes=lanes),
        judge(c, states[:, order], lanes=lanes),
        judge(c, states[:, 5:8], lanes=lanes),
    )
    for name in ("camera", "deform", "opening", "visible"):
        np.testing.assert_array_equal(getattr(whole, name)[:, order], getattr(shuffled, name))
        np.testing.assert_array_equal(getattr(whole, name)[:, 5:8], getattr(few, name))


def test_the_terms_are_the_same_every_time_and_for_any_number_of_threads():
    c = case(tilt=0.2)
    states = crumpled(c, steps=2, samples=21)
    visibility = Visibility(c.region, c.triangles, CAMERA, c.lips, threads=3)
    found = [visibility.judge(pack(states, 8), 21), visibility.judge(pack(states, 8), 21), judge(c, states)]
    for name in ("camera", "deform", "opening", "visible"):
        np.testing.assert_array_equal(getattr(found[0], name), getattr(found[1], name))
        np.testing.assert_array_equal(getattr(found[0], name), getattr(found[2], name))


def test_one_object_judges_trajectories_of_changing_shape():
    c = case()
    states = crumpled(c, steps=3, samples=18)
    visibility = Visibility(c.region, c.triangles, CAMERA, c.lips)
    for steps, samples, lanes in ((3, 18, 8), (1, 3, 8), (2, 18, 1), (3, 18, 8)):
        found = visibility.judge(pack(states[:steps, :samples], lanes), samples)
        assert found.camera.shape == found.visible.shape == (steps, samples)
        np.testing.assert_allclose(found.deform, judge(c, states).deform[:steps, :samples], rtol=1e-5)


def test_a_rollout_is_judged_by_its_trajectory_and_its_number_of_samples():
    @dataclass(frozen=True)
    class Rolled:
        trajectory: wp.array
        tension: Array

    c = case()
    states = crumpled(c, steps=2, samples=5)
    visibility = Visibility(c.region, c.triangles, CAMERA, c.lips)
    found = visibility.terms(Rolled(pack(states, 8), np.zeros((2, 5))))
    np.testing.assert_array_equal(found.deform, judge(c, states).deform)
    assert found.deform.dtype == found.camera.dtype == found.opening.dtype == np.float64
    assert found.visible.dtype == np.bool_


def test_triangles_without_area_have_no_normal_but_spoil_nothing():
    c = case()
    needle, point = c.rest.copy(), np.tile(c.rest[:1], (len(c.rest), 1))
    needle[:, 1] = 0.0  # every triangle seen edge-on becomes a line
    for state in (needle, point):
        camera, deform, visible, opening = judge_one(c, state)
        assert camera == 0.0
        assert np.isfinite([deform, opening]).all()
        assert visible


def test_the_lips_of_a_split_surface_run_from_tip_to_tip():
    c = case()
    assert c.lips.station.tolist() == pytest.approx(np.linspace(0.0, LENGTH, 9).tolist())
    same = c.lips.far == c.lips.near
    assert same.tolist() == [True, *[False] * 7, True]
    np.testing.assert_array_equal(c.rest[c.lips.far], c.rest[c.lips.near])
    far_triangles = c.triangles[c.surface.lateral[c.surface.triangles].mean(axis=1) < 0]
    assert np.isin(c.lips.far, far_triangles).all()
    assert not np.isin(c.lips.near[1:-1], far_triangles).any()


def test_a_surface_without_seams_has_no_lips():
    surface = surface_along(straight_goal())
    assert len(lips_of(surface, np.zeros((0, 2), np.int32)).station) == 0
    with pytest.raises(ValueError, match="goal's line"):
        lips_of(surface, np.array([[0, len(surface.vertices)]], np.int32))


def test_the_cost_sums_weighted_terms_over_the_horizon_and_marks_what_is_infeasible():
    terms = Terms(
        camera=np.array([[-1.0, -0.5, 0.0, 0.0], [-1.0, 0.5, 0.0, 0.0]]),
        deform=np.array([[-2.0, -1.0, 0.0, np.nan], [-4.0, 1.0, 0.0, 0.0]]),
        visible=np.array([[True, True, True, True], [True, True, False, True]]),
        opening=np.array([[0.0, 100.0, 0.0, 0.0], [0.0, 50.0, 0.0, 0.0]]),
    )
    costs, feasible = cost(terms, LossWeights(camera=2.0, deform=0.5, opening=0.01))
    np.testing.assert_allclose(costs, [-4.0 - 3.0, 0.0 + 0.0 - 1.5, np.inf, np.inf])
    assert feasible.tolist() == [True, True, False, False]


def test_settings_that_make_no_sense_are_refused():
    for wrong in ({"stretch_weight": -1.0}, {"shear_weight": float("nan")}, {"expansion": "cubed"}):
        with pytest.raises(ValueError):
            VisibilityConfig(**wrong)
    for wrong in ({"camera": -1.0}, {"deform": float("inf")}, {"opening": float("nan")}):
        with pytest.raises(ValueError):
            LossWeights(**wrong)
    assert VisibilityConfig(**{"expansion": "squared"}) == VisibilityConfig(expansion=Expansion.SQUARED)


def test_what_does_not_fit_together_is_refused():
    c = case()
    with pytest.raises(ValueError, match="no pixel"):
        Visibility(replace(c.region, used=np.zeros_like(c.region.used)), c.triangles, CAMERA)
    with pytest.raises(ValueError, match="triangles"):
        Visibility(c.region, c.triangles[:3], CAMERA)
    with pytest.raises(ValueError, match="threads"):
        Visibility(c.region, c.triangles, CAMERA, threads=0)
    with pytest.raises(ValueError, match="stations that increase"):
        Visibility(c.region, c.triangles, CAMERA, replace(c.lips, station=c.lips.station[::-1]))
    visibility = Visibility(c.region, c.triangles, CAMERA, c.lips)
    states = c.rest[None, None]
    with pytest.raises(ValueError, match="samples"):
        visibility.judge(pack(states, 8), 9)
    with pytest.raises(ValueError, match="vertices"):
        visibility.judge(pack(states[:, :, :20], 8), 1)
    with pytest.raises(ValueError, match="a trajectory is"):
        visibility.judge(wp.zeros((1, 1, 1), dtype=wp.vec4), 1)
