"""The smoothed steps solve the program, keep each limit, and hold with a reason where no plan keeps them all."""

import math
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from hardware.codes import Code
from skills.expose.smoothing import Predicted, Smoother, SmoothingConfig, SmoothingProblem, sensitivities
from skills.expose.smoothing_problem import violations

H = 8
HERE = np.array([0.010, 0.020, 0.070])
FREE = SmoothingConfig(max_step=1.0, max_speed=100.0)  # limits that nothing reaches


def straight(*step: float) -> np.ndarray:
    """The same step [mm] at every time, (h, 3) [m]."""
    return np.tile(np.array(step) * 1e-3, (H, 1))


def noisy(seed: int, step: tuple[float, float, float] = (0.3, 0.2, -0.1), sigma: float = 0.12e-3) -> np.ndarray:
    """A plan that jitters, each step within 0.5 mm."""
    steps = straight(*step) + np.random.default_rng(seed).normal(0.0, sigma, (H, 3))
    return steps * (0.5e-3 / np.maximum(np.linalg.norm(steps, axis=1, keepdims=True), 0.5e-3))


def problem(nominal: np.ndarray, past: np.ndarray | None = None, **limits) -> SmoothingProblem:
    return SmoothingProblem(nominal, HERE, np.tile(nominal.mean(axis=0), (2, 1)) if past is None else past, **limits)


def solved(given: SmoothingProblem, config: SmoothingConfig | None = None) -> np.ndarray:
    """The steps of a solve that must succeed, with its limits checked here once more."""
    outcome = Smoother(config or SmoothingConfig(), H).solve(given)
    assert outcome.code is Code.OK, outcome.message
    assert violations(given, outcome.steps, config or SmoothingConfig()) == []
    return outcome.steps


def jerk(steps: np.ndarray, past: np.ndarray) -> np.ndarray:
    return np.diff(np.vstack([past, steps]), n=2, axis=0)


def path(steps: np.ndarray) -> np.ndarray:
    return HERE + np.cumsum(steps, axis=0)


# The program


@pytest.mark.parametrize("weight", [0.0, 1.0, 5.0, 100.0])
@pytest.mark.parametrize("horizon", [1, 2, 8])
def test_without_limits_it_is_the_least_squares_solution(weight, horizon):
    nominal, past = noisy(1)[:horizon], noisy(2)[:2]
    second = np.diff(np.eye(horizon + 2), n=2, axis=0)
    rows = np.vstack([np.eye(horizon), math.sqrt(weight) * second[:, 2:]])
    right = np.vstack([nominal, -math.sqrt(weight) * second[:, :2] @ past])

    outcome = Smoother(replace(FREE, weight=weight), horizon).solve(SmoothingProblem(nominal, HERE, past))

    np.testing.assert_allclose(outcome.steps, np.linalg.lstsq(rows, right)[0], atol=1e-10)


def test_a_plan_that_goes_on_as_before_is_left_alone():
    np.testing.assert_allclose(solved(problem(straight(0.3, 0.2, -0.1))), straight(0.3, 0.2, -0.1), atol=1e-10)


@pytest.mark.parametrize("weight", [1.0, 2.0, 5.0])
def test_a_jittering_plan_becomes_four_times_smoother_and_ends_where_it_did(weight):
    before, after, moved = 0.0, 0.0, []
    for seed in range(10):
        given = problem(noisy(seed))
        steps = solved(given, SmoothingConfig(weight=weight))
        before += np.linalg.norm(jerk(given.nominal, given.past), axis=1).sum()
        after += np.linalg.norm(jerk(steps, given.past), axis=1).sum()
        moved.append(np.linalg.norm(path(steps)[-1] - path(given.nominal)[-1]))

    assert before > 4.0 * after
    assert np.mean(moved) < 0.1 * np.linalg.norm(straight(0.3, 0.2, -0.1).sum(axis=0))


def test_a_start_from_rest_is_gentle():
    steps = solved(problem(straight(0.4, 0.0, 0.0), past=np.zeros((2, 3))))

    assert 0.0 < steps[0, 0] < 0.2e-3
    assert np.abs(jerk(steps, np.zeros((2, 3)))).max() < 0.5 * 0.4e-3


# Limits, each reached and kept


def test_steps_keep_their_euclidean_length_in_every_direction():
    rng = np.random.default_rng(0)
    for _ in range(20):
        way = rng.normal(size=3)
        past = np.tile(0.5e-3 * way / np.linalg.norm(way), (2, 1))
        turn = np.cross(past[0], rng.normal(size=3))
        nominal = np.tile(past[0] + turn / np.linalg.norm(turn) * 0.5e-3, (H, 1))

        length = np.linalg.norm(solved(problem(nominal, past), SmoothingConfig(weight=5.0)), axis=1)

        assert length.max() == pytest.approx(0.5e-3, rel=1e-6)
        assert length.max() <= 0.5e-3 * (1 + 1e-12)


def test_the_speed_limit_shortens_the_steps():
    steps = solved(problem(straight(0.4, 0.0, 0.0)), SmoothingConfig(max_speed=2e-3, period=0.1))

    assert np.linalg.norm(steps, axis=1).max() == pytest.approx(0.2e-3, rel=1e-6)


@pytest.mark.parametrize("last", [[0.0, 0.0, 0.0], [0.0, 0.0, 0.2e-3]])
def test_the_change_from_step_to_step_is_bounded_from_the_last_executed_step_on(last):
    config, past = SmoothingConfig(weight=0.0, max_change=0.05e-3), np.tile(last, (2, 1))
    nominal = straight(0.3, 0.0, -0.3)
    nominal[4:] *= -1.0

    steps = solved(problem(nominal, past), config)

    change = np.diff(np.vstack([past[-1:], steps]), axis=0)
    assert np.abs(change).max() == pytest.approx(0.05e-3, rel=1e-6)
    assert change[0, 2] == pytest.approx(-0.05e-3, rel=1e-6)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_gripper_stays_in_the_workspace(sign):
    given = problem(straight(sign * 0.4, 0.0, 0.0), low=HERE - 1.5e-3, high=HERE + 1.5e-3)

    assert np.abs(path(solved(given)) - HERE).max() == pytest.approx(1.5e-3, abs=1e-6)


def test_one_side_of_the_workspace_may_be_open():
    given = problem(straight(0.4, 0.0, 0.4), high=HERE + np.array([1.5e-3, math.inf, math.inf]))

    reached = path(solved(given))

    assert reached[:, 0].max() == pytest.approx(HERE[0] + 1.5e-3, abs=1e-6)
    assert reached[-1, 2] > HERE[2] + 3e-3


def test_a_gripper_just_outside_the_workspace_comes_back_at_once():
    given = problem(straight(0.0, 0.2, 0.0), past=np.zeros((2, 3)), low=HERE + np.array([0.2e-3, -1e-2, -1e-2]), high=HERE + 1e-2)

    assert path(solved(given))[:, 0].min() >= HERE[0] + 0.2e-3 - 1e-6


@pytest.mark.parametrize("aside", [0.0, 0.4e-3])
def test_the_distance_to_the_other_tool_is_kept(aside):
    tool = HERE + np.array([5e-3, aside, 0.0])
    given = problem(straight(0.4, 0.0, 0.0), other_tool=tool)

    distance = np.linalg.norm(path(solved(given)) - tool, axis=1)

    assert distance.min() == pytest.approx(3e-3, abs=2e-5)
    assert distance.min() >= 3e-3 - 1e-6


def test_a_plan_through_the_other_tool_stops_before_it():
    config = SmoothingConfig(min_tool_distance=0.5e-3)
    tool = HERE + np.array([1.6e-3, 0.0, 0.0])

    reached = path(solved(problem(straight(0.4, 0.0, 0.0), other_tool=tool), config))

    assert reached[:, 0].max() == pytest.approx(tool[0] - 0.5e-3, abs=1e-6)


@pytest.mark.parametrize("quantity", ["tension", "strain"])
def test_what_is_predicted_stays_below_its_limit(quantity):
    nominal = straight(0.4, 0.0, 0.0)
    slope = np.array([800.0, 300.0, 0.0])
    value = 1.0 + np.cumsum(nominal, axis=0) @ slope
    given = problem(nominal, **{quantity: Predicted(value, np.tile(slope, (H, 1)), 2.5)})

    steps = solved(given)

    assert value.max() > 3.0
    assert (1.0 + np.cumsum(steps, axis=0) @ slope).max() == pytest.approx(2.5, abs=1e-3)


def test_too_high_a_tension_is_let_down():
    slope = np.array([1000.0, 0.0, 0.0])
    value = 4.3 + np.cumsum(straight(0.4, 0.0, 0.0), axis=0) @ slope
    given = problem(straight(0.4, 0.0, 0.0), tension=Predicted(value, np.tile(slope, (H, 1)), 4.0))

    assert solved(given)[0, 0] == pytest.approx(-0.3e-3, abs=1e-6)


def test_an_infinite_limit_switches_its_rows_off_whatever_was_predicted():
    off = Predicted(np.full(H, np.nan), np.full((H, 3), np.nan))

    np.testing.assert_array_equal(solved(problem(noisy(3), tension=off, strain=off)), solved(problem(noisy(3))))


# Against another solver


def crowded(seed: int) -> SmoothingProblem:
    """A random problem with every kind of limit, in which holding still would be feasible."""
    rng = np.random.default_rng(seed)
    way = rng.normal(size=3)
    way /= np.linalg.norm(way)
    nominal = noisy(seed, tuple(0.5 * way), 0.15e-3)
    aside = way + rng.normal(0.0, 0.7, 3)
    slope = 900.0 * way + rng.normal(0.0, 150.0, (H, 3))
    moved = np.cumsum(nominal, axis=0)
    tension = rng.uniform(1.0, 3.9) + np.einsum("ti,ti->t", slope, moved)
    return SmoothingProblem(
        nominal,
        HERE,
        np.tile(0.4e-3 * way, (2, 1)) * rng.uniform(0.0, 1.0) + rng.normal(0.0, 0.05e-3, (2, 3)),
        low=HERE - rng.uniform(0.0, 3e-3, 3),
        high=HERE + rng.uniform(0.0, 3e-3, 3),
        other_tool=HERE + aside / np.linalg.norm(aside) * rng.uniform(3e-3, 7e-3),
        tension=Predicted(tension, slope, 4.0),
        strain=Predicted(0.1 * tension, 0.1 * slope, rng.uniform(0.38, 0.5)),
    )


def by_ipopt(given: SmoothingProblem, config: SmoothingConfig) -> np.ndarray:
    """The same problem with the steps' true length, written independently and solved by an interior-point method."""
    opti, scale = ca.Opti(), 1e3
    u = opti.variable(H, 3)
    sequence = ca.vertcat(ca.DM(given.past * scale), u)
    second = sequence[2:, :] - 2 * sequence[1:-1, :] + sequence[:-2, :]
    opti.minimize(ca.sumsqr(u - given.nominal * scale) + config.weight * ca.sumsqr(second))
    planned = np.cumsum(given.nominal, axis=0)
    place = ca.DM.zeros(1, 3)
    for t in range(H):
        place = place + u[t, :]
        opti.subject_to(ca.sumsqr(u[t, :]) <= (config.max_step * scale) ** 2)
        opti.subject_to(place >= ca.DM((given.low - HERE) * scale).T)
        opti.subject_to(place <= ca.DM((given.high - HERE) * scale).T)
        away = HERE + planned[t] - given.other_tool
        now = (HERE - given.other_tool) / np.linalg.norm(HERE - given.other_tool)
        towards = away / np.linalg.norm(away)
        towards = towards if towards @ now > 0.5 else now
        start = float((HERE - given.other_tool) @ towards) * scale
        opti.subject_to(start + place @ ca.DM(towards) >= config.min_tool_distance * scale)
        for predicted in (given.tension, given.strain):
            change = (place - ca.DM(planned[t] * scale).T) @ ca.DM(predicted.gradient[t] / scale)
            opti.subject_to(predicted.value[t] + change <= predicted.limit)
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes", "tol": 1e-10})
    return np.array(opti.solve().value(u)) / scale


def test_it_agrees_with_an_interior_point_method_on_random_problems_with_every_limit():
    config, smoother, active = SmoothingConfig(), Smoother(SmoothingConfig(), H), 0
    for seed in range(20):
        given = crowded(seed)

        outcome = smoother.solve(given)

        assert outcome.code is Code.OK, outcome.message
        np.testing.assert_allclose(outcome.steps, by_ipopt(given, config), atol=1e-6)
        free = Smoother(FREE, H).solve(SmoothingProblem(given.nominal, given.position, given.past)).steps
        active += np.abs(free - outcome.steps).max() > 1e-5
    assert active >= 15  # most of these problems do press against a limit


def test_each_of_the_solvers_would_give_the_same_plan():
    smoother = Smoother(SmoothingConfig(), H)
    for seed in range(10):
        plans = [smoother._attempt(program, crowded(seed)) for program in smoother._programs]

        np.testing.assert_allclose(plans[1], plans[0], atol=1e-6)
        np.testing.assert_allclose(plans[2], plans[0], atol=1e-9)


def test_a_solver_that_lies_is_not_believed_and_the_next_one_is_asked(monkeypatch):
    smoother, given = Smoother(SmoothingConfig(), H), crowded(1)
    expected = Smoother(SmoothingConfig(), H).solve(given).steps
    monkeypatch.setattr(smoother._programs[0], "solve", lambda rows: np.full(3 * H, 0.25))

    outcome = smoother.solve(given)

    assert outcome.code is Code.OK
    np.testing.assert_allclose(outcome.steps, expected, atol=1e-6)


def test_no_answer_from_any_solver_is_a_hold(monkeypatch):
    smoother = Smoother(SmoothingConfig(), H)
    for program in smoother._programs:
        monkeypatch.setattr(program, "solve", lambda rows: None)

    outcome = smoother.solve(crowded(1))

    assert outcome.code is Code.SMOOTHING_INFEASIBLE
    assert not outcome.steps.any()


def test_a_warm_start_gives_the_same_plan_as_a_cold_one():
    warm = Smoother(SmoothingConfig(), H)
    for seed in range(15):
        np.testing.assert_allclose(
            warm.solve(crowded(seed)).steps, Smoother(SmoothingConfig(), H).solve(crowded(seed)).steps, atol=1e-9
        )


def test_a_warm_started_second_solver_gives_the_same_plan_as_a_cold_one():
    warm = Smoother(SmoothingConfig(), H)
    for seed in range(10):
        cold = Smoother(SmoothingConfig(), H)
        np.testing.assert_allclose(
            warm._attempt(warm._programs[1], crowded(seed)), cold._attempt(cold._programs[1], crowded(seed)), atol=1e-6
        )
        warm._programs[1].keep()


def test_the_same_problems_give_the_same_plans_to_the_last_bit():
    first, second = Smoother(SmoothingConfig(), H), Smoother(SmoothingConfig(), H)

    for seed in range(10):
        np.testing.assert_array_equal(first.solve(crowded(seed)).steps, second.solve(crowded(seed)).steps)


def test_a_limit_does_not_linger_into_the_next_problem():
    smoother = Smoother(SmoothingConfig(), H)
    smoother.solve(crowded(0))

    np.testing.assert_array_equal(smoother.solve(problem(noisy(3))).steps, solved(problem(noisy(3))))


# Where there is no plan


def held(given: SmoothingProblem, config: SmoothingConfig | None = None) -> str:
    """The sentence of a solve that must hold."""
    outcome = Smoother(config or SmoothingConfig(), H).solve(given)
    assert outcome.code is Code.SMOOTHING_INFEASIBLE
    np.testing.assert_array_equal(outcome.steps, np.zeros((H, 3)))
    return outcome.message


def test_a_start_too_far_outside_the_workspace_holds_and_says_by_how_much():
    message = held(problem(straight(0.3, 0.0, 0.0), low=HERE + np.array([0.8e-3, -1e-2, -1e-2]), high=HERE + 1e-2))

    assert "the workspace, left by 0.3 mm at step 1" in message


def test_a_tool_too_close_with_no_way_out_holds_and_says_by_how_much():
    message = held(problem(straight(0.1, 0.0, 0.0), other_tool=HERE + np.array([2e-3, 0.0, 0.0])))

    assert "the distance to the other tool, too small by 0.5 mm at step 1" in message


def test_a_tension_that_no_step_lets_down_holds_and_says_by_how_much():
    predicted = Predicted(np.full(H, 5.0), np.tile([1000.0, 0.0, 0.0], (H, 1)), 4.0)

    assert "the predicted tension, above its limit by 0.5 N at step 1" in held(problem(np.zeros((H, 3)), tension=predicted))


def test_a_tension_that_motion_does_not_change_holds():
    predicted = Predicted(np.full(H, 5.0), np.zeros((H, 3)), 4.0)

    assert "the predicted tension, above its limit by 1 N" in held(problem(straight(0.1, 0.0, 0.0), tension=predicted))


def test_limits_that_contradict_each_other_hold():
    given = problem(np.zeros((H, 3)), low=HERE - 0.1e-3, high=HERE + 0.1e-3, other_tool=HERE + np.array([2e-3, 0.0, 0.0]))

    assert "no plan of 8 steps keeps every limit" in held(given)


def test_an_empty_workspace_holds():
    assert "the workspace is empty" in held(problem(noisy(0), low=HERE + 1e-3, high=HERE - 1e-3))


def test_after_a_hold_the_next_plan_is_as_good_as_ever():
    smoother = Smoother(SmoothingConfig(), H)
    smoother.solve(problem(straight(0.1, 0.0, 0.0), other_tool=HERE + np.array([2e-3, 0.0, 0.0])))

    np.testing.assert_array_equal(smoother.solve(crowded(2)).steps, solved(crowded(2)))


@pytest.mark.parametrize("value", [math.nan, math.inf])
@pytest.mark.parametrize("name", ["nominal", "position", "past", "other_tool", "value", "gradient"])
def test_input_that_is_not_finite_holds(name, value):
    given = crowded(0)
    if name in ("value", "gradient"):
        given = replace(given, tension=replace(given.tension, **{name: np.full_like(getattr(given.tension, name), value)}))
    else:
        given = replace(given, **{name: np.full_like(getattr(given, name), value)})

    assert "not a finite number" in held(given)


def test_limits_that_are_no_numbers_hold():
    assert "workspace" in held(problem(noisy(0), low=np.full(3, math.nan)))
    assert "limit of the strain is nan" in held(problem(noisy(0), strain=Predicted(np.zeros(H), np.zeros((H, 3)), math.nan)))


def test_nothing_is_printed(capfd):
    smoother = Smoother(SmoothingConfig(), H)
    smoother.solve(crowded(0))
    smoother._attempt(smoother._programs[1], crowded(0))
    smoother.solve(problem(straight(0.1, 0.0, 0.0), other_tool=HERE + np.array([2e-3, 0.0, 0.0])))

    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "wrong", [{"nominal": np.zeros((H + 1, 3))}, {"position": np.zeros(2)}, {"past": np.zeros((3, 3))}, {"low": np.zeros(1)}]
)
def test_arrays_of_the_wrong_shape_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Smoother(SmoothingConfig(), H).solve(replace(crowded(0), **wrong))


@pytest.mark.parametrize(
    "wrong",
    [{"weight": -1.0}, {"max_step": 0.0}, {"max_speed": math.nan}, {"period": 0.0}, {"max_change": 0.0}, {"tolerance": 0.0}],
)
def test_settings_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        SmoothingConfig(**wrong)


# Slopes from samples


def sampled(count: int, seed: int = 0) -> np.ndarray:
    return straight(0.2, 0.1, 0.0) + np.random.default_rng(seed).normal(0.0, 0.2e-3, (count, H, 3))


def test_the_slope_of_a_linear_tension_is_found_from_the_samples():
    slope, steps = np.random.default_rng(4).normal(0.0, 500.0, (H, 3)), sampled(64)
    values = 1.5 + np.einsum("ktj,tj->tk", np.cumsum(steps, axis=1), slope)
    nominal = straight(0.3, 0.0, 0.1)

    value, gradient = sensitivities(steps, values, nominal, ridge=1e-9)

    np.testing.assert_allclose(gradient, slope, rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(value, 1.5 + np.einsum("tj,tj->t", np.cumsum(nominal, axis=0), slope), rtol=1e-6)


def test_the_ridge_takes_little_from_a_slope_that_was_sampled_well():
    steps = sampled(64)
    values = np.cumsum(steps, axis=1)[:, :, 0].T * 800.0

    _, gradient = sensitivities(steps, values, straight(0.2, 0.1, 0.0))

    np.testing.assert_allclose(gradient, np.tile([800.0, 0.0, 0.0], (H, 1)), atol=8.0)


def test_a_direction_that_no_sample_explored_gets_no_slope():
    steps = sampled(64)
    steps[:, :, 2] = steps[:, :, 1]
    values = np.cumsum(steps, axis=1)[:, :, 1].T * 800.0

    _, gradient = sensitivities(steps, values, straight(0.2, 0.1, 0.0))

    np.testing.assert_allclose(gradient[:, 1], gradient[:, 2], rtol=1e-9)
    assert np.abs(gradient).max() < 500.0


def test_samples_that_are_not_finite_are_left_out():
    steps = sampled(40)
    values = np.cumsum(steps, axis=1)[:, :, 0].T * 800.0
    expected = sensitivities(steps[5:], values[:, 5:], straight(0.2, 0.1, 0.0))
    values[:, :4], steps[4] = np.nan, np.inf

    got = sensitivities(steps, values, straight(0.2, 0.1, 0.0))

    np.testing.assert_allclose(got[0], expected[0], rtol=1e-12)
    np.testing.assert_allclose(got[1], expected[1], rtol=1e-12)


def test_without_enough_samples_there_is_no_slope_and_without_any_no_value():
    steps, values = sampled(4), np.tile([1.0, 2.0, 3.0, 4.0], (H, 1))
    values[0] = np.nan

    value, gradient = sensitivities(steps, values, straight(0.2, 0.1, 0.0))

    assert np.isnan(value[0])
    np.testing.assert_allclose(value[1:], 2.5, rtol=1e-12)
    assert not gradient.any()
    assert "predicted tension" in held(problem(noisy(0), tension=Predicted(value, gradient, 4.0)))


def test_samples_that_are_all_alike_give_no_slope():
    value, gradient = sensitivities(np.zeros((16, H, 3)), np.full((H, 16), 2.0), np.zeros((H, 3)))

    np.testing.assert_array_equal(value, 2.0)
    assert not gradient.any()


def test_samples_that_do_not_agree_in_shape_are_refused():
    with pytest.raises(ValueError, match="agree"):
        sensitivities(sampled(9), np.zeros((9, H)), straight(0.2, 0.1, 0.0))
