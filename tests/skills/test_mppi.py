"""The sampled update averages as its formula says, its noise is what it claims to be, and it finds what it looks for."""

import math

import numpy as np
import pytest

from hardware.codes import Code
from skills.expose.mppi import MppiConfig, adapted, controls, perturbations, shifted, updated

H = 8


def plans(*lengths: float) -> np.ndarray:
    """One plan (h, 3) per length, straight along x."""
    return np.stack([np.tile([length, 0.0, 0.0], (H, 1)) for length in lengths])


def good(count: int) -> np.ndarray:
    return np.ones(count, dtype=bool)


# Noise


def noise_of(count: int = 20000, **changes) -> np.ndarray:
    return perturbations(np.random.default_rng(7), MppiConfig(samples=count, **changes))


@pytest.mark.parametrize("antithetic", [True, False])
def test_the_noise_has_the_same_variance_at_every_step(antithetic):
    noise = noise_of(antithetic=antithetic)[1:]

    np.testing.assert_allclose(noise.std(axis=0), 0.25e-3, rtol=0.03)


@pytest.mark.parametrize("correlation", [0.0, 0.7, 1.0])
def test_the_noise_is_correlated_along_the_horizon_as_configured(correlation):
    noise = noise_of(correlation=correlation)[1:]

    for lag in (1, 2, 4):
        measured = np.mean(noise[:, lag:] * noise[:, :-lag]) / 0.25e-3**2
        assert measured == pytest.approx(correlation**lag, abs=0.02)


def test_the_axes_of_the_noise_are_independent():
    noise = noise_of()[1:].reshape(-1, 3)

    np.testing.assert_allclose(np.corrcoef(noise.T), np.eye(3), atol=0.02)


@pytest.mark.parametrize("count", [1, 2, 9, 64])
def test_sample_0_is_the_undisturbed_nominal(count):
    noise = noise_of(count)

    assert noise.shape == (count, H, 3)
    assert not noise[0].any()
    assert noise[1:].any(axis=(1, 2)).all()


def test_antithetic_noise_has_no_mean_even_with_few_samples():
    np.testing.assert_allclose(noise_of(9).mean(axis=0), 0.0, atol=1e-18)
    assert np.abs(noise_of(9, antithetic=False).mean(axis=0)).max() > 1e-5


def test_the_same_seed_gives_the_same_noise_and_the_generator_goes_on():
    rng = np.random.default_rng(3)
    first, second = perturbations(rng, MppiConfig()), perturbations(rng, MppiConfig())

    np.testing.assert_array_equal(first, perturbations(np.random.default_rng(3), MppiConfig()))
    assert not np.array_equal(first, second)


# Controls


def test_a_long_step_is_shortened_along_its_own_direction_and_a_short_one_is_left_alone():
    nominal = np.tile([0.3e-3, 0.0, 0.0], (H, 1))
    noise = np.zeros((2, H, 3))
    noise[1] = [0.3e-3, 0.8e-3, 0.0]

    steps = controls(nominal, noise, 0.5e-3)

    np.testing.assert_array_equal(steps[0], nominal)
    np.testing.assert_allclose(steps[1], np.tile([0.3e-3, 0.4e-3, 0.0], (H, 1)), rtol=1e-12)


def test_no_step_is_longer_than_allowed():
    steps = controls(plans(0.5e-3)[0], noise_of(500, sigma=1e-3), 0.5e-3)

    assert np.linalg.norm(steps, axis=2).max() <= 0.5e-3 * (1 + 1e-12)


# The update


def test_two_samples_are_weighted_by_the_exponential_of_their_costs():
    # Costs 1 and 3: 1 below the median, so lambda is the configured temperature itself.
    config, samples = MppiConfig(temperature=2.0, min_effective=0.0), plans(1e-4, 5e-4)

    update = updated(plans(0.0)[0], samples, np.array([1.0, 3.0]), good(2), config)

    first = 1.0 / (1.0 + math.exp(-2.0 / 2.0))
    np.testing.assert_allclose(update.weights, [first, 1.0 - first], rtol=1e-12)
    np.testing.assert_allclose(update.nominal, first * samples[0] + (1.0 - first) * samples[1], rtol=1e-12)
    assert update.temperature == pytest.approx(2.0)
    assert update.effective_samples == pytest.approx(1.0 / (first**2 + (1.0 - first) ** 2))
    assert update.best == 0
    assert update.code is Code.OK


def test_at_a_temperature_near_0_the_best_sample_is_picked():
    config = MppiConfig(temperature=1e-9, min_effective=0.0)

    update = updated(plans(0.0)[0], plans(1e-4, 5e-4, 3e-4), np.array([2.0, 0.0, 1.0]), good(3), config)

    np.testing.assert_array_equal(update.nominal, plans(5e-4)[0])
    assert update.best == 1


def test_at_least_two_samples_carry_the_average_unless_only_one_is_feasible():
    config, cost = MppiConfig(temperature=1e-9, min_effective=0.01), np.array([2.0, 0.0, 1.0])

    two = updated(plans(0.0)[0], plans(1e-4, 5e-4, 3e-4), cost, good(3), config)
    one = updated(plans(0.0)[0], plans(1e-4, 5e-4, 3e-4), cost, np.array([True, False, False]), config)

    assert two.effective_samples == pytest.approx(2.0)
    np.testing.assert_array_equal(one.weights, [1.0, 0.0, 0.0])
    assert one.best == 0
    assert one.feasible == pytest.approx(1 / 3)


def test_at_a_high_temperature_the_plan_is_the_mean_of_the_samples():
    update = updated(plans(0.0)[0], plans(1e-4, 5e-4, 3e-4), np.array([2.0, 1.0, 7.0]), good(3), MppiConfig(temperature=1e9))

    np.testing.assert_allclose(update.nominal, plans(3e-4)[0], rtol=1e-6)
    assert update.effective_samples == pytest.approx(3.0)


@pytest.mark.parametrize(("scale", "offset"), [(1e-9, 0.0), (1e6, 0.0), (1.0, 1e3), (1e200, 0.0)])
def test_the_scale_and_offset_of_the_costs_do_not_matter(scale, offset):
    rng = np.random.default_rng(0)
    samples, cost = controls(plans(0.0)[0], noise_of(32), 0.5e-3), rng.normal(size=32)

    plain = updated(plans(0.0)[0], samples, cost, good(32), MppiConfig())
    moved = updated(plans(0.0)[0], samples, scale * cost + offset, good(32), MppiConfig())

    np.testing.assert_allclose(moved.nominal, plain.nominal, rtol=1e-6, atol=1e-12)


def test_equal_costs_give_the_mean_and_no_nan():
    update = updated(plans(0.0)[0], plans(1e-4, 5e-4), np.full(2, 4.0), good(2), MppiConfig())

    np.testing.assert_allclose(update.nominal, plans(3e-4)[0], rtol=1e-12)
    assert update.effective_samples == pytest.approx(2.0)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_cost_that_is_no_number_discards_its_sample(bad):
    samples = plans(1e-4, 5e-4, 3e-4)
    samples[1] = np.nan

    update = updated(plans(0.0)[0], samples, np.array([1.0, bad, 1.0]), good(3), MppiConfig())

    np.testing.assert_allclose(update.weights, [0.5, 0.0, 0.5])
    np.testing.assert_allclose(update.nominal, plans(2e-4)[0], rtol=1e-12)


def test_a_rejected_sample_has_no_weight_however_cheap_it_is():
    update = updated(plans(0.0)[0], plans(1e-4, 5e-4), np.array([1.0, -1e6]), np.array([True, False]), MppiConfig())

    np.testing.assert_array_equal(update.weights, [1.0, 0.0])
    assert update.best == 0


def test_the_plan_stays_as_it_is_when_every_sample_is_rejected():
    nominal = plans(2e-4)[0]

    update = updated(nominal, plans(1e-4, 5e-4), np.array([1.0, math.nan]), np.array([False, True]), MppiConfig())

    assert update.code is Code.EXPOSURE_INFEASIBLE
    assert "none of the 2" in update.message
    np.testing.assert_array_equal(update.nominal, nominal)
    assert (update.best, update.feasible, update.effective_samples) == (-1, 0.0, 0.0)
    assert not update.weights.any()


@pytest.mark.parametrize("share", [0.05, 0.2, 0.5, 0.9])
def test_the_temperature_rises_until_enough_samples_carry_the_average(share):
    cost = np.random.default_rng(1).normal(size=64)
    config = MppiConfig(temperature=1e-3, min_effective=share)

    update = updated(plans(0.0)[0], controls(plans(0.0)[0], noise_of(64), 0.5e-3), cost, good(64), config)

    assert update.effective_samples == pytest.approx(share * 64, rel=1e-6)
    assert update.temperature > 1e-3 * cost.std()


def test_the_temperature_stays_where_enough_samples_carry_the_average_already():
    cost = np.random.default_rng(1).normal(size=64)

    update = updated(plans(0.0)[0], plans(*np.zeros(64)), cost, good(64), MppiConfig(temperature=1.0, min_effective=0.1))

    below = np.median(cost) - np.sort(cost)[:32]
    assert update.temperature == pytest.approx(np.sqrt(np.mean(below**2)))
    assert update.effective_samples > 6.4


def test_the_temperature_of_evenly_scattered_costs_is_their_standard_deviation():
    cost = np.linspace(-3.0, 3.0, 64)

    update = updated(plans(0.0)[0], plans(*np.zeros(64)), cost, good(64), MppiConfig(temperature=1.0))

    assert update.temperature == pytest.approx(cost.std())


def test_samples_that_break_a_limit_do_not_make_the_others_look_alike():
    good_ones, config = np.linspace(0.0, 1.0, 40), MppiConfig()

    near, far = (
        updated(plans(0.0)[0], plans(*np.zeros(64)), np.append(good_ones, np.full(24, bad)), good(64), config)
        for bad in (3.0, 3e4)
    )

    np.testing.assert_allclose(near.weights[:40], far.weights[:40], rtol=1e-3)
    assert far.effective_samples < 20


def test_when_half_of_the_samples_cost_the_least_the_others_weigh_less():
    cost = np.array([0.0, 0.0, 0.0, 5.0])

    update = updated(plans(0.0)[0], plans(*np.zeros(4)), cost, good(4), MppiConfig())

    assert update.weights[3] < 0.01 * update.weights[0]
    np.testing.assert_allclose(update.weights[:3], 1.0 / 3.0, rtol=1e-2)


def test_agreement_is_1_when_all_pull_one_way_and_0_when_they_cancel():
    one_way = updated(plans(0.0)[0], plans(1e-4, 5e-4), np.zeros(2), good(2), MppiConfig())
    opposed = updated(plans(0.0)[0], plans(4e-4, -4e-4), np.zeros(2), good(2), MppiConfig())
    still = updated(plans(0.0)[0], plans(0.0, 0.0), np.zeros(2), good(2), MppiConfig())

    assert one_way.agreement == pytest.approx(1.0)
    assert opposed.agreement == pytest.approx(0.0, abs=1e-12)
    assert still.agreement == 0.0


@pytest.mark.parametrize("shape", [(3, H), (3, H, 2), (H, 3)])
def test_samples_of_the_wrong_shape_are_refused(shape):
    with pytest.raises(ValueError, match="controls must be"):
        updated(plans(0.0)[0], np.zeros(shape), np.zeros(3), good(3), MppiConfig())


def test_costs_of_the_wrong_length_are_refused():
    with pytest.raises(ValueError, match="costs and feasible"):
        updated(plans(0.0)[0], plans(0.0, 0.0), np.zeros(3), good(2), MppiConfig())


# Rounds, and from one step to the next


def test_later_rounds_search_closer():
    config = MppiConfig(sigma=1e-3, shrink=0.5)

    assert [adapted(config, i).sigma for i in range(3)] == pytest.approx([1e-3, 0.5e-3, 0.25e-3])
    with pytest.raises(ValueError, match="iteration"):
        adapted(config, -1)


@pytest.mark.parametrize("steps", [0, 1, 3, 20])
def test_the_shifted_plan_goes_on_with_its_last_step(steps):
    nominal = np.arange(H * 3.0).reshape(H, 3)

    moved = shifted(nominal, steps)

    np.testing.assert_array_equal(moved, np.vstack([nominal[steps:], np.tile(nominal[-1], (H, 1))])[:H])
    assert not np.shares_memory(moved, nominal)


@pytest.mark.parametrize(
    "wrong",
    [
        {"samples": 0},
        {"horizon": 0},
        {"horizon": 2.5},
        {"iterations": 0},
        {"sigma": 0.0},
        {"sigma": math.nan},
        {"temperature": -1.0},
        {"max_step": math.inf},
        {"correlation": 1.1},
        {"min_effective": -0.1},
        {"shrink": 0.0},
    ],
)
def test_settings_that_make_no_sense_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        MppiConfig(**wrong)


def test_it_converges_to_the_optimum_of_a_quadratic():
    """Cost |u - u*|^2 with u* inside the allowed length: repeated updates with shrinking noise reach it within a few micrometres."""
    wanted = 0.3e-3 * np.stack([np.cos(np.linspace(0, 1, H)), np.sin(np.linspace(0, 1, H)), np.full(H, 0.5)], axis=1)
    config, rng, nominal = MppiConfig(samples=256, shrink=0.85, correlation=0.5), np.random.default_rng(5), np.zeros((H, 3))

    for i in range(35):
        samples = controls(nominal, perturbations(rng, adapted(config, i)), config.max_step)
        nominal = updated(nominal, samples, ((samples - wanted) ** 2).sum(axis=(1, 2)), good(256), config).nominal

    assert np.linalg.norm(nominal - wanted, axis=1).max() < 10e-6


TARGET, BALL, RADIUS = np.array([5e-3, 2e-3, -1e-3]), np.array([2.5e-3, 1.3e-3, -0.5e-3]), 1.2e-3


def around_the_ball(seed: int, config: MppiConfig) -> tuple[float, float]:
    """Steer a point round a ball to a target; the squared distance [mm^2] summed over 24 executed steps, and the least clearance [m]."""
    rng, place, nominal, total, clearance = np.random.default_rng(seed), np.zeros(3), np.zeros((H, 3)), 0.0, math.inf
    for _ in range(24):
        for i in range(config.iterations):
            settings = adapted(config, i)
            samples = controls(nominal, perturbations(rng, settings), settings.max_step)
            path = place + np.cumsum(samples, axis=1)
            cost = (np.linalg.norm(path - TARGET, axis=-1) ** 2).sum(axis=1)
            nominal = updated(
                nominal, samples, cost, (np.linalg.norm(path - BALL, axis=-1) > RADIUS).all(axis=1), settings
            ).nominal
        place = place + nominal[0]
        nominal = shifted(nominal)
        total += float(np.sum((place - TARGET) ** 2)) * 1e6
        clearance = min(clearance, float(np.linalg.norm(place - BALL)) - RADIUS)
    return total, clearance


def test_few_samples_in_several_rounds_are_as_good_as_many_in_one():
    """16 samples in 4 rounds (64 rollouts) against 128 in one, and against 16 in one, on the way round an obstacle."""
    mean = {}
    for name, config in {
        "many": MppiConfig(samples=128),
        "rounds": MppiConfig(samples=16, iterations=4),
        "few": MppiConfig(samples=16),
    }.items():
        mean[name] = np.mean([around_the_ball(seed, config)[0] for seed in range(8)])

    assert mean["rounds"] < 1.05 * mean["many"]
    assert mean["rounds"] < 0.9 * mean["few"]


def test_rejected_samples_keep_the_way_out_of_the_obstacle():
    """The straight line to the target runs through the ball."""
    assert np.linalg.norm(np.cross(TARGET, BALL)) / np.linalg.norm(TARGET) < RADIUS

    assert min(around_the_ball(seed, MppiConfig())[1] for seed in range(4)) > 0.0


def test_the_same_seed_gives_the_same_way():
    assert around_the_ball(4, MppiConfig(samples=16)) == around_the_ball(4, MppiConfig(samples=16))
