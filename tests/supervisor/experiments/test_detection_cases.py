"""What a seed of the detection experiment draws."""

import json
from itertools import pairwise

import numpy as np
import pytest

from hardware.stub.truth import measure
from supervisor.experiments.detection_cases import (
    ATTACHED,
    CURVED_EVERY,
    DAMAGE,
    GRASP_ALONG,
    GRASP_AWAY,
    HALF_CUT,
    LIFT,
    MATERIALS,
    ROLL,
    STEPS,
    bench_of,
    draw,
    scene_of,
)
from supervisor.experiments.disturbances import Disturbance, Highlights, MotionBlur, Occlusion, Roll
from supervisor.plain import plain

SEEDS = range(100, 460)


def of_kind(kind):
    return [case for case in map(draw, SEEDS) if isinstance(case.effect, kind)]


def test_a_seed_always_draws_the_same_case_and_another_seed_another():
    assert draw(105) == draw(105)
    assert draw(105) != draw(105 + 36)


def test_any_36_seeds_in_a_row_hold_each_material_cut_and_disturbance_together_once():
    for first in (0, 17, 100):
        cases = [draw(seed) for seed in range(first, first + 36)]
        assert len({(case.scene, case.cut, case.disturbance) for case in cases}) == 36
        assert {case.scene for case in cases} == set(MATERIALS)


def test_every_fifth_goal_is_curved_whatever_the_material():
    curved = [case for case in map(draw, SEEDS) if case.curved]

    assert len(curved) == len(SEEDS) // CURVED_EVERY
    assert {case.scene for case in curved} == set(MATERIALS)
    assert len(scene_of(curved[0]).line) > 2
    assert scene_of(curved[0]).tissue.material == curved[0].scene


def test_partly_cut_goals_keep_one_or_two_stretches_and_have_as_many_cut_in_part():
    partly = [case for case in map(draw, SEEDS) if case.cut == "partly"]

    assert len(partly) == len(SEEDS) // 2
    assert {len(case.attached) for case in partly} == {len(case.half_cut) for case in partly} == {1, 2}


def test_stretches_keep_to_the_stated_lengths_and_damage_and_leave_full_cut_between():
    for case in (case for case in map(draw, SEEDS) if case.cut == "partly"):
        line = scene_of(case).line
        length = np.linalg.norm(np.diff(line, axis=0), axis=1).sum()
        placed = sorted([*((a, b) for a, b, _ in case.half_cut), *case.attached])
        assert all(ATTACHED[0] <= (b - a) * length <= ATTACHED[1] for a, b in case.attached)
        assert all(HALF_CUT[0] <= (b - a) * length <= HALF_CUT[1] for a, b, _ in case.half_cut)
        assert all(DAMAGE[0] <= damage <= DAMAGE[1] for *_, damage in case.half_cut)
        assert placed[0][0] >= 0.0 and placed[-1][1] <= 1.0 + 1e-9
        assert all((later[0] - former[1]) * length >= 2e-3 - 1e-9 for former, later in pairwise(placed))


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [("away", *GRASP_AWAY), ("along", -GRASP_ALONG, GRASP_ALONG), ("lift", *LIFT), ("steps", *STEPS)],
)
def test_the_expert_keeps_to_the_stated_ranges_and_fills_them(name, low, high):
    drawn = np.array([getattr(draw(seed), name) for seed in SEEDS])

    assert low <= drawn.min() < low + 0.05 * (high - low) + 1e-9
    assert high - 0.05 * (high - low) - 1e-9 < drawn.max() <= high


@pytest.mark.parametrize("seed", [100, 104, 109])
def test_the_grasp_lies_on_the_far_side_of_a_straight_or_curved_goal_as_far_as_was_drawn(seed):
    case = draw(seed)
    line = scene_of(case).line
    dense = np.column_stack([np.interp(np.linspace(0, 1, 2000), np.linspace(0, 1, len(line)), line[:, k]) for k in (0, 1)])

    gaps = np.linalg.norm(dense - np.array(case.grasp), axis=1)

    assert gaps.min() == pytest.approx(case.away, rel=0.03)
    assert case.grasp[1] > dense[gaps.argmin(), 1]


def test_a_disturbance_comes_with_what_it_needs():
    for disturbance, kind in (
        (Disturbance.OCCLUSION, Occlusion),
        (Disturbance.HIGHLIGHTS, Highlights),
        (Disturbance.BLUR, MotionBlur),
        (Disturbance.ROTATION, Roll),
    ):
        assert {case.disturbance for case in of_kind(kind)} == {disturbance}
    assert all(draw(seed).effect is None for seed in SEEDS if draw(seed).disturbance is Disturbance.NONE)


def test_scissors_come_early_in_the_pull_and_leave_in_about_half_of_the_cases():
    cases = of_kind(Occlusion)
    leaving = [case for case in cases if case.effect.until_step is not None]

    assert all(1 <= case.effect.from_step <= case.steps // 3 for case in cases)
    assert all(case.effect.from_step + 8 <= case.effect.until_step <= case.steps for case in leaving)
    assert 0.3 < len(leaving) / len(cases) < 0.7


def test_the_camera_is_rolled_to_both_sides_by_up_to_forty_degrees():
    rolls = np.array([case.effect.degrees for case in of_kind(Roll)])

    assert (rolls < 0).any() and (rolls > 0).any()
    assert ROLL[0] <= np.abs(rolls).min() and 35.0 < np.abs(rolls).max() <= ROLL[1]


def test_what_was_drawn_can_be_written_down():
    for seed in range(100, 106):
        json.dumps(plain(draw(seed)), allow_nan=False)


def test_the_tissue_is_cut_as_drawn():
    case = next(case for case in map(draw, SEEDS) if case.cut == "partly" and not case.curved and len(case.attached) == 2)

    bench = bench_of(case)

    truth = measure(bench.phantom)
    cut = 1.0 - sum(b - a for a, b in case.attached) - sum(b - a for a, b, _ in case.half_cut)
    assert truth.effective_cut_ratio == pytest.approx(cut, abs=0.04)
    damage = sorted({round(edge.damage, 6) for edge in bench.phantom.mesh.cut_edges if edge.damage < 1.0})
    assert damage == pytest.approx(sorted(damage for *_, damage in case.half_cut), abs=1e-5)


def test_a_goal_cut_through_leaves_no_attachment():
    case = next(case for case in map(draw, SEEDS) if case.cut == "fully" and case.curved)

    truth = measure(bench_of(case).phantom)

    assert truth.attachments == 0
    assert truth.effective_cut_ratio == pytest.approx(1.0, abs=0.01)
