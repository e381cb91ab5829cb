"""The planning step pulls across the goal, within every limit, and says why when it must hold."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hardware.codes import Code
from hardware.interface import Array
from skills.expose.ground import Ground
from skills.expose.hypotheses import BELIEVED, CONNECTED
from skills.expose.model import TissueModel, build_model
from skills.expose.mppi import MppiConfig
from skills.expose.planner import SINK, Limits, Objective, Plan, Planner, PlannerConfig, Situation
from skills.expose.region import region_around
from skills.expose.smoothing import SmoothingConfig
from skills.expose.xpbd import State, XpbdSolver, rest_state
from tests.mocks.bench import CAMERA
from tests.mocks.exposing import ACROSS, ALONG, GRASP, TISSUE, UP, polyline, sheet
from tests.skills.sheets import DEPTH

SAMPLES, HORIZON, STEP = 32, 4, 0.5e-3
ROOMY = Limits(np.array([-0.09, -0.07, 0.02]), np.array([0.09, 0.07, 0.2]), tension=4.0, strain=1.0)
ASIDE = np.array([5e-3, 7.5e-3, DEPTH])  # [m], a grasp 56 degrees off the goal's normal
WEIGHTS: dict[str, Any] = {
    "camera": 1.0,
    "deform": 1.0,
    "opening": 1.0,
    "tension": 0.1,
    "overload": 10.0,
    "smoothing": SmoothingConfig(weight=2.0, max_step=STEP, min_tool_distance=3e-3),
}
HELD = (Code.EXPOSURE_INFEASIBLE, Code.SMOOTHING_INFEASIBLE)
BOTH = pytest.mark.parametrize("objective", list(Objective))


class Pull:
    """A sheet pulled by a planner; the goal is severed, for the paper's objective the model of it is not."""

    def __init__(
        self,
        objective: Objective = Objective.OPENING,
        grasp: Array = GRASP,
        seed: int = 0,
        limits: Limits = ROOMY,
        sampling: dict[str, Any] | None = None,
        bump: float = 0.0,
        **settings: Any,
    ) -> None:
        seen = sheet(bump=bump)
        self.model: TissueModel = build_model(seen, grasp, TISSUE)
        mppi = MppiConfig(**{"samples": SAMPLES, "horizon": HORIZON, "max_step": STEP} | (sampling or {}))
        config = PlannerConfig(objective=objective, mppi=mppi, **WEIGHTS | settings)
        region = region_around(polyline(), grasp, seen, CAMERA, config.region)
        rng = np.random.default_rng(seed)
        self.planner = Planner(self.model, seen, region, CAMERA, limits, config, rng, threads=1)
        self.state: State = rest_state(self.model, 1.0 if objective is Objective.PAPER else 0.0)
        self.now = Situation(grasp, np.array([-0.03, -0.03, 0.05]), np.zeros((2, 3)), preload=0.0, tension_scale=1.0)
        self.solver = XpbdSolver(self.model, 1, 1, config.xpbd, threads=1)
        self.tension = 0.0  # [N] on the jaws after the last move

    def begin(self, guess: Array = ACROSS) -> Pull:
        self.planner.begin(guess, self.now.gripper)
        return self

    def update(self) -> Plan:
        return self.planner.update(self.state, self.now)

    def move(self, step: Array) -> None:
        """Make a step."""
        rollout = self.solver.rollout(self.state, step[None, None])
        self.tension = float(rollout.tension[0, 0])
        self.state = rollout.final()
        self.now = replace(self.now, gripper=self.now.gripper + step, past=np.vstack([self.now.past[1:], step]))

    def go(self, steps: int) -> list[Plan]:
        """Plan and make steps."""
        plans = []
        for _ in range(steps):
            plans.append(self.update())
            self.move(plans[-1].step)
        return plans


def angle(one: Array, two: Array) -> float:
    """Between two vectors [deg]."""
    return float(np.degrees(np.arccos(np.clip(one @ two / (np.linalg.norm(one) * np.linalg.norm(two)), -1.0, 1.0))))


def lengths(steps: Array) -> Array:
    return np.asarray(np.linalg.norm(steps, axis=-1))


@BOTH
@pytest.mark.parametrize("guess", [ACROSS, ACROSS + UP, ACROSS + ALONG], ids=["across", "lifted", "slanted"])
@pytest.mark.parametrize("seed", [0, 1])
def test_the_first_step_goes_across_the_goal_to_the_side_of_the_grasp(objective, guess, seed):
    plan = Pull(objective, seed=seed).begin(guess).update()

    assert plan.code is Code.OK
    assert angle(plan.step, ACROSS) < 45.0


@BOTH
@pytest.mark.parametrize("guess", [ALONG, UP], ids=["along", "up"])
def test_a_useless_guess_is_turned_across_the_goal(objective, guess):
    pull = Pull(objective).begin(guess)

    pull.go(8)

    assert angle(pull.update().step, ACROSS) < 45.0


@BOTH
def test_each_update_goes_on_from_the_one_before(objective):
    pull = Pull(objective, smooth=False).begin(ALONG)

    turned = [angle(pull.update().nominal[0], ACROSS) for _ in range(5)]

    assert turned[0] > 25.0
    assert max(turned[3:]) < 0.7 * turned[0]


@BOTH
@pytest.mark.parametrize("mirrored", [1.0, -1.0])
def test_with_the_grasp_off_the_normal_the_plan_is_nearer_to_the_normal_than_the_naive_vector(objective, mirrored):
    grasp = ASIDE * [1.0, mirrored, 1.0]
    naive = grasp - [0.0, 0.0, DEPTH]
    pull = Pull(objective, grasp).begin(naive)

    first, *_, last = pull.go(5)

    assert angle(first.step, ACROSS) < angle(naive, ACROSS) - 10.0
    assert angle(last.step, ACROSS) < 0.5 * angle(naive, ACROSS)


@BOTH
def test_a_pull_that_is_followed_opens_more_and_more_of_the_cut(objective):
    openings = [plan.opening for plan in Pull(objective).begin().go(5)]

    assert (np.diff(openings) > 0.0).all()


@pytest.mark.parametrize("smooth", [True, False])
@BOTH
def test_no_step_is_longer_than_allowed(objective, smooth):
    pull = Pull(objective, smooth=smooth).begin(ACROSS + ALONG)

    plans = pull.go(4)

    assert all(plan.code is Code.OK for plan in plans)
    assert max(lengths(plan.step) for plan in plans) <= STEP * (1 + 1e-6)
    assert max(lengths(plan.nominal).max() for plan in plans) <= STEP * (1 + 1e-6)
    assert max(lengths(plan.samples).max() for plan in plans) <= STEP * (1 + 1e-6)


def test_a_pull_that_is_under_way_goes_on_at_nearly_full_length():
    assert lengths(Pull().begin().go(6)[-1].step) > 0.9 * STEP


@BOTH
def test_the_same_seed_plans_the_same(objective):
    one, two, other = (Pull(objective, seed=seed).begin().go(3) for seed in (4, 4, 5))

    assert np.array_equal([plan.step for plan in one], [plan.step for plan in two])
    assert np.array_equal([plan.samples for plan in one], [plan.samples for plan in two])
    assert not np.allclose([plan.step for plan in one], [plan.step for plan in other])


@pytest.mark.parametrize("room", [0.0, 0.2e-3, 1e-3])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_plan_does_not_leave_the_workspace(room, seed):
    limits = replace(ROOMY, high=np.array([GRASP[0] + room, 0.07, 0.2]))
    pull = Pull(limits=limits, seed=seed).begin()

    plans = pull.go(6)

    for plan in plans:
        assert plan.code is Code.OK or (plan.code in HELD and not plan.step.any())
    assert pull.now.gripper[0] <= limits.high[0] + 1e-6


def test_what_is_near_the_end_of_the_workspace_is_used():
    pull = Pull(limits=replace(ROOMY, high=np.array([GRASP[0] + 1.5e-3, 0.07, 0.2]))).begin()

    pull.go(5)

    assert pull.now.gripper[0] > GRASP[0] + 1.0e-3


def test_without_any_path_in_the_workspace_the_jaws_hold():
    plan = Pull(limits=replace(ROOMY, high=np.array([0.0, 0.07, 0.2]))).begin().update()

    assert plan.code is Code.EXPOSURE_INFEASIBLE
    assert plan.message
    assert not plan.step.any()
    assert plan.feasible == 0.0


@pytest.mark.parametrize("bump", [0.0, 3e-3])
@pytest.mark.parametrize("above", [-1e-3, 0.0, 0.5e-3])
def test_the_jaws_are_not_pushed_into_the_bed(bump, above):
    """Also where the surface is high above its lowest place, and so above the model's floor."""
    seen = sheet(bump=bump)
    on_it = seen.vertices[np.argmin(np.linalg.norm(seen.vertices[:, :2] - GRASP[:2], axis=1))]
    pull = Pull(grasp=on_it, bump=bump)
    pull.now = replace(pull.now, gripper=on_it + above * UP)
    pull.begin(-UP)

    pull.go(6)

    assert Ground(seen).height(pull.now.gripper) > min(above, 0.0) - SINK - 0.05e-3


def test_where_no_way_is_expected_to_show_anything_the_jaws_go_on_along_the_first_guess():
    """Without a guide they would give way to the tension."""
    nothing = {"camera": 0.0, "deform": 0.0, "opening": 0.0}
    guided, free = (Pull(guide=guide, **nothing).begin(ACROSS) for guide in (15.0, 0.0))
    guided.go(12)
    free.go(12)

    assert (guided.now.gripper - GRASP) @ ACROSS > 5e-3
    assert (free.now.gripper - GRASP) @ ACROSS < 3e-3


def test_tension_that_no_step_can_bring_within_its_limit_lets_the_jaws_hold():
    pull = Pull()
    pull.now = replace(pull.now, preload=2 * ROOMY.tension)

    plan = pull.begin().update()

    assert plan.code is Code.SMOOTHING_INFEASIBLE
    assert "tension" in plan.message
    assert not plan.step.any()


@BOTH
@pytest.mark.parametrize("share", [1.0, 0.9])
def test_at_the_limit_of_tension_the_jaws_hold_or_give_way(objective, share):
    pull = Pull(objective).begin()
    pull.go(6)
    tight = Pull(objective, limits=replace(ROOMY, tension=share * pull.tension)).begin()
    tight.state, tight.now = pull.state, pull.now

    plan = tight.update()
    tight.move(plan.step)

    assert plan.code in (Code.OK, *HELD)
    assert tight.tension <= pull.tension
    assert lengths(plan.step) < STEP


@BOTH
def test_the_pull_does_not_pass_the_limit_of_tension(objective):
    free = Pull(objective).begin()
    greatest = []
    for _ in range(10):
        free.go(1)
        greatest.append(free.tension)
    limit = 0.6 * max(greatest)
    tight = Pull(objective, limits=replace(ROOMY, tension=limit)).begin()

    for _ in range(10):
        tight.go(1)
        assert tight.tension < 1.15 * limit


def test_the_pull_does_not_pass_the_limit_of_strain():
    free, tight = Pull().begin(), Pull(limits=replace(ROOMY, strain=0.12)).begin()

    strains = [[plan.strain for plan in pull.go(10)] for pull in (free, tight)]

    assert max(strains[0]) > 0.18
    assert max(strains[1]) < 0.14


def test_tissue_that_pulls_harder_than_the_model_says_is_pulled_less_far():
    far, near = Pull(limits=replace(ROOMY, tension=1.0)).begin(), Pull(limits=replace(ROOMY, tension=1.0)).begin()
    near.now = replace(near.now, tension_scale=6.0)

    far.go(10)
    near.go(10)

    assert near.now.gripper[0] - GRASP[0] < 0.6 * (far.now.gripper[0] - GRASP[0])


def test_the_expected_tension_is_the_preload_and_the_scaled_model():
    now = replace(Pull().now, preload=0.4, tension_scale=3.0)

    assert now.tension(np.array([0.0, 0.2])) == pytest.approx([0.4, 1.0])


def test_the_jaws_keep_away_from_the_other_tool():
    pull = Pull().begin()
    scissors = GRASP + 4.5e-3 * ACROSS
    pull.now = replace(pull.now, other_tool=scissors)

    for _ in range(8):
        plan = pull.update()
        pull.move(plan.step)
        assert lengths(pull.now.gripper - scissors) > 2.99e-3
    assert pull.now.gripper[0] > GRASP[0] + 1e-3


def test_without_smoothing_the_step_is_the_first_one_that_was_planned():
    raw, smooth = Pull(smooth=False).begin().update(), Pull(smooth=True).begin().update()

    assert np.array_equal(raw.nominal, smooth.nominal)
    assert angle(raw.step, raw.nominal[0]) == pytest.approx(0.0, abs=1e-4)
    assert lengths(raw.step) >= lengths(raw.nominal[0]) - 1e-12
    assert lengths(raw.step - smooth.step) > 0.1 * STEP


def test_a_plan_needs_a_first_guess():
    with pytest.raises(RuntimeError, match="first guess"):
        Pull().update()


def test_the_length_of_the_first_guess_does_not_matter():
    one, two = Pull().begin(ACROSS), Pull().begin(1e-4 * ACROSS)

    assert one.update().step == pytest.approx(two.update().step)


@BOTH
@pytest.mark.parametrize("iterations", [1, 2])
def test_a_plan_says_what_is_expected_of_it(objective, iterations):
    plan = Pull(objective, sampling={"iterations": iterations}).begin().update()

    assert (plan.code, plan.step.shape) == (Code.OK, (3,))
    assert plan.nominal.shape == (HORIZON, 3)
    assert plan.samples.shape == (SAMPLES, HORIZON, 3)
    for array in (plan.step, plan.nominal, plan.samples):
        assert np.isfinite(array).all()
    assert -1.0 <= plan.camera < -0.9  # a flat sheet faces the camera
    assert np.isfinite(plan.deform)
    assert plan.opening > 0.0
    assert 0.0 < plan.tension < ROOMY.tension
    assert 0.0 < plan.strain < ROOMY.strain
    assert 1.0 <= plan.effective <= SAMPLES
    assert 0.0 < plan.feasible <= 1.0
    assert 0.0 < plan.agreement <= 1.0


@BOTH
def test_a_hold_says_so_in_fields_of_the_same_shape(objective):
    plan = Pull(objective, limits=replace(ROOMY, high=np.array([0.0, 0.07, 0.2]))).begin().update()

    assert plan.step.shape == (3,)
    assert plan.nominal.shape == (HORIZON, 3)
    assert plan.samples.shape == (SAMPLES, HORIZON, 3)


def test_after_a_hold_planning_goes_on_where_it_was():
    pull, undisturbed = Pull().begin(), Pull().begin()
    held = replace(pull.now, gripper=np.array([0.2, 0.0, DEPTH]))

    plan = pull.planner.update(pull.state, held)

    assert plan.code is Code.EXPOSURE_INFEASIBLE
    assert angle(pull.update().step, ACROSS) < 20.0
    assert angle(undisturbed.update().step, ACROSS) < 20.0


def test_each_objective_is_planned_on_its_own_version_of_the_model():
    assert PlannerConfig(objective=Objective("opening")).hypothesis == BELIEVED
    assert PlannerConfig(objective=Objective("paper")).hypothesis == CONNECTED


def test_an_unknown_objective_is_refused():
    with pytest.raises(ValueError, match="guess"):
        PlannerConfig(objective="guess")  # type: ignore[arg-type]
