"""The two straight pulls: from the goal's middle to the grasp, and across the goal in the tissue's own plane."""

import numpy as np
import pytest

from hardware.codes import Code
from hardware.interface import CUTTER, GRASPER, Array, Pose
from skills.estimate.grid import grid_around
from skills.expose.pull import Exposure, PullConfig, Stop
from skills.expose.straight import Direction, SteeringStraight, away_from_middle, goal_normal
from skills.grasp import Grasped
from skills.scene.stereo import DepthMap, StereoConfig
from skills.skill import ImmediateExecutor
from skills.tracking.tracks import TrackedGoal
from tests.mocks.bench import CAMERA
from tests.mocks.table import Table
from tests.skills.goals import straight, tracked_goal
from tests.skills.pictures import plane_pair

DISTANCE = 0.08  # [m] of every tissue before the camera
HALF = 18.0  # [px] between the goal and either row
LENGTH = 0.5e-3  # [m] of a step
FACING = np.array([0.0, 0.0, -1.0])
UP = np.array([0.0, -1.0, 0.0])  # the picture
GRASP = np.array([0.004, -0.012, 0.070])  # [m]

HELD = Grasped(Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])), np.array([0.0, 0.0, -1.0]))


def tilted(about_x: float, about_y: float) -> Array:
    """Normal (3,) of a plane that faces the camera, then is turned by so many degrees about x and y."""
    a, b = np.deg2rad([about_x, about_y])
    turn_x = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    turn_y = np.array([[np.cos(b), 0, np.sin(b)], [0, 1, 0], [-np.sin(b), 0, np.cos(b)]])
    return np.asarray(turn_y @ turn_x @ FACING)


def rays() -> Array:
    """What each pixel looks along, (H, W, 3) with z = 1."""
    v, u = np.mgrid[0 : CAMERA.height, 0 : CAMERA.width].astype(np.float64)
    return np.stack([(u - CAMERA.cu) / CAMERA.focal, (v - CAMERA.cv) / CAMERA.focal, np.ones_like(u)], axis=-1)


def plane(normal: Array, noise: float = 0.0) -> DepthMap:
    """Depth of a plane through (0, 0, `DISTANCE`), with noise [m]."""
    depth = normal[2] * DISTANCE / (rays() @ normal)
    return DepthMap(0.0, depth + np.random.default_rng(0).normal(0.0, noise, depth.shape), 1.0)


def on_plane(pixels: Array, normal: Array) -> Array:
    """Points (N, 3) [m] of that plane seen at `pixels` (N, 2)."""
    along = CAMERA.unproject(pixels, np.ones(len(pixels)))
    return along * (normal[2] * DISTANCE / (along @ normal))[:, None]


def turned(degrees: float) -> TrackedGoal:
    """A straight goal through the picture's middle, turned in the picture; its grasp's side is up before it is turned."""
    middle = np.array([320.0, 240.0])
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return tracked_goal((straight() - middle) @ np.array([[c, s], [-s, c]]) + middle, HALF)


def across_plane(goal: TrackedGoal, normal: Array) -> Array:
    """Unit vector (3,) in the plane, across the goal's chord, to the near row: by construction, not by a fit."""
    start, end = on_plane(goal.polyline[[0, -1]], normal)
    across = np.cross(normal, end - start)
    across = across / np.linalg.norm(across)
    near, far = (on_plane(row, normal).mean(axis=0) for row in (goal.near, goal.far))
    return np.asarray(across if across @ (near - far) > 0 else -across)


def degrees_between(a: Array, b: Array) -> float:
    """Angle between two unit vectors [degrees]."""
    return float(np.rad2deg(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def naive(depth: DepthMap) -> Array:
    """The naive pull of a straight goal that lies level."""
    vector = away_from_middle(turned(0.0), depth, CAMERA, GRASP)
    assert vector is not None
    return vector


def normal_of(goal: TrackedGoal, depth: DepthMap) -> Array:
    """The goal's normal, which is known."""
    vector = goal_normal(goal, depth, CAMERA)
    assert vector is not None
    return vector


# Naive


def test_the_naive_pull_goes_from_the_goals_middle_to_the_grasp():
    middle = CAMERA.unproject(np.array([[320.0, 240.0]]), np.array([DISTANCE]))[0]

    assert naive(plane(FACING)) == pytest.approx((GRASP - middle) / np.linalg.norm(GRASP - middle), abs=1e-6)


def test_the_naive_pull_looks_at_the_middle_third_of_both_rows_only():
    outer = plane(FACING).depth.copy()
    outer[:, :260] = outer[:, 380:] = 0.06

    assert naive(DepthMap(0.0, outer, 1.0)) == pytest.approx(naive(plane(FACING)), abs=1e-9)


def test_the_naive_pull_is_not_turned_by_a_few_wild_depths():
    wild = plane(FACING).depth.copy()
    wild[:, 305:330] = 0.05

    assert degrees_between(naive(DepthMap(0.0, wild, 1.0)), naive(plane(FACING))) < 3.0


def test_the_naive_pull_needs_the_depth_of_the_middle():
    depth = plane(FACING).depth.copy()
    depth[:, 240:400] = np.nan

    assert away_from_middle(turned(0.0), DepthMap(0.0, depth, 1.0), CAMERA, GRASP) is None


# Along the goal's normal


@pytest.mark.parametrize("degrees", [0.0, 35.0, 90.0, 200.0])
@pytest.mark.parametrize("tilt", [(0.0, 0.0), (20.0, 0.0), (-40.0, 0.0), (0.0, 30.0), (25.0, -25.0)])
def test_the_goals_normal_lies_in_the_tissue_across_the_goal_on_the_grasps_side(tilt, degrees):
    goal, normal = turned(degrees), tilted(*tilt)
    start, end = on_plane(goal.polyline[[0, -1]], normal)
    chord = (end - start) / np.linalg.norm(end - start)

    vector = normal_of(goal, plane(normal))

    assert np.linalg.norm(vector) == pytest.approx(1.0)
    assert abs(vector @ normal) < np.sin(np.deg2rad(0.5))
    assert abs(vector @ chord) < np.sin(np.deg2rad(0.5))
    near, far = (on_plane(row, normal).mean(axis=0) for row in (goal.near, goal.far))
    assert vector @ (near - far) > 0


def test_a_tissue_that_faces_the_camera_is_pulled_along_the_picture():
    assert normal_of(turned(0.0), plane(FACING)) == pytest.approx(UP, abs=1e-3)


def test_a_sloped_tissue_is_pulled_along_its_slope_to_either_side():
    up_the_picture = np.array([0.0, -np.cos(np.deg2rad(20.0)), -np.sin(np.deg2rad(20.0))])
    depth = plane(tilted(20.0, 0.0))

    assert degrees_between(normal_of(turned(0.0), depth), up_the_picture) < 0.5
    assert degrees_between(normal_of(turned(180.0), depth), -up_the_picture) < 0.5


def test_noise_of_stereo_turns_the_goals_normal_by_few_degrees():
    normal = tilted(20.0, 10.0)

    vector = normal_of(turned(20.0), plane(normal, noise=0.3e-3))

    assert degrees_between(vector, across_plane(turned(20.0), normal)) < 3.0


@pytest.mark.parametrize("tilt", [(0.0, 0.0), (30.0, 0.0)])
def test_a_curved_goal_is_pulled_across_its_chord(tilt):
    t = np.linspace(0.0, 1.0, 41)
    # A hook: nearly level at first, steep at its end.
    hook = np.column_stack([480.0 - 300.0 * t, 260.0 - 90.0 * t**3])
    goal, normal = tracked_goal(hook, HALF), tilted(*tilt)

    vector = normal_of(goal, plane(normal))

    assert degrees_between(vector, across_plane(goal, normal)) < 2.0
    start = tracked_goal(np.column_stack([480.0 - 300.0 * t, np.full(41, 260.0)]), HALF)
    assert degrees_between(vector, across_plane(start, normal)) > 8.0


@pytest.mark.parametrize("sag", [2e-3, 4e-3, 8e-3, 15e-3])
def test_a_tissue_that_is_curved_along_the_goal_is_pulled_across_it_all_the_same(sag):
    along = rays()[..., 0] * DISTANCE
    bowl = DepthMap(0.0, DISTANCE + sag * (along / 0.02) ** 2, 1.0)

    vector = normal_of(turned(0.0), bowl)

    assert degrees_between(vector, UP) < 5.0


@pytest.mark.parametrize("columns", [slice(305, 330), slice(470, 490)])
def test_a_tool_before_a_few_stations_does_not_turn_the_goals_normal(columns):
    depth = plane(FACING).depth.copy()
    depth[:240, columns] -= 0.02

    vector = normal_of(turned(0.0), DepthMap(0.0, depth, 1.0))

    assert degrees_between(vector, UP) < 5.0


def test_where_no_depth_is_known_there_is_no_normal():
    nothing = DepthMap(0.0, np.full((CAMERA.height, CAMERA.width), np.nan), 0.0)

    assert goal_normal(turned(0.0), nothing, CAMERA) is None


@pytest.mark.parametrize("rows", [slice(0, 240), slice(240, 480)])
def test_the_goals_normal_needs_the_depth_of_both_rows(rows):
    depth = plane(FACING).depth.copy()
    depth[rows] = np.nan

    assert goal_normal(turned(0.0), DepthMap(0.0, depth, 1.0), CAMERA) is None


def test_holes_in_the_depth_do_not_turn_the_goals_normal():
    goal, normal = turned(0.0), tilted(20.0, 0.0)
    depth = plane(normal).depth.copy()
    depth[:240, 160:220] = depth[240:, 400:480] = np.nan

    vector = normal_of(goal, DepthMap(0.0, depth, 1.0))

    assert degrees_between(vector, across_plane(goal, normal)) < 1.0


# As a steering


@pytest.fixture(scope="module")
def sloped():
    """A stereo pair of a plane tilted by 20 degrees about x, and its normal."""
    normal = tilted(20.0, 0.0)
    pair, _ = plane_pair(CAMERA, normal, DISTANCE)
    return pair, normal


def looking(table: Table, direction: Direction, goal: TrackedGoal) -> tuple[SteeringStraight, Stop | None]:
    """A steering that has looked at the goal, and what it said."""
    steering = SteeringStraight(direction, LENGTH, StereoConfig(), ImmediateExecutor())
    return steering, table.finish(steering.begin(table.lease, goal, grid_around(goal, HALF), HELD))


def shown(pair) -> Table:
    """A table whose endoscope shows `pair`."""
    table = Table()
    table.bench.eye.image, table.bench.eye.right_image = pair.left.image, pair.right
    return table


def wanted_of(direction: Direction, table: Table, goal: TrackedGoal, normal: Array) -> Array:
    """Unit vector (3,) that follows from the known plane."""
    if direction is Direction.GOAL_NORMAL:
        return across_plane(goal, normal)
    away = table.lease.measured_cp(GRASPER).value.position - np.array([0.0, 0.0, DISTANCE])
    return np.asarray(away / np.linalg.norm(away))


@pytest.mark.parametrize("direction", list(Direction))
def test_seen_in_stereo_every_step_is_the_same_and_as_long_as_asked_for(direction, sloped):
    pair, normal = sloped
    table, goal = shown(pair), turned(0.0)

    steering, stop = looking(table, direction, goal)
    steps = np.array([table.finish(steering.step(table.lease, np.zeros(3), number)) for number in (1, 2, 35)])

    assert stop is None
    assert np.linalg.norm(steps[0]) == pytest.approx(LENGTH)
    assert (steps == steps[0]).all()
    assert degrees_between(steps[0] / LENGTH, wanted_of(direction, table, goal, normal)) < 2.0


@pytest.mark.parametrize("direction", list(Direction))
def test_what_has_no_depth_is_not_pulled(direction):
    table = Table()

    _, stop = looking(table, direction, turned(0.0))

    assert stop is not None
    assert (stop.code, stop.stopped_by) == (Code.DEPTH_INVALID, Code.DEPTH_INVALID)
    assert table.bench.motions() == []


@pytest.mark.parametrize("direction", list(Direction))
def test_a_whole_straight_exposure_follows_one_line(direction, sloped):
    pair, normal = sloped
    table, goal = shown(pair), turned(0.0)
    table.pull(0.3)
    start = table.lease.setpoint_cp(GRASPER)
    vector = wanted_of(direction, table, goal, normal)
    grid = grid_around(goal, HALF)

    def referenced():
        yield from ()
        return grid

    steering = SteeringStraight(direction, LENGTH, StereoConfig(), ImmediateExecutor())
    exposure = Exposure(PullConfig(), steering)
    steps = exposure.run(table.lease, lambda: goal, Grasped(start, -normal), table.lease.setpoint_cp(CUTTER), referenced)
    outcome = table.finish(steps)

    assert (outcome.code, outcome.stopped_by) == (Code.OK, Code.EXPOSURE_STEPS_DONE)
    offset = outcome.path - start.position
    assert np.linalg.norm(offset, axis=1) == pytest.approx(LENGTH * np.arange(1, 36))
    assert degrees_between(offset[-1] / np.linalg.norm(offset[-1]), vector) < 2.0
    assert np.linalg.norm(np.cross(offset, offset[-1]), axis=1).max() < 1e-12
    assert outcome.forecast is None
    assert outcome.planned is None
    assert table.bench.holding()
