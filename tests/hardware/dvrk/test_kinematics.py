"""The arm's kinematics: reference values, the way back, and what the arm would silently alter."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware.dvrk.instruments import Instrument, instrument
from hardware.dvrk.kinematics import (
    ENTER_DEPTH,
    KEEP_DEPTH,
    Reach,
    check_pose,
    clipped_by,
    depth,
    forward,
    frames,
    insertion,
    inverse,
    jacobian,
)
from hardware.interface import Array

NEEDLE_DRIVER, POTTS = instrument("LARGE_NEEDLE_DRIVER:400006"), instrument("POTTS_SCISSORS:400001")
FENESTRATED, SPATULA = instrument("FENESTRATED_BIPOLAR_FORCEPS:400205"), instrument("PERMANENT_CAUTERY_SPATULA:400184")
TOOLS = (NEEDLE_DRIVER, POTTS, FENESTRATED, SPATULA)

HOME = (0.0, 0.0, 0.12, 0.0, 0.0, 0.0)
BENT = (0.3, -0.2, 0.15, 0.5, 0.4, -0.3)
WIDE = (-0.5, 0.4, 0.2, -1.2, -0.6, 0.7)
ROTATIONS = {
    HOME: [[0, 1, 0], [1, 0, 0], [0, 0, -1]],
    BENT: [[0.487188, 0.859887, -0.152451], [0.869560, -0.493787, -0.006306], [-0.080700, -0.129493, -0.988291]],
    WIDE: [[-0.481576, 0.667052, -0.568441], [0.495341, 0.742238, 0.451353], [0.722995, -0.064211, -0.687863]],
}
# Computed independently from the dVRK's own kinematic and tool files
REFERENCE = [
    (NEEDLE_DRIVER, HOME, (0.0, 0.0, -0.1135)),
    (POTTS, HOME, (0.0, 0.0, -0.1135)),
    (FENESTRATED, HOME, (0.0, 0.0, -0.1151)),
    (SPATULA, HOME, (0.0, 0.0, -0.1137)),
    (NEEDLE_DRIVER, BENT, (0.039913, 0.025318, -0.134778)),
    (POTTS, BENT, (0.039913, 0.025318, -0.134778)),
    (FENESTRATED, BENT, (0.040087, 0.025075, -0.136350)),
    (SPATULA, BENT, (0.039935, 0.025288, -0.134974)),
    (NEEDLE_DRIVER, WIDE, (-0.089294, -0.073019, -0.153463)),
    (POTTS, WIDE, (-0.089294, -0.073019, -0.153463)),
    (FENESTRATED, WIDE, (-0.090677, -0.073231, -0.154239)),
    (SPATULA, WIDE, (-0.089467, -0.073045, -0.153560)),
]
ORIGIN = np.array(HOME)
ROLL, WRIST_PITCH, WRIST_YAW = 3, 4, 5


def turned(joint: int, by: float) -> Array:
    """Joints at the origin, but for one."""
    q = ORIGIN.copy()
    q[joint] += by
    return q


@st.composite
def standing(draw: st.DrawFn, margin: float = 2e-3) -> tuple[Instrument, Array]:
    """An instrument, and joints within its limits and past the cannula."""
    tool = draw(st.sampled_from(TOOLS))
    lower, upper = tool.limits()
    lower[2] = insertion(KEEP_DEPTH)
    parts = [draw(st.floats(0.0, 1.0)) for _ in range(6)]
    shrink = np.array([margin, margin, 2e-4, margin, margin, margin])
    return tool, (lower + shrink) + np.array(parts) * (upper - lower - 2 * shrink)


# Forward


@pytest.mark.parametrize(("tool", "q", "position"), REFERENCE, ids=lambda value: getattr(value, "name", None))
def test_forward_kinematics_equals_the_reference_values(tool: Instrument, q: tuple[float, ...], position: Array) -> None:
    pose = forward(tool, np.array(q))

    np.testing.assert_allclose(pose[:3, 3], position, atol=1e-6)
    np.testing.assert_allclose(pose[:3, :3], ROTATIONS[q], atol=1e-6)
    assert pose[3].tolist() == [0, 0, 0, 1]


@given(standing())
@settings(max_examples=50, deadline=None)
def test_frame_four_stands_at_its_closed_form_depth(case: tuple[Instrument, Array]) -> None:
    tool, q = case

    origin = frames(tool, q)[4][:3, 3]

    assert np.linalg.norm(origin) == pytest.approx(depth(q), abs=1e-12)
    assert depth(q) == pytest.approx(q[2] - 0.0156)


def test_fewer_joints_give_fewer_frames() -> None:
    assert frames(POTTS, np.array(BENT[:3])).shape == (4, 4, 4)


def test_the_jaws_turn_about_the_tips_x_axis() -> None:
    bent = turned(WRIST_YAW, 0.2)

    turn = forward(POTTS, ORIGIN)[:3, :3].T @ forward(POTTS, bent)[:3, :3]

    np.testing.assert_allclose(turn @ [1, 0, 0], [1, 0, 0], atol=1e-12)
    assert turn[2, 2] == pytest.approx(math.cos(0.2))


@pytest.mark.parametrize("count", [0, 5, 7])
def test_joints_other_than_six_are_refused(count: int) -> None:
    with pytest.raises(ValueError, match="six joints"):
        forward(POTTS, np.zeros(count))


@given(standing())
@settings(max_examples=50, deadline=None)
def test_the_jacobian_is_the_slope_of_forward(case: tuple[Instrument, Array]) -> None:
    tool, q = case
    step = 1e-6
    expected = np.zeros((6, 6))
    for joint in range(6):
        delta = step * np.eye(6)[joint]
        after, before = forward(tool, q + delta), forward(tool, q - delta)
        expected[:3, joint] = (after[:3, 3] - before[:3, 3]) / (2 * step)
        spin = (after[:3, :3] - before[:3, :3]) / (2 * step) @ forward(tool, q)[:3, :3].T
        expected[3:, joint] = (spin[2, 1], spin[0, 2], spin[1, 0])

    np.testing.assert_allclose(jacobian(tool, q), expected, atol=1e-7)


# Inverse


@given(standing())
@settings(max_examples=200, deadline=None)
def test_inverse_after_forward_gives_the_joints_back(case: tuple[Instrument, Array]) -> None:
    tool, q = case

    solution = inverse(tool, forward(tool, q), near=q)

    assert solution.reach is Reach.FINE and solution.reason == ""
    np.testing.assert_allclose(solution.q, q, atol=1e-9)


@given(standing(), standing())
@settings(max_examples=100, deadline=None)
def test_forward_after_inverse_gives_the_pose_back_from_wherever_the_arm_stands(
    case: tuple[Instrument, Array], elsewhere: tuple[Instrument, Array]
) -> None:
    tool, q = case
    pose = forward(tool, q)

    solution = inverse(tool, pose, near=elsewhere[1])

    np.testing.assert_allclose(forward(tool, solution.q), pose, atol=1e-9)
    assert abs(solution.q[3] - elsewhere[1][3]) <= math.pi + 1e-9


@pytest.mark.parametrize("turns", [-0.6, -0.4, 0.0, 0.4, 0.6])
def test_roll_is_the_turn_nearest_to_where_the_arm_stands(turns: float) -> None:
    pose = forward(POTTS, ORIGIN)
    near = turned(ROLL, math.tau * turns)

    solution = inverse(POTTS, pose, near)

    assert solution.q[3] == pytest.approx(math.tau * round(turns), abs=1e-9)


def test_a_roll_that_is_wound_up_would_be_clipped_and_the_reason_says_how_to_help() -> None:
    near = turned(ROLL, math.radians(250))

    within = inverse(POTTS, forward(POTTS, turned(ROLL, math.radians(-101))), near)
    beyond = inverse(POTTS, forward(POTTS, turned(ROLL, math.radians(-99))), near)

    assert within.reach is Reach.FINE and math.degrees(within.q[ROLL]) == pytest.approx(259)
    assert beyond.reach is Reach.LIMIT and math.degrees(beyond.q[ROLL]) == pytest.approx(261)  # as the arm would choose
    assert "wound up" in beyond.reason


@pytest.mark.parametrize(
    ("joint", "value", "said"),
    [
        (0, 1.7, "yaw at 97.4 deg"),
        (1, -1.0, "pitch at -57.3 deg"),
        (2, 0.25, "insertion at 250.0 mm"),
        (4, 1.45, "wrist pitch at 83.1 deg"),
        (5, -1.5, "wrist yaw at -85.9 deg"),
    ],
)
def test_joints_beyond_their_limits_are_told_by_name(joint: int, value: float, said: str) -> None:
    q = ORIGIN.copy()
    q[joint] = value

    solution = inverse(POTTS, forward(POTTS, q), near=ORIGIN)

    assert solution.reach is Reach.LIMIT
    assert said in solution.reason
    np.testing.assert_allclose(solution.q, q, atol=1e-9)  # not yet clipped


def test_a_shallow_pose_is_told_before_the_arm_pushes_it_deeper() -> None:
    q = ORIGIN.copy()
    q[2] = 0.0600  # the arm would make 0.0606 of it

    solution = inverse(POTTS, forward(POTTS, q), near=ORIGIN)

    assert solution.reach is Reach.SHALLOW
    assert "44.4 mm beyond the remote centre" in solution.reason


def test_the_depth_at_which_the_arm_starts_pushing_is_an_insertion_of_60_6_mm() -> None:
    assert insertion(KEEP_DEPTH) == pytest.approx(0.0606)
    assert insertion(ENTER_DEPTH) == pytest.approx(0.0586)


def test_a_pose_at_the_remote_centre_has_no_joints() -> None:
    pose = forward(POTTS, ORIGIN)
    pose[:3, 3] = (0.0, 0.0, -0.0005)

    solution = inverse(POTTS, pose, near=ORIGIN)

    assert solution.reach is Reach.UNSOLVABLE
    assert np.isnan(solution.q).all()


def test_a_wrist_folded_towards_the_remote_centre_has_no_joints() -> None:
    pose = forward(POTTS, ORIGIN)
    pose[:3, :3] = np.array([[0, 1, 0], [0, 0, 1], [1, 0, 0]])  # the tip's x, minus the wrist-yaw axis, along the shaft

    assert inverse(POTTS, pose, near=ORIGIN).reach is Reach.UNSOLVABLE


@pytest.mark.parametrize("place", [(0, 0), (1, 3), (2, 3)])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_pose_that_is_not_finite_has_no_joints(place: tuple[int, int], value: float) -> None:
    pose = forward(POTTS, ORIGIN)
    pose[place] = value

    assert "not finite" in inverse(POTTS, pose, near=ORIGIN).reason


@pytest.mark.parametrize("scale", [-1.0, 0.0, 1.01])
def test_a_rotation_that_is_none_has_no_joints(scale: float) -> None:
    pose = forward(POTTS, ORIGIN)
    pose[:3, :3] *= scale

    assert "not a rigid one" in inverse(POTTS, pose, near=ORIGIN).reason


def test_joints_that_are_not_known_are_a_mistake_of_the_caller() -> None:
    with pytest.raises(ValueError, match="finite"):
        inverse(POTTS, forward(POTTS, ORIGIN), near=np.full(6, math.nan))


# What the arm would alter


def test_nothing_is_clipped_within_limits() -> None:
    assert clipped_by(POTTS, np.array(BENT)).tolist() == [0.0] * 6


def test_what_is_clipped_is_what_lies_beyond_the_limits() -> None:
    q = np.array([-1.688, 0.0, 0.26, 0.0, 0.0, 0.0])

    np.testing.assert_allclose(clipped_by(POTTS, q), [-0.1, 0, 0.02, 0, 0, 0], atol=1e-12)


@given(standing())
@settings(max_examples=100, deadline=None)
def test_a_pose_within_limits_is_fine_for_an_arm_that_stands_near(case: tuple[Instrument, Array]) -> None:
    tool, q = case

    assert check_pose(tool, forward(tool, q), near=q) == ""


@given(standing(), st.sampled_from([0, 1, 2, 4, 5]), st.floats(2e-4, 0.1))
@settings(max_examples=100, deadline=None)
def test_whatever_the_arm_would_clip_is_told(case: tuple[Instrument, Array], joint: int, beyond: float) -> None:
    tool, q = case
    goal = q.copy()
    goal[joint] = tool.upper[joint] + beyond * (0.1 if joint == 2 else 1.0)

    said = check_pose(tool, forward(tool, goal), near=q)

    assert np.abs(clipped_by(tool, goal)).max() > 0
    assert said != ""


def test_a_pose_at_a_limit_is_told_since_the_arms_rounding_may_clip_it() -> None:
    q = np.array([POTTS.upper[0], 0.0, 0.12, 0.0, 0.0, 0.0])

    assert inverse(POTTS, forward(POTTS, q * [0.9999999, 1, 1, 1, 1, 1]), q).reach is Reach.FINE
    assert "yaw" in check_pose(POTTS, forward(POTTS, q * [0.9999999, 1, 1, 1, 1, 1]), q)


def test_an_arm_that_stands_in_its_cannula_takes_no_pose() -> None:
    shallow = ORIGIN.copy()
    shallow[2] = 0.0585

    said = check_pose(POTTS, forward(POTTS, ORIGIN), near=shallow)

    assert "stands 42.9 mm beyond its remote centre" in said


def test_an_arm_whose_joints_are_not_known_takes_no_pose() -> None:
    assert "not known" in check_pose(POTTS, forward(POTTS, ORIGIN), near=np.full(6, math.nan))


@pytest.mark.parametrize("tool", TOOLS, ids=lambda tool: tool.name)
def test_the_limits_are_those_of_the_instrument(tool: Instrument) -> None:
    q = turned(WRIST_PITCH, 1.3)

    assert (check_pose(tool, forward(tool, q), ORIGIN) == "") == (tool is not FENESTRATED)
