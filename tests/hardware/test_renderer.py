"""The endoscope renderer against analytic geometry: depth, occlusion, holes, disparity, labels, repeatability."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest

from hardware.codes import InputError
from hardware.interface import Array, CameraModel, Pose
from hardware.stub.renderer import Label, Look, Renderer
from hardware.stub.surface import BaseSurface, Ligaments, SheetSurface, ToolShape

CAMERA = CameraModel(320, 240, 310.0, 159.5, 119.5, 0.0043)
QUIET = Look(noise=0.0)


def grid(columns: int, rows: int, width: float, height: float) -> tuple[Array, np.ndarray]:
    """Points (N, 2) and triangles that run counter-clockwise seen from a camera with v down."""
    x, y = np.meshgrid(np.linspace(-width / 2, width / 2, columns), np.linspace(-height / 2, height / 2, rows))
    i = np.arange(columns * rows).reshape(rows, columns)
    a, b, c, d = (part.reshape(-1) for part in (i[:-1, :-1], i[:-1, 1:], i[1:, :-1], i[1:, 1:]))
    triangles = np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])
    return np.stack([x.reshape(-1), y.reshape(-1)], axis=1), triangles.astype(np.int32)


def bed(distance: float = 0.1) -> BaseSurface:
    xy, triangles = grid(11, 11, 0.3, 0.3)
    points = np.column_stack([xy, np.full(len(xy), distance)])
    return BaseSurface(points.astype(np.float32), triangles, xy.astype(np.float32))


def sheet(
    slope: float = 0.0, distance: float = 0.08, thickness: float = 1e-6, hole: float = 0.0, revision: int = 0
) -> SheetSurface:
    """A sheet of 80 x 60 mm in the plane z = distance + slope * y, with a square hole of side `hole` in its middle."""
    rest, triangles = grid(81, 61, 0.08, 0.06)
    middle = np.abs(rest[triangles].mean(axis=1)).max(axis=1)
    triangles = triangles[middle > hole / 2]
    points = np.column_stack([rest, distance + slope * rest[:, 1]])
    return SheetSurface(points.astype(np.float32), rest.astype(np.float32), triangles, revision, thickness)


def half_cut(gap: float, depth: float = 0.6, thickness: float = 0.0015) -> SheetSurface:
    """A sheet cut through along y = 0 but for its middle 40 mm, where only the share `depth` is severed; its halves are `gap` apart."""
    whole = sheet(thickness=thickness)
    on_cut = np.flatnonzero(np.abs(whole.rest[:, 1]) < 1e-6)
    copies = np.arange(len(whole.rest), len(whole.rest) + len(on_cut))
    triangles, positions = whole.triangles.copy(), np.concatenate([whole.positions, whole.positions[on_cut]])
    lower = whole.rest[triangles, 1].mean(axis=1) > 0  # y runs down the image
    copy_of = np.arange(len(whole.rest))
    copy_of[on_cut] = copies
    triangles[lower] = copy_of[triangles[lower]]
    below = np.unique(triangles[lower])
    positions[:, 1] -= np.float32(gap / 2)
    positions[below, 1] += np.float32(gap)
    held = np.flatnonzero(np.abs(whole.rest[on_cut, 0]) < 0.0201)
    near, far = held[:-1], held[1:]
    # Triangles run counter-clockwise for the camera: with x to the right, the lip that is higher up in the image is on the left.
    ends = np.stack([on_cut[near], copies[near], on_cut[far], copies[far]], axis=1).astype(np.int32)
    joined = Ligaments(ends, np.ones(len(ends), np.float32), np.full((len(ends), 2), depth, np.float32))
    rest = np.concatenate([whole.rest, whole.rest[on_cut]])
    return replace(whole, positions=positions, rest=rest, triangles=triangles, ligaments=joined)


def tent(height: float = 0.012) -> SheetSurface:
    flat = sheet()
    lift = height * np.exp(-((flat.rest / 0.015) ** 2).sum(axis=1))
    return replace(flat, positions=(flat.positions - np.outer(lift, [0, 0, 1])).astype(np.float32))


def tool(kind: str = "grasper", tip: Sequence[float] = (0.0, 0.0, 0.06)) -> ToolShape:
    """An instrument that comes in from the left border, its shaft along the image rows."""
    return ToolShape(kind, Pose.looking(np.array(tip), np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])), 0.3)


def rays() -> tuple[Array, Array]:
    v, u = np.indices((CAMERA.height, CAMERA.width), dtype=np.float64)
    return (u - CAMERA.cu) / CAMERA.focal, (v - CAMERA.cv) / CAMERA.focal


def interior(mask: np.ndarray) -> np.ndarray:
    """`mask` without its rim."""
    return cv2.erode(mask.astype(np.uint8), np.ones((5, 5), np.uint8)).astype(bool)


@pytest.mark.parametrize("slope", [0.0, 0.6, -0.4])
def test_depth_of_a_plane_is_exact(slope: float) -> None:
    rendering = Renderer(QUIET, CAMERA, bed(0.2)).render(sheet(slope), [], 0)

    _, y = rays()
    expected = 0.08 / (1 - slope * y)
    top = rendering.label == Label.TOP
    assert top.sum() > 20_000
    np.testing.assert_allclose(rendering.depth[top], expected[top], rtol=1e-4)


def test_the_top_lies_half_a_thickness_above_the_mid_surface() -> None:
    rendering = Renderer(QUIET, CAMERA, bed()).render(sheet(thickness=0.002), [], 0)

    assert rendering.depth[120, 160] == pytest.approx(0.079, rel=1e-5)


def test_same_input_gives_the_same_bytes_from_a_fresh_renderer() -> None:
    first = Renderer(Look(seed=4), CAMERA, bed()).render(tent(), [tool()], 7)
    other = Renderer(Look(seed=4), CAMERA, bed())
    other.render(sheet(), [tool("scissors")], 3)

    again = other.render(tent(), [tool()], 7)

    assert first.image.tobytes() == again.image.tobytes()
    assert first.depth.tobytes() == again.depth.tobytes()
    assert first.triangle.tobytes() == again.triangle.tobytes()


def test_sequence_and_eye_change_the_noise_alone() -> None:
    renderer = Renderer(Look(noise=2.0), CAMERA, bed())
    clean = Renderer(Look(noise=0.0), CAMERA, bed()).render(tent(), [], 0).image.astype(int)

    noise = [renderer.render(tent(), [], sequence).image - clean for sequence in (0, 1)]

    assert (noise[0] != noise[1]).mean() > 0.5
    for part in noise:
        assert part.std() == pytest.approx(2.0, rel=0.1)
        assert abs(part.mean()) < 0.05


def test_a_pair_is_two_single_views() -> None:
    renderer = Renderer(Look(), CAMERA, bed())
    pair = renderer.render_pair(tent(), [tool(), tool("scissors", (0.0, 0.01, 0.05))], 5)

    for eye, view in enumerate(pair):
        single = renderer.render(tent(), [tool(), tool("scissors", (0.0, 0.01, 0.05))], 5, eye)
        assert view.image.tobytes() == single.image.tobytes()
        assert view.depth.tobytes() == single.depth.tobytes()
        assert view.label.tobytes() == single.label.tobytes()


def test_a_tool_in_front_hides_the_sheet_at_its_own_depth() -> None:
    renderer = Renderer(QUIET, CAMERA, bed())

    rendering = renderer.render(sheet(), [tool(tip=(0.02, 0.0, 0.06))], 0)

    # The shaft is a cylinder of 2.5 mm radius around the row of the principal point, 60 mm away.
    shaft = (slice(119, 121), slice(10, 60))
    assert (rendering.label[shaft] == Label.TOOL).all()
    np.testing.assert_allclose(rendering.depth[shaft], 0.0575, atol=5e-5)
    half_width = 0.0025 / np.sqrt(0.06**2 - 0.0025**2) * CAMERA.focal
    assert (rendering.label[:, 30] == Label.TOOL).sum() == pytest.approx(2 * half_width, abs=1.5)
    assert (rendering.label[:, 300] == Label.TOP).sum() > 200


def test_a_tool_behind_the_sheet_is_hidden() -> None:
    rendering = Renderer(QUIET, CAMERA, bed(0.2)).render(sheet(), [tool(tip=(0.0, 0.0, 0.09))], 0)

    assert (rendering.label[60:180, 60:260] == Label.TOP).all()


@pytest.mark.parametrize("thickness", [1e-5, 0.004])
def test_a_hole_shows_the_bed_over_the_expected_area(thickness: float) -> None:
    # Full resolution: a border of one pixel more or less is then about one per cent of the area.
    camera = CameraModel(640, 480, 620.0, 319.5, 239.5, 0.0043)
    rendering = Renderer(QUIET, camera, bed()).render(sheet(distance=0.0803, thickness=thickness, hole=0.02), [], 0)

    near, far = (0.02 * camera.focal / (0.0803 + side * thickness / 2) for side in (-1, 1))
    inside = np.zeros(rendering.label.shape, bool)
    inside[120:360, 200:440] = True
    assert ((rendering.label == Label.BASE) & inside).sum() == pytest.approx(far**2, rel=0.02)
    assert ((rendering.label == Label.WALL) & inside).sum() == pytest.approx(near**2 - far**2, abs=0.5 * 4 * far)


def test_a_cut_shows_once_the_revision_grows() -> None:
    renderer = Renderer(QUIET, CAMERA, bed())
    before = renderer.render(sheet(revision=0), [], 0)

    after = renderer.render(sheet(hole=0.02, revision=1), [], 1)

    assert before.label[120, 160] == Label.TOP
    assert after.label[120, 160] == Label.BASE
    assert after.depth[120, 160] == pytest.approx(0.1, rel=1e-4)


@pytest.mark.parametrize("depth", [0.2, 0.6, 0.9])
def test_a_half_cut_shows_a_floor_of_flesh_as_deep_as_the_blade_went(depth: float) -> None:
    surface = half_cut(0.004, depth)
    rendering = Renderer(QUIET, CAMERA, bed()).render(surface, [], 0)

    # In the row of the principal point: the floor over 40 mm, the bed beside it.
    floor = 0.02 * CAMERA.focal / (0.08 + (depth - 0.5) * surface.thickness)
    assert (rendering.label[120] == Label.SEAM).sum() == pytest.approx(2 * floor, abs=2)
    assert set(rendering.label[120, 85:235]) == {Label.SEAM}
    np.testing.assert_allclose(rendering.depth[120, 85:235], 0.08 + (depth - 0.5) * surface.thickness, rtol=1e-5)
    assert (rendering.label[120, 20:70] == Label.BASE).all() and (rendering.label[120, 250:300] == Label.BASE).all()


def test_the_floor_of_a_half_cut_is_as_bright_as_flesh_and_not_as_dark_as_the_bed() -> None:
    rendering = Renderer(Look(noise=0.0, gloss=0.0), CAMERA, bed(0.083)).render(half_cut(0.004), [], 0)

    floor, dark = (rendering.image[interior(rendering.label == label)] for label in (Label.SEAM, Label.BASE))
    assert floor.max(axis=1).mean() > 0.7 * rendering.image[rendering.label == Label.TOP].max(axis=1).mean()
    assert floor.max(axis=1).mean() > 1.4 * dark.max(axis=1).mean()


def test_the_end_of_a_ligament_is_closed() -> None:
    surface = half_cut(0.004, 0.2, thickness=0.004)
    surface.positions[:, 0] -= 0.04  # its right end is now 20 mm to the left, and faces the camera

    rendering = Renderer(QUIET, CAMERA, bed()).render(surface, [], 0)

    # Along a row: the floor, then its end down to the underside, and only then the bed.
    row = rendering.label[120, :160]
    last = np.flatnonzero(row == Label.SEAM)[-1]
    assert (row[: last + 1] == Label.SEAM).all() and (row[last + 1 :] == Label.BASE).all()
    assert last == int(CAMERA.cu - 0.02 * CAMERA.focal / 0.082)
    assert rendering.depth[120, last] > 0.081  # the floor itself is at 0.0788


def test_ligaments_change_no_pixel_but_those_that_show_them() -> None:
    renderer = Renderer(QUIET, CAMERA, bed())
    surface = half_cut(0.004)

    joined = renderer.render(surface, [tool()], 0)
    parted = renderer.render(replace(surface, ligaments=Ligaments.none()), [tool()], 0)

    seam = joined.label == Label.SEAM
    assert seam.sum() > 500 and not (parted.label == Label.SEAM).any()
    for field in ("label", "depth", "triangle"):
        assert (getattr(joined, field)[~seam] == getattr(parted, field)[~seam]).all()


def test_a_closed_half_cut_is_drawn_as_whole_tissue_to_the_byte() -> None:
    surface = half_cut(0.0)

    joined = Renderer(Look(), CAMERA, bed()).render(surface, [tool()], 3)
    parted = Renderer(Look(), CAMERA, bed()).render(replace(surface, ligaments=Ligaments.none()), [tool()], 3)

    for field in ("image", "depth", "label", "triangle"):
        assert getattr(joined, field).tobytes() == getattr(parted, field).tobytes()


def test_a_ligament_that_tears_or_gives_way_shows_without_a_new_revision() -> None:
    renderer = Renderer(QUIET, CAMERA, bed())
    surface = half_cut(0.004, 0.3)
    whole = renderer.render(surface, [], 0)
    deeper = replace(surface, ligaments=replace(surface.ligaments, depth=surface.ligaments.depth + np.float32(0.4)))

    worse = renderer.render(deeper, [], 0)
    torn = renderer.render(replace(surface, ligaments=Ligaments.none()), [], 0)
    again = renderer.render(surface, [], 0)

    assert worse.depth[120, 160] - whole.depth[120, 160] == pytest.approx(0.4 * surface.thickness, rel=1e-2)
    assert torn.label[120, 160] == Label.BASE
    assert again.image.tobytes() == whole.image.tobytes() and again.label.tobytes() == whole.label.tobytes()


def test_the_bed_in_a_cavity_is_darker_than_the_open_bed() -> None:
    far = bed(0.09)
    open_bed = Renderer(QUIET, CAMERA, far).render(sheet(distance=0.2), [], 0)
    opening = Renderer(QUIET, CAMERA, far).render(sheet(hole=0.01, thickness=0.0015), [], 0)

    cavity = interior(opening.label == Label.BASE)
    cavity[:, :60] = cavity[:, 260:] = False
    assert cavity.sum() > 500
    assert opening.image[cavity].mean() < 0.75 * open_bed.image[cavity].mean()


def test_right_eye_disparity_is_focal_times_baseline_over_depth() -> None:
    renderer = Renderer(Look(noise=0.0, gloss=0.0, vignette=0.0), CAMERA, bed())
    left, right = renderer.render_pair(tent(), [], 0)

    v, u = np.mgrid[: CAMERA.height, : CAMERA.width].astype(np.float32)
    mask = interior(left.label == Label.TOP)
    mask[:, :40] = False
    # A patch is at its true place when moving it either way by half a pixel matches worse.
    error = []
    for shift in (-0.5, 0.0, 0.5):
        disparity = CAMERA.focal * CAMERA.baseline / left.depth + np.float32(shift)
        moved = cv2.remap(right.image, np.asarray(u - disparity), np.asarray(v), cv2.INTER_LINEAR)
        error.append(np.abs(moved.astype(float) - left.image)[mask].mean())
    assert error[1] < 0.75 * min(error[0], error[2])
    assert error[1] < 3.0  # grey levels


def test_right_eye_depth_is_that_of_a_camera_moved_by_the_baseline() -> None:
    renderer = Renderer(QUIET, CAMERA, bed())
    moved = replace(tent(), positions=tent().positions - np.array([CAMERA.baseline, 0, 0], np.float32))

    right = renderer.render(tent(), [], 0, eye=1)
    alone = renderer.render(moved, [], 0, eye=0)

    both = interior((right.label == Label.TOP) & (alone.label == Label.TOP))
    np.testing.assert_allclose(right.depth[both], alone.depth[both], rtol=2e-5)


def test_each_top_pixel_lies_within_the_triangle_it_names() -> None:
    surface = tent()
    rendering = Renderer(QUIET, CAMERA, bed()).render(surface, [tool()], 0)

    rows, columns = np.nonzero(rendering.label == Label.TOP)
    named = surface.triangles[rendering.triangle[rows, columns]]
    a, b, c = (CAMERA.project(surface.positions[named[:, k]].astype(np.float64)) for k in range(3))
    pixel = np.stack([columns, rows], axis=1).astype(float)

    def side(p: Array, q: Array) -> Array:
        return np.asarray((q[:, 0] - p[:, 0]) * (pixel[:, 1] - p[:, 1]) - (q[:, 1] - p[:, 1]) * (pixel[:, 0] - p[:, 0]))

    sides = np.stack([side(a, b), side(b, c), side(c, a)])
    assert (sides.max(axis=0) < 0.02).all()  # [px^2]; clockwise in (u, v)
    assert (rendering.triangle[~np.isin(rendering.label, (Label.TOP, Label.UNDERSIDE))] == -1).all()


def test_the_underside_of_a_turned_flap_is_seen_and_named() -> None:
    flat = sheet(thickness=0.001)
    positions = flat.positions.copy()
    right = flat.rest[:, 0] > 0
    positions[right, 0] *= -1  # folded over to the left, 5 mm nearer to the camera
    positions[right, 2] -= 0.005

    rendering = Renderer(QUIET, CAMERA, bed()).render(replace(flat, positions=positions), [], 0)

    assert rendering.label[120, 80] == Label.UNDERSIDE
    corners = flat.rest[flat.triangles[rendering.triangle[120, 80]]]
    expected = (160 - 80) / CAMERA.focal * rendering.depth[120, 80]
    assert corners[:, 0].mean() == pytest.approx(expected, abs=0.001)


def test_nothing_is_drawn_where_nothing_is() -> None:
    small = BaseSurface(bed().positions * np.array([0.1, 0.1, 1], np.float32), bed().triangles, bed().texture)

    rendering = Renderer(QUIET, CAMERA, small).render(sheet(distance=0.3), [], 0)

    empty = rendering.label == Label.NOTHING
    assert empty[0, 0] and not empty[120, 160]
    assert (rendering.depth[empty] == 0).all() and (rendering.triangle[empty] == -1).all()
    assert rendering.image[empty].max() < 30


@pytest.mark.parametrize("material", ["silicone", "chicken", "beef"])
def test_the_default_exposure_neither_saturates_nor_starves(material: str) -> None:
    rendering = Renderer(Look(material=material), CAMERA, bed()).render(tent(), [tool()], 0)

    top = rendering.image[rendering.label == Label.TOP]
    assert (top >= 254).mean() < 0.001
    assert 70 < top.mean() < 190
    assert (top.max(axis=1) < 30).mean() < 0.01


def test_light_falls_off_with_distance_and_towards_the_corners() -> None:
    renderer = Renderer(Look(noise=0.0, gloss=0.0, vignette=0.6), CAMERA, bed(0.2))
    near, far = (renderer.render(sheet(distance=z), [], 0).image for z in (0.05, 0.075))

    assert near[110:130, 150:170].mean() > 1.1 * far[110:130, 150:170].mean()
    assert near[:20, :20].mean() < 0.8 * near[110:130, 150:170].mean()


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"material": "wood"}, "look.material is 'wood'; it must be one of silicone, chicken, beef"),
        ({"seed": -1}, "look.seed is -1; it must be a whole number"),
        ({"size": (0.08, 8.0)}, r"look.size\[1\] is 8.0 m; it must lie between 0.005 and 0.5 m"),
        ({"noise": -1.0}, "look.noise is -1.0 grey levels; it must lie between 0 and 20"),
        ({"vignette": 1.5}, "look.vignette is 1.5; it must lie between 0 and 0.95"),
        ({"light": float("nan")}, "look.light is nan; it must lie between 0.01 and 20"),
    ],
)
def test_a_bad_look_is_refused_with_a_clear_sentence(change: dict[str, object], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        Look(**change)  # type: ignore[arg-type]


def test_an_unknown_tool_is_refused() -> None:
    renderer = Renderer(QUIET, CAMERA, bed())

    with pytest.raises(InputError, match="tool kind is 'hook'; it must be one of grasper, scissors"):
        renderer.render(sheet(), [tool("hook")], 0)


def test_a_sheet_that_is_not_finite_is_refused() -> None:
    broken = sheet()
    broken.positions[17, 2] = np.nan

    with pytest.raises(ValueError, match="not finite"):
        Renderer(QUIET, CAMERA, bed()).render(broken, [], 0)
