"""The planning agent's geometry, and what it does when it cannot see or may not move."""

from dataclasses import replace

import numpy as np
import pytest

from hardware.codes import Code
from hardware.interface import CUTTER, GRASPER, MoveReport, MoveStatus, Pose
from skills.dissect import planning
from skills.dissect.path import Path
from skills.dissect.planning import PlanningAgent, PlanningConfig, _insets, _on_goal, retraction_direction
from skills.grasp import GraspConfig, Grasped
from skills.scene.stereo import StereoConfig
from skills.skill import ImmediateExecutor
from skills.tracking.tracks import TrackedGoal
from tests.mocks.table import Table


def straight_path(noise: float = 0.0, missing: int = 0) -> Path:
    """40 mm along x at 80 mm depth, facing the camera; the near side is up in the image."""
    x = np.linspace(-0.02, 0.02, 25)
    rng = np.random.default_rng(0)
    points = np.column_stack([x, np.zeros(25), np.full(25, 0.08)]) + noise * rng.standard_normal((25, 3))
    across = np.tile([0.0, -0.004, 0.0], (25, 1))
    known = np.ones(25, dtype=bool)
    known[5 : 5 + missing] = False
    points[~known] = np.nan
    return Path.through(points, across, np.column_stack([x * 8000 + 320, np.full(25, 240.0)]), known)


def goal(lost: bool = False) -> TrackedGoal:
    line = np.column_stack([np.linspace(200, 440, 12), np.full(12, 240.0)])
    up = np.array([0.0, -18.0])
    return TrackedGoal(0.0, line, line + up, line - up, np.full(12, not lost), np.array([320.0, 180.0]), True, lost, float("nan"))


def agent() -> PlanningAgent:
    return PlanningAgent(PlanningConfig(), GraspConfig(), StereoConfig(), ImmediateExecutor())


def test_a_snip_points_into_the_tissue_and_opens_along_the_path():
    point, tangent, normal = straight_path().frame_at(0.010, 0.005)

    assert point == pytest.approx([-0.010, 0.0, 0.08], abs=1e-4)
    assert tangent == pytest.approx([1.0, 0.0, 0.0], abs=1e-3)
    assert normal == pytest.approx([0.0, 0.0, -1.0], abs=1e-3)


def test_missing_and_noisy_depths_do_not_bend_the_path():
    path = straight_path(noise=0.3e-3, missing=6)

    assert path.length == pytest.approx(0.040, abs=1e-3)
    assert np.abs(path.points[:, 2] - 0.08).max() < 0.5e-3


def test_one_wild_depth_does_not_bend_the_path():
    x = np.linspace(-0.02, 0.02, 25)
    points = np.column_stack([x, np.zeros(25), np.full(25, 0.08)])
    points[12, 2] = 0.09
    path = Path.through(points, np.tile([0.0, -0.004, 0.0], (25, 1)), np.zeros((25, 2)), np.ones(25, dtype=bool))

    assert np.abs(path.points[:, 2] - 0.08).max() < 0.5e-3


def test_retraction_leaves_the_goal_and_rises():
    direction = retraction_direction(np.array([0.0, -0.009, 0.002]), np.array([0.0, 0.0, -1.0]), np.deg2rad(45.0))

    assert np.linalg.norm(direction) == pytest.approx(1.0)
    assert direction == pytest.approx([0.0, -np.sqrt(0.5), -np.sqrt(0.5)])


@pytest.mark.parametrize("seen", [None, goal(lost=True)])
def test_a_lost_goal_is_not_cut(seen):
    table = Table()

    outcome = table.finish(agent().run(table.lease, lambda: seen, None))

    assert outcome.code is Code.GOAL_LOST
    assert table.bench.motions() == []
    assert table.bench.holding()


def test_without_depth_nothing_is_grasped_or_cut():
    table = Table()

    outcome = table.finish(agent().run(table.lease, goal, None))

    assert outcome.code is Code.DEPTH_INVALID
    assert table.bench.motions(CUTTER) == []


def test_after_a_refused_snip_the_goal_is_watched_again():
    table = Table()
    cutting = agent()
    outside = straight_path()
    far = Path(outside.points + np.array([0.5, 0.0, 0.0]), outside.across, outside.pixels, outside.arc)

    report, _ = table.finish(cutting._snip(table.lease, far.frame_at(0.02, 0.005), 0.0066, "snip"))

    assert report.code is Code.WORKSPACE
    assert cutting.clear_view


def depth_of_the_next_snip(cutting: PlanningAgent, table: Table, monkeypatch: pytest.MonkeyPatch) -> float:
    """How far [m] below the surface the closed tip would be sent."""
    poses: list[Pose] = []

    def note(lease, pose, above, jaw, doing):
        poses.append(pose)
        yield from ()
        return MoveReport(MoveStatus.DONE)

    monkeypatch.setattr(cutting, "_close_at", note)
    table.finish(cutting._snip(table.lease, straight_path().frame_at(0.02, 0.005), 0.0066, "snip"))
    return float(poses[0].position[2] - 0.08)


def test_each_corrective_pass_goes_deeper_up_to_a_limit_and_a_whole_pass_does_not(monkeypatch):
    table, cutting, config = Table(), agent(), PlanningConfig()
    cutting.grasped = Grasped(table.bench.grasper.pose, np.array([0.0, 0.0, -1.0]))
    segments = np.array([[[300.0, 240.0], [340.0, 240.0]]])
    depths = []
    for cut in (None, segments, segments, segments, segments, None):
        table.finish(cutting.run(table.lease, goal, cut))
        depths.append(depth_of_the_next_snip(cutting, table, monkeypatch))

    deeper = [min(config.depth + k * config.deeper, config.deepest) for k in range(5)]
    assert depths == pytest.approx([*deeper, config.depth])


@pytest.mark.parametrize(
    ("segment", "stations"),
    [
        ([[150.0, 240.0], [320.0, 240.0]], (0.0, 0.5)),
        ([[320.0, 240.0], [500.0, 240.0]], (0.5, 1.0)),
        ([[260.0, 236.0], [380.0, 244.0]], (0.25, 0.75)),
    ],
)
def test_a_corrective_segment_ends_at_the_goals_ends_and_keeps_its_place_across_it(segment, stations):
    on_goal = _on_goal(goal(), np.array(segment))

    assert on_goal[:, 0] == pytest.approx(stations, abs=0.01)
    assert on_goal[:, 1] == pytest.approx((240.0 - np.array(segment)[:, 1]) / 18.0, abs=0.01)


@pytest.mark.parametrize(
    ("stations", "insets"),
    [
        ((0.3, 0.4), (0.0, 0.0)),  # 4 mm in the middle of a goal of 40 mm
        ((0.9, 1.0), (0.0, 0.8e-3)),
        ((0.89, 0.99), (0.0, 0.4e-3)),  # 0.4 mm are left to the goal's end, half of what the blades reach over
        ((0.1, 0.0), (0.0, 0.8e-3)),  # cut towards the goal's beginning
        ((0.0, 0.1), (0.8e-3, 0.0)),
    ],
)
def test_the_blades_of_a_corrective_cut_do_not_reach_beyond_the_goals_ends(stations, insets):
    segment = np.column_stack([stations, (0.0, 0.0)])

    assert _insets(segment, 4e-3, 0.8e-3) == pytest.approx(insets, abs=1e-9)


def test_a_short_corrective_cut_keeps_at_least_half_its_length():
    assert _insets(np.array([[0.99, 0.0], [1.0, 0.0]]), 0.4e-3, 0.8e-3) == pytest.approx((0.1e-3, 0.1e-3))


def test_preempted_in_the_middle_it_leaves_the_arms_holding():
    table = Table()
    steps = agent().run(table.lease, goal, None)
    next(steps)

    steps.close()

    assert table.bench.holding()


def test_after_closing_on_nothing_the_next_bite_is_deeper(monkeypatch):
    table, cutting, bites = Table(), agent(), []

    def note(lease, point, normal, away, config):
        bites.append(config.bite)
        yield from ()
        return MoveReport(MoveStatus.FAILED, Code.GRASP_EMPTY, "nothing"), None

    monkeypatch.setattr(planning, "take", note)
    monkeypatch.setattr(planning, "depth_at", lambda depth, pixels, radius: np.full(len(pixels), 0.08))
    monkeypatch.setattr(planning, "surface_normal_at", lambda *_: np.array([0.0, 0.0, -1.0]))
    for _ in range(3):
        table.finish(cutting.take_hold(table.lease, goal(), 0.0))

    config = GraspConfig()
    assert bites == pytest.approx([config.bite + k * config.deeper for k in range(3)])


def test_jaws_that_the_tissue_slipped_from_open_before_they_grasp_anew(monkeypatch):
    table, cutting, jaws = Table(), agent(), []

    def note(lease, *_):
        jaws.append(lease.measured_jaw(GRASPER).value)
        yield from ()
        return MoveReport(MoveStatus.DONE), Grasped(table.bench.grasper.pose, np.array([0.0, 0.0, -1.0]))

    monkeypatch.setattr(planning, "take", note)
    monkeypatch.setattr(planning, "depth_at", lambda depth, pixels, radius: np.full(len(pixels), 0.08))
    monkeypatch.setattr(planning, "surface_normal_at", lambda *_: np.array([0.0, 0.0, -1.0]))
    cutting.grasped = Grasped(table.bench.grasper.pose, np.array([0.0, 0.0, -1.0]))
    table.bench.grasper.jaw = 0.0
    cutting.lose_grasp()
    assert cutting.grasped is None
    for _ in range(2):
        table.finish(cutting.take_hold(table.lease, goal(), 0.0))
        table.bench.grasper.jaw = 0.0

    assert cutting.grasped is not None
    assert jaws == pytest.approx([GraspConfig().jaw_open, 0.0], abs=0.02)  # only once: then they hold again


def test_a_corrective_segment_that_stays_hidden_is_not_cut():
    table, cutting = Table(), agent()
    cutting.grasped = Grasped(table.bench.grasper.pose, np.array([0.0, 0.0, -1.0]))
    whole = goal()
    hidden = np.arange(12) < 6

    def tracked() -> TrackedGoal:
        return replace(whole, stamp=table.bench.now(), visible=~hidden)

    outcome = table.finish(cutting.run(table.lease, tracked, np.array([[[200.0, 240.0], [300.0, 240.0]]])))

    assert outcome.code is Code.GOAL_LOST
    assert "hidden" in outcome.message
    assert outcome.snips == ()


SEGMENTS = np.array([[[200.0, 240.0], [270.0, 240.0]], [[370.0, 240.0], [440.0, 240.0]]])


def cutting_anything(table: Table, monkeypatch: pytest.MonkeyPatch) -> tuple[PlanningAgent, list[str]]:
    """An agent whose snips succeed wherever they are made, and what it did."""
    cutting, done = agent(), []
    cutting.grasped = Grasped(table.bench.grasper.pose, np.array([0.0, 0.0, -1.0]))

    def snip(lease, frame, mouth, doing):
        yield from ()
        done.append(doing)
        return MoveReport(MoveStatus.DONE), table.bench.cutter.pose

    monkeypatch.setattr(cutting, "_snip", snip)
    monkeypatch.setattr(cutting, "_lift", lambda *_: straight_path())
    return cutting, done


@pytest.mark.parametrize(("order", "hidden", "seen"), [((0, 1), 1, 2), ((1, 0), 2, 1)])
def test_a_hidden_segment_is_left_out_and_the_other_one_cut(order, hidden, seen, monkeypatch):
    table = Table()
    cutting, done = cutting_anything(table, monkeypatch)
    whole = goal()

    def tracked() -> TrackedGoal:
        return replace(whole, stamp=table.bench.now(), visible=np.arange(12) >= 6)

    outcome = table.finish(cutting.run(table.lease, tracked, SEGMENTS[list(order)]))

    assert outcome.code is Code.OK
    assert f"1 of 2 segments not finished: the goal along segment {hidden} of 2 was hidden" in outcome.message
    assert len(outcome.snips) == len(done) > 0
    assert all(doing.startswith(f"segment {seen} of 2") for doing in done)


def test_a_goal_that_is_lost_ends_the_cut_though_some_of_it_is_made(monkeypatch):
    table = Table()
    cutting, done = cutting_anything(table, monkeypatch)
    whole = goal()

    def tracked() -> TrackedGoal:
        return replace(whole, stamp=table.bench.now(), lost=any(doing.startswith("segment 1") for doing in done))

    outcome = table.finish(cutting.run(table.lease, tracked, SEGMENTS))

    assert outcome.code is Code.GOAL_LOST
    assert outcome.message == "the goal was lost from sight while cutting"
    assert len(outcome.snips) == 1


def test_the_scissors_make_way_for_a_look_at_a_hidden_segment():
    table, cutting = Table(), agent()
    cutting.grasped = Grasped(table.bench.grasper.pose, np.array([0.0, 0.0, -1.0]))
    waiting = table.lease.measured_cp(CUTTER).value.position
    cutting._waiting = table.lease.measured_cp(CUTTER).value
    assert table.move(CUTTER, 0.0, 0.0, -5.0) is Code.OK
    table.bench.advance(2.0)

    table.finish(cutting._unhidden(table.lease, lambda: replace(goal(), stamp=table.bench.now())))

    assert table.lease.measured_cp(CUTTER).value.position == pytest.approx(waiting, abs=1e-3)
