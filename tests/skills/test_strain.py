"""The strain of the tissue beside the goal: what counts as stretch, what does not, and how much of what is seen may be wrong."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from hardware.interface import Array, CameraModel
from skills.estimate.grid import grid_around
from skills.scene.goal import Goal
from skills.scene.stereo import DepthMap, depth_from_stereo
from skills.tracking.goal_tracker import GoalTracker
from skills.tracking.strain import StrainConfig, StrainGauge
from tests.mocks.bench import CAMERA
from tests.skills.goals import straight, tracked_goal
from tests.skills.pictures import SIZE, coloured, frame, opened, plane_pair, speckle

GRID = grid_around(tracked_goal(straight(240.0)), 8.0)  # 28 stations along u, three rows on either side of v = 240
COUNT = len(GRID.points)
COLUMNS = int(GRID.crosses_goal.sum())
AT_REST = np.eye(2)
NOISE = 0.3e-3  # [m]


class Plane:
    """A plane through (0, 0, `distance`) [m] that is turned by `tilt` towards `azimuth` [degrees]; tissue on it is at (a, b) [m]."""

    def __init__(self, tilt: float = 0.0, azimuth: float = 0.0, distance: float = 0.08) -> None:
        t, a = np.deg2rad([tilt, azimuth])
        self.normal = np.array([np.sin(t) * np.cos(a), np.sin(t) * np.sin(a), np.cos(t)])
        self._centre = np.array([0.0, 0.0, distance])
        first = np.array([1.0, 0.0, 0.0]) - self.normal[0] * self.normal
        first = first / np.linalg.norm(first)
        self._axes = np.array([first, np.cross(self.normal, first)])

    def depth(self) -> DepthMap:
        """What a perfect stereo camera measures."""
        v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
        rays = np.stack([(u - CAMERA.cu) / CAMERA.focal, (v - CAMERA.cv) / CAMERA.focal, np.ones(u.shape)], axis=-1)
        return DepthMap(0.0, (self._centre @ self.normal) / (rays @ self.normal), 1.0)

    def tissue_at(self, pixels: Array) -> Array:
        """The tissue (N, 2) [m] that is seen at `pixels` (N, 2)."""
        rays = CAMERA.unproject(pixels, np.ones(len(pixels)))
        return np.asarray((rays * ((self._centre @ self.normal) / (rays @ self.normal))[:, None] - self._centre) @ self._axes.T)

    def pixels_of(self, tissue: Array) -> Array:
        """Where `tissue` (N, 2) [m] is seen."""
        return CAMERA.project(self._centre + tissue @ self._axes)


@dataclass(frozen=True)
class Seen:
    """What a gauge is given."""

    points: Array
    visible: NDArray[np.bool_]
    confidence: Array
    depth: DepthMap


def look(plane: Plane, then: Plane | None = None, deformation: Array = AT_REST) -> Seen:
    """The keypoints of `plane` on the plane `then`, deformed by (2, 2) in the tissue."""
    then = then or plane
    points = then.pixels_of(plane.tissue_at(GRID.points) @ deformation.T)
    return Seen(points, np.ones(COUNT, dtype=bool), np.ones(COUNT), then.depth())


def gauge(plane: Plane, config: StrainConfig | None = None) -> StrainGauge:
    return StrainGauge(GRID, plane.depth(), CAMERA, config)


def read(gauge: StrainGauge, seen: Seen) -> float:
    return gauge.read(seen.points, seen.visible, seen.confidence, seen.depth)


def stretched_across(plane: Plane, strain: float) -> Array:
    """The deformation (2, 2) of tissue on `plane` that lengthens what lies across the goal and leaves what lies along it."""
    u, v = CAMERA.cu, CAMERA.cv
    ends = plane.tissue_at(np.array([[u, v - 40], [u, v + 40], [u - 40, v], [u + 40, v]]))
    basis = np.column_stack([ends[1] - ends[0], ends[3] - ends[2]])
    return np.asarray(basis @ np.diag([1.0 + strain, 1.0]) @ np.linalg.inv(basis))


def lengthened(plane: Plane, deformation: Array) -> Array:
    """By how much `deformation` lengthens each edge (E,) that does not cross the goal."""
    tissue = plane.tissue_at(GRID.points)
    apart = tissue[GRID.edges[~GRID.crosses_goal]]
    edge = apart[:, 1] - apart[:, 0]
    return np.asarray(np.linalg.norm(edge @ deformation.T, axis=1) / np.linalg.norm(edge, axis=1) - 1.0)


def with_holes(depth: DepthMap, holes: NDArray[np.bool_]) -> DepthMap:
    return replace(depth, depth=np.where(holes, np.nan, depth.depth))


def noisy(depth: DepthMap, rng: np.random.Generator, patch: int = 1) -> DepthMap:
    """Depth with noise of `NOISE`, the same over about `patch` [px]."""
    noise = cv2.blur(rng.normal(size=depth.depth.shape), (patch, patch))
    return replace(depth, depth=depth.depth + NOISE * noise / noise.std())


def mistracked(seen: Seen, rng: np.random.Generator) -> Seen:
    """One keypoint in ten is 15 px off, whichever way, and the tracker is as sure of it as of the others."""
    wrong = rng.choice(COUNT, COUNT // 10, replace=False)
    way = rng.uniform(0.0, 2.0 * np.pi, len(wrong))
    points = seen.points.copy()
    points[wrong] += 15.0 * np.column_stack([np.cos(way), np.sin(way)])
    return replace(seen, points=points)


# What strain is, and what it is not


@pytest.mark.parametrize(("tilt", "azimuth"), [(0, 0), (30, 0), (30, 90), (30, 60), (50, 0), (50, 90), (50, 200)])
def test_tissue_stretched_by_a_fifth_across_the_goal_reads_so_at_any_tilt(tilt: float, azimuth: float) -> None:
    plane = Plane(tilt, azimuth)

    assert read(gauge(plane), look(plane, deformation=stretched_across(plane, 0.2))) == pytest.approx(0.2, abs=0.02)


@settings(deadline=None, derandomize=True, max_examples=40)
@given(st.floats(0, 45), st.floats(0, 360), st.floats(0, 45), st.floats(0, 360), st.floats(0.065, 0.1), st.floats(-0.1, 0.4))
def test_the_strain_is_that_of_the_tissue_wherever_it_goes(
    tilt: float, azimuth: float, tilt_then: float, azimuth_then: float, distance: float, strain: float
) -> None:
    plane = Plane(tilt, azimuth)
    deformation = stretched_across(plane, strain)
    truth = float(np.percentile(lengthened(plane, deformation), 90.0))

    assert read(gauge(plane), look(plane, Plane(tilt_then, azimuth_then, distance), deformation)) == pytest.approx(
        truth, abs=0.02
    )


@pytest.mark.parametrize(("tilt", "azimuth"), [(0, 0), (30, 0), (30, 90), (50, 45)])
def test_coming_a_fifth_nearer_to_the_camera_is_no_strain(tilt: float, azimuth: float) -> None:
    plane = Plane(tilt, azimuth)
    seen = look(plane, Plane(tilt, azimuth, 0.064))

    assert np.ptp(seen.points[:, 0]) > 1.2 * np.ptp(GRID.points[:, 0])
    assert read(gauge(plane), seen) == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize(("tilt", "azimuth"), [(30, 0), (30, 90), (50, 45), (50, 90)])
def test_turning_to_face_the_camera_is_no_strain(tilt: float, azimuth: float) -> None:
    plane = Plane(tilt, azimuth)

    assert read(gauge(plane), look(plane, Plane())) == pytest.approx(0.0, abs=0.005)


@pytest.mark.parametrize(("tilt", "azimuth"), [(30, 0), (30, 90), (50, 45), (50, 90)])
def test_stretch_is_told_from_turning_and_coming_nearer_at_once(tilt: float, azimuth: float) -> None:
    plane = Plane(tilt, azimuth)
    there = Plane(0.0, 0.0, 0.064)

    assert read(gauge(plane), look(plane, there)) == pytest.approx(0.0, abs=0.01)
    assert read(gauge(plane), look(plane, there, stretched_across(plane, 0.2))) == pytest.approx(0.2, abs=0.01)


def test_an_opening_cut_whose_near_side_is_lifted_is_no_strain() -> None:
    plane = Plane()
    points, depth = GRID.points.copy(), plane.depth().depth.copy()
    near = GRID.near_side
    points[near] = CAMERA.project(CAMERA.unproject(points[near], np.full(near.sum(), 0.08)) - np.array([0.0, 3e-3, 6e-3]))
    edge = points[near][:, 1].max()
    depth[: int(edge) + 4] = 0.074

    seen = Seen(points, np.ones(COUNT, dtype=bool), np.ones(COUNT), DepthMap(0.0, depth, 1.0))

    assert edge < 212.0
    assert read(gauge(plane), seen) == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("axis", [0, 1], ids=["along the goal", "across it"])
def test_rolling_up_without_stretch_is_no_strain(axis: int) -> None:
    plane, radius = Plane(), 0.025
    tissue = plane.tissue_at(GRID.points)
    angle = tissue[:, axis] / radius
    bent = np.column_stack([tissue, 0.08 + radius * (1.0 - np.cos(angle))])
    bent[:, axis] = radius * np.sin(angle)
    # A ray x = slope z meets the cylinder x^2 + (z - b)^2 = radius^2 first at the lesser z.
    slope = (np.arange(CAMERA.width) - CAMERA.cu if axis == 0 else np.arange(CAMERA.height) - CAMERA.cv) / CAMERA.focal
    a, b = 1.0 + slope**2, 0.08 + radius
    inside = b**2 - a * (b**2 - radius**2)
    z = np.where(inside > 0.0, (b - np.sqrt(np.abs(inside))) / a, np.nan)
    depth = np.broadcast_to(z if axis == 0 else z[:, None], (CAMERA.height, CAMERA.width))

    seen = Seen(CAMERA.project(bent), np.ones(COUNT, dtype=bool), np.ones(COUNT), DepthMap(0.0, depth, 1.0))

    assert read(gauge(plane), seen) == pytest.approx(0.0, abs=0.01)


def test_half_of_the_edges_stretched_by_a_third_are_told_and_the_other_half_does_not_hide_them() -> None:
    plane = Plane()
    seen, near = look(plane), GRID.near_side
    fixed = np.array([CAMERA.cu, 240.0])
    points = seen.points.copy()
    points[near] = fixed + 1.3 * (points[near] - fixed)
    seen = replace(seen, points=points)

    assert read(gauge(plane), seen) == pytest.approx(0.3, abs=0.01)
    assert read(gauge(plane, StrainConfig(percentile=40.0)), seen) == pytest.approx(0.0, abs=0.01)


def test_shortened_tissue_reads_below_nought() -> None:
    plane = Plane(20.0, 70.0)

    assert read(gauge(plane), look(plane, deformation=0.9 * AT_REST)) == pytest.approx(-0.1, abs=0.005)


# What may be wrong with what is seen


@pytest.mark.parametrize("strain", [0.0, 0.2])
@pytest.mark.parametrize("seed", range(5))
def test_one_keypoint_in_ten_mistracked_changes_little(strain: float, seed: int) -> None:
    plane = Plane(30.0, 60.0)
    seen = look(plane, deformation=stretched_across(plane, strain))

    assert read(gauge(plane), mistracked(seen, np.random.default_rng(seed))) == pytest.approx(read(gauge(plane), seen), abs=0.05)


@pytest.mark.parametrize("strain", [0.0, 0.2])
@pytest.mark.parametrize("seed", range(5))
def test_noise_of_the_depth_changes_little(strain: float, seed: int) -> None:
    plane, rng = Plane(30.0, 60.0), np.random.default_rng(seed)
    seen = look(plane, deformation=stretched_across(plane, strain))
    noisy_gauge = StrainGauge(GRID, noisy(plane.depth(), rng), CAMERA)

    assert read(noisy_gauge, replace(seen, depth=noisy(seen.depth, rng))) == pytest.approx(read(gauge(plane), seen), abs=0.05)


@pytest.mark.parametrize("seed", range(5))
def test_noise_that_is_the_same_over_a_whole_window_of_the_depth_changes_little(seed: int) -> None:
    plane = Plane(30.0, 60.0)
    seen = look(plane)

    assert read(gauge(plane), replace(seen, depth=noisy(seen.depth, np.random.default_rng(seed), 11))) < 0.05


@pytest.mark.parametrize(
    "holes",
    [
        lambda u, v: np.abs(u - 280) < 30,
        lambda u, v: (u // 8 + v // 8) % 2 == 0,
        lambda u, v: np.random.default_rng(0).random(u.shape) < 0.6,
    ],
    ids=["a band across the goal", "a chequerboard", "specks"],
)
def test_holes_in_the_depth_are_tolerated(holes: Callable[[Array, Array], NDArray[np.bool_]]) -> None:
    plane = Plane(30.0, 60.0)
    seen = look(plane, deformation=stretched_across(plane, 0.2))
    v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    hole = holes(u, v)

    assert read(gauge(plane), replace(seen, depth=with_holes(seen.depth, hole))) == pytest.approx(0.2, abs=0.03)
    assert read(StrainGauge(GRID, with_holes(plane.depth(), hole), CAMERA), seen) == pytest.approx(0.2, abs=0.03)


@pytest.mark.parametrize("tissue_strain", [0.0, 0.2])
def test_a_tool_before_some_keypoints_is_tolerated(tissue_strain: float) -> None:
    plane = Plane(30.0, 60.0)
    seen = look(plane, deformation=stretched_across(plane, tissue_strain))
    v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    tool = (np.abs(u - 280) < 14) & (v < 240)
    behind = (np.abs(seen.points[:, 0] - 280) < 18) & GRID.near_side
    covered = replace(seen.depth, depth=seen.depth.depth - np.where(tool, 8e-3, 0.0))

    reading = read(gauge(plane), replace(seen, visible=~behind, depth=covered))

    assert behind.sum() >= 9
    assert reading == pytest.approx(read(gauge(plane), seen), abs=0.02)


def test_a_tool_before_some_keypoints_of_the_reference_is_tolerated() -> None:
    plane = Plane(30.0, 60.0)
    seen = look(plane, deformation=stretched_across(plane, 0.2))
    v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width]
    covered = plane.depth().depth - np.where((np.abs(u - 280) < 18) & (v < 235), 8e-3, 0.0)

    assert read(StrainGauge(GRID, DepthMap(0.0, covered, 1.0), CAMERA), seen) == pytest.approx(read(gauge(plane), seen), abs=0.02)


@pytest.mark.parametrize("share", [0.2, 0.4, 0.6])
@pytest.mark.parametrize("which", ["hidden", "unsure", "not finite"])
def test_keypoints_that_are_not_seen_well_are_left_out(share: float, which: str) -> None:
    plane, rng = Plane(30.0, 60.0), np.random.default_rng(3)
    seen = look(plane, deformation=stretched_across(plane, 0.2))
    away = rng.random(COUNT) < share
    points, visible, confidence = seen.points.copy(), seen.visible.copy(), seen.confidence.copy()
    points[away] = rng.uniform(0.0, 480.0, (int(away.sum()), 2)) if which != "not finite" else [np.nan, np.inf]
    if which == "hidden":
        visible[away] = False
    if which == "unsure":
        confidence[away] = 0.3

    reading = read(gauge(plane), Seen(points, visible, confidence, seen.depth))

    assert reading == pytest.approx(read(gauge(plane), seen), abs=0.01)


# What says nothing


def nothing(seen: Seen) -> Seen:
    return replace(seen, visible=np.zeros(COUNT, dtype=bool))


def nothing_finite(seen: Seen) -> Seen:
    return replace(seen, points=np.full((COUNT, 2), np.nan))


def nothing_sure(seen: Seen) -> Seen:
    return replace(seen, confidence=np.full(COUNT, np.nan))


def no_depth(seen: Seen) -> Seen:
    return replace(seen, depth=with_holes(seen.depth, np.ones(seen.depth.depth.shape, dtype=bool)))


def outside_the_image(seen: Seen) -> Seen:
    return replace(seen, points=seen.points + np.array([2000.0, 0.0]))


def no_neighbours(seen: Seen) -> Seen:
    row, column = np.divmod(np.arange(COUNT), COLUMNS)
    return replace(seen, visible=(row + column) % 2 == 0)


def five_to_a_side(seen: Seen) -> Seen:
    row, column = np.divmod(np.arange(COUNT), COLUMNS)
    return replace(seen, visible=(column < 2) & ((column == 1) | (row % 5 != 0)))


@pytest.mark.parametrize(
    "spoiled", [nothing, nothing_finite, nothing_sure, no_depth, outside_the_image, no_neighbours, five_to_a_side]
)
def test_too_little_seen_is_no_reading(spoiled: Callable[[Seen], Seen]) -> None:
    plane = Plane(20.0, 70.0)
    measure, seen = gauge(plane), look(plane)

    assert np.isnan(read(measure, spoiled(seen)))
    assert np.isfinite(read(measure, seen))


def test_fewer_edges_than_asked_for_are_no_reading() -> None:
    plane = Plane()
    beside = int((~GRID.crosses_goal).sum())

    assert np.isfinite(read(gauge(plane, StrainConfig(min_edges=20)), look(plane)))
    assert np.isnan(read(gauge(plane, StrainConfig(min_edges=beside + 1)), look(plane)))


def test_a_reference_without_depth_is_never_read() -> None:
    plane = Plane()
    blind = StrainGauge(GRID, with_holes(plane.depth(), np.ones((CAMERA.height, CAMERA.width), dtype=bool)), CAMERA)

    assert np.isnan(read(blind, look(plane)))


def test_one_side_of_the_goal_is_enough() -> None:
    plane = Plane(20.0, 70.0)
    seen = look(plane, deformation=stretched_across(plane, 0.2))
    v = np.arange(CAMERA.height)[:, None]

    assert read(gauge(plane), replace(seen, visible=GRID.near_side)) == pytest.approx(0.2, abs=0.02)
    assert read(StrainGauge(GRID, with_holes(plane.depth(), v > 240), CAMERA), seen) == pytest.approx(0.2, abs=0.02)


# The same again, and nothing touched


def test_readings_repeat_and_leave_what_they_are_given_as_it_was() -> None:
    plane, rng = Plane(30.0, 60.0), np.random.default_rng(9)
    seen = mistracked(look(plane, deformation=stretched_across(plane, 0.2)), rng)
    seen = replace(seen, depth=noisy(seen.depth, rng))
    given = [values.copy() for values in (seen.points, seen.visible, seen.confidence, seen.depth.depth)]
    measure = gauge(plane)

    readings = {read(measure, seen), read(measure, seen), read(gauge(plane), seen)}

    assert len(readings) == 1
    for values, before in zip((seen.points, seen.visible, seen.confidence, seen.depth.depth), given, strict=True):
        assert np.array_equal(values, before)


# With the real matcher, with the real tracker


@pytest.mark.parametrize(("tilt", "azimuth"), [(30, 60), (0, 0)])
def test_real_stereo_of_a_plane_that_came_nearer_shows_little_strain(tilt: float, azimuth: float) -> None:
    plane, there = Plane(tilt, azimuth), Plane(0.0, 0.0, 0.07)
    before, _ = plane_pair(CAMERA, plane.normal, 0.08, seed=1)
    after, _ = plane_pair(CAMERA, there.normal, 0.07, seed=2)
    measure = StrainGauge(GRID, depth_from_stereo(before, CAMERA), CAMERA)
    depth = depth_from_stereo(after, CAMERA)

    assert abs(read(measure, replace(look(plane, there), depth=depth))) < 0.05
    stretch = look(plane, there, stretched_across(plane, 0.2))
    assert read(measure, replace(stretch, depth=depth)) == pytest.approx(0.2, abs=0.05)


@pytest.mark.parametrize(("gap", "stretch"), [(20.0, 0.0), (0.0, 0.15), (12.0, 0.15)])
def test_tracked_keypoints_show_the_stretch_and_not_the_opening(gap: float, stretch: float) -> None:
    texture, line = speckle(4), 120.0
    camera = CameraModel(width=SIZE[0], height=SIZE[1], focal=310.0, cu=159.5, cv=119.5, baseline=4.3e-3)
    depth = DepthMap(0.0, np.full(SIZE[::-1], 0.08), 1.0)
    tracker = GoalTracker()
    tracker.start(
        frame(coloured(texture, 1.0, 0), 0), Goal(np.array([[70.0, line], [250.0, line]]), np.array([160.0, 80.0]), SIZE)
    )
    measure = StrainGauge(tracker.mark_reference(frame(coloured(texture, 1.0, 1), 1)), depth, camera)
    for k in range(1, 11):
        picture, _ = opened(texture, gap * k / 10, line, stretch * k / 10)
        tracker.update(frame(coloured(picture, 1.0, k), k + 1))
    _, tracks, _ = tracker.grid_tracks()

    assert measure.read(tracks.points, tracks.visible, tracks.confidence, depth) == pytest.approx(stretch, abs=0.04)


@pytest.mark.parametrize("tilt", [0.0, 30.0])
@pytest.mark.parametrize(
    ("low", "high"),
    [(226, 241), (195, 213), (213, 241), (255, 300)],
    ids=["innermost row", "outermost row", "two rows", "two far rows"],
)
@pytest.mark.parametrize("when", ["now", "at the reference"])
def test_rows_without_depth_are_tolerated(tilt, low, high, when):
    plane = Plane(tilt, 60.0)
    seen = look(plane, deformation=stretched_across(plane, 0.2))
    v = np.arange(CAMERA.height)[:, None]
    hole = (v > low) & (v < high)
    if when == "now":
        reading = read(gauge(plane), replace(seen, depth=with_holes(seen.depth, hole)))
    else:
        reading = read(StrainGauge(GRID, with_holes(plane.depth(), hole), CAMERA), seen)
    assert reading == pytest.approx(0.2, abs=0.08)


def test_a_noisy_reference_with_depth_of_one_end_only_makes_up_nothing():
    plane, rng = Plane(30.0, 60.0), np.random.default_rng(0)
    u = np.arange(CAMERA.width)[None, :]
    reference = with_holes(noisy(plane.depth(), rng, 11), u < 340)
    seen = look(plane)
    seen = replace(seen, depth=with_holes(noisy(seen.depth, rng, 11), u < 340))
    assert abs(read(StrainGauge(GRID, reference, CAMERA), seen)) < 0.1


@pytest.mark.parametrize("strain", [0.2, 0.5])
def test_edges_along_the_goal_alone_do_not_say_that_nothing_is_stretched_across_it(strain):
    plane = Plane(30.0, 60.0)
    seen = look(plane, deformation=stretched_across(plane, strain))
    row = np.arange(COUNT) // COLUMNS
    assert not read(gauge(plane), replace(seen, visible=(row == 0) | (row == 5))) < 0.1


@pytest.mark.parametrize("length", [40.0, 50.0, 60.0, 66.0])
def test_short_goals_can_be_read_too(length):
    short = grid_around(tracked_goal(straight(length)), 18.0)
    plane = Plane(20.0, 60.0, 0.13)
    measure, n = StrainGauge(short, plane.depth(), CAMERA), len(short.points)
    points = plane.pixels_of(plane.tissue_at(short.points) @ stretched_across(plane, 0.2).T)
    assert measure.read(points, np.ones(n, bool), np.ones(n), plane.depth()) == pytest.approx(0.2, abs=0.03)
