"""Model predictive path integral control: sampled gripper steps, weighted by what they cost (paper, Sec. Exposure Maximization Control).

The update is the information-theoretic one of Williams et al. (2015, 2017): samples around the nominal plan are averaged with weights
exp(-S / lambda). What rolls the samples out and what they cost is the caller's business. One round of the controller:

    noise = perturbations(rng, config)
    samples = controls(nominal, noise, config.max_step)
    ... roll out, cost and feasibility of each sample ...
    update = updated(nominal, samples, costs, feasible, config)
    ... execute update.nominal[0], then nominal = shifted(update.nominal) ...

All arrays are float64, lengths in metres, left camera frame; K samples, h steps of the horizon.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hardware.codes import Code
from hardware.interface import Array


@dataclass(frozen=True)
class MppiConfig:
    """Settings of the sampling and of the update. Lengths [m]."""

    samples: int = 64  # K
    horizon: int = 8  # h, steps
    sigma: float = 0.25e-3  # standard deviation of the noise, each axis and each step
    correlation: float = 0.7  # of the noise between one step and the next; white noise cancels itself along the horizon
    temperature: float = 0.2  # lambda as a multiple of the spread of the better half of the costs, so that costs need no scale
    min_effective: float = 0.05  # share of the feasible samples that must carry the average, two at least; 0: no such demand
    max_step: float = 0.5e-3  # length of one step, Euclidean
    iterations: int = 1  # rounds of sampling and updating before a step is executed
    shrink: float = 0.6  # of sigma, from one of these rounds to the next
    antithetic: bool = True  # noise in pairs of opposite sign, so that its mean is zero at any K

    def __post_init__(self) -> None:
        for name in ("samples", "horizon", "iterations"):
            value = getattr(self, name)
            if not (isinstance(value, int) and value >= 1):
                raise ValueError(f"{name} must be an integer of 1 or more, not {value}")
        for name in ("sigma", "temperature", "max_step"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} must be finite and above 0, not {value}")
        for name in ("correlation", "min_effective", "shrink"):
            value = getattr(self, name)
            if not 0 <= value <= 1:
                raise ValueError(f"{name} must lie within 0 and 1, not {value}")
        if self.shrink == 0:
            raise ValueError("shrink must be above 0: without noise nothing is sampled")


@dataclass(frozen=True)
class MppiUpdate:
    """`code` OK, or EXPOSURE_INFEASIBLE when no sample may be used; then `nominal` is the one that came in.

    `nominal` (h, 3) [m]; `weights` (K,), their sum 1 (all 0 when infeasible); `effective_samples` = 1 / sum of the squared weights;
    `feasible` the share of usable samples; `best` the index of the cheapest usable sample (-1: none); `temperature` the lambda used,
    in units of the costs; `agreement` = |weighted mean of the first steps| / weighted mean of their lengths, 0..1: near 1 the good
    samples pull the same way, near 0 they cancel each other, and a step rescaled to full length would hide that nothing is decided.
    """

    code: Code
    message: str
    nominal: Array
    weights: Array
    effective_samples: float
    feasible: float
    best: int
    temperature: float
    agreement: float


def perturbations(rng: np.random.Generator, config: MppiConfig) -> Array:
    """Noise (K, h, 3) [m] to add to the nominal: Gaussian, stationary and of first order along the horizon, axes independent.

    Sample 0 is zero: the nominal itself is rolled out with the others. Then a plan that is good already is never lost to noise, its
    predicted tension and strain are known, and it may still be feasible when every disturbed plan is not.
    """
    count = config.samples - 1
    drawn = (count + 1) // 2 if config.antithetic else count
    white = rng.standard_normal((drawn, config.horizon, 3))
    noise = np.empty_like(white)
    rho, fresh = config.correlation, math.sqrt(1.0 - config.correlation**2)
    noise[:, 0] = white[:, 0]
    for t in range(1, config.horizon):
        # The share of fresh noise keeps the variance the same at every step.
        noise[:, t] = rho * noise[:, t - 1] + fresh * white[:, t]
    if config.antithetic:
        noise = np.concatenate([noise, -noise])[:count]
    return np.concatenate([np.zeros((1, config.horizon, 3)), config.sigma * noise])


def controls(nominal: Array, noise: Array, max_step: float) -> Array:
    """Steps (K, h, 3) [m]: `nominal` (h, 3) + `noise` (K, h, 3), each no longer than `max_step` [m].

    A longer step is shortened along its own direction. A limit per axis would turn it, and the direction is what is being decided.
    """
    steps = nominal + noise
    length = np.linalg.norm(steps, axis=-1, keepdims=True)
    return np.asarray(steps * (max_step / np.maximum(length, max_step)))


def updated(nominal: Array, controls: Array, costs: Array, feasible: NDArray[np.bool_], config: MppiConfig) -> MppiUpdate:
    """The plan after one round: the average of the samples with weights exp(-(S - min S) / lambda).

    The control-cost term of the information-theoretic form, (1 - alpha) u' Sigma^-1 eps, is left out (alpha = 1): the noise is taken
    as centred on the nominal, not on standing still. The paper's losses have no cost of control, and a pull that lasts must not be
    drawn back to zero. Shortened samples count as the steps that were rolled out, so the average needs no shortening.

    When the weights rest on too few samples (`min_effective`), lambda is raised until they rest on enough: an average of one or two
    samples is mostly noise.

    Args:
        nominal: (h, 3) [m] the plan that was sampled around.
        controls: (K, h, 3) [m] the steps that were rolled out.
        costs: (K,) of each sample; one that is not finite makes its sample infeasible. Never mark bad samples by a huge cost: where they
            are more than half, lambda is theirs, and all the others look alike.
        feasible: (K,) bool, False discards a sample (paper, visibility constraint).
        config: temperature and the wanted number of effective samples.
    """
    nominal, controls, costs = np.asarray(nominal), np.asarray(controls), np.asarray(costs, dtype=np.float64)
    samples = len(controls)
    if controls.shape != (samples, *nominal.shape) or nominal.shape[1:] != (3,):
        raise ValueError(f"controls must be (K, h, 3) around a nominal of (h, 3), not {controls.shape} around {nominal.shape}")
    if costs.shape != (samples,) or np.shape(feasible) != (samples,):
        raise ValueError(f"costs and feasible must be ({samples},), not {costs.shape} and {np.shape(feasible)}")
    usable = np.asarray(feasible, dtype=bool) & np.isfinite(costs) & np.isfinite(controls).all(axis=(1, 2))
    count = int(usable.sum())
    if not count:
        message = f"none of the {samples} sampled pulls keeps the tissue in view and within its limits"
        return MppiUpdate(Code.EXPOSURE_INFEASIBLE, message, nominal.copy(), np.zeros(samples), 0.0, 0.0, -1, 0.0, 0.0)
    least, span = float(costs[usable].min()), float(np.ptp(costs[usable]))
    above = (costs[usable] - least) / span if span > 0 else np.zeros(count)
    lowest = min(float(count), max(2.0, config.min_effective * count)) if config.min_effective > 0 else 1.0
    temperature = _temperature(above, config.temperature * _spread(above), lowest)
    weights = np.zeros(samples)
    weights[usable] = _weights(above, temperature)
    taken = controls[usable]  # the others may hold nan, which a weight of 0 does not cancel
    average = np.einsum("k,kti->ti", weights[usable], taken)
    mean_length = float(weights[usable] @ np.linalg.norm(taken[:, 0], axis=1))
    effective = 1.0 / float(weights @ weights)
    return MppiUpdate(
        code=Code.OK,
        message=f"{count} of {samples} sampled pulls are feasible, {effective:.1f} carry the average",
        nominal=average,
        weights=weights,
        effective_samples=effective,
        feasible=count / samples,
        best=int(np.flatnonzero(usable)[np.argmin(above)]),
        temperature=temperature * span,
        agreement=float(np.linalg.norm(average[0])) / mean_length if mean_length > 0 else 0.0,
    )


def adapted(config: MppiConfig, iteration: int) -> MppiConfig:
    """The settings of round `iteration` (0, 1, ...) of an update: noise of sigma * shrink^iteration.

    Several small rounds are of use where rollouts are dear and the batch therefore small (8 to 32 samples on a processor): the first
    round finds the direction, the later ones refine around it, with fewer rollouts in all than one large round. With a large batch that
    runs at once (a GPU) one round is faster, and the warm start between steps does the refining. A sigma that shrinks too early
    settles on the nearest optimum, so it starts afresh at every executed step.
    """
    if iteration < 0:
        raise ValueError(f"iteration must be 0 or more, not {iteration}")
    return replace(config, sigma=config.sigma * config.shrink**iteration)


def shifted(nominal: Array, steps: int = 1) -> Array:
    """The plan (h, 3) [m] for the next update, when its first `steps` steps have been executed.

    The last step is repeated. Zeros would claim that the pull ends at the horizon and would drag each new average towards standing
    still, whereas the best guess for the step after the last is the last once more.
    """
    if steps < 0:
        raise ValueError(f"steps must be 0 or more, not {steps}")
    horizon = len(nominal)
    return np.array(nominal[np.minimum(np.arange(horizon) + steps, horizon - 1)])


def _spread(above: Array) -> float:
    """How far the costs (n,) of the better half scatter: root mean square distance below the median.

    The standard deviation where costs scatter evenly to both sides. Near a limit they do not: samples that break it cost so much that
    the standard deviation is theirs alone, and lambda with it; all others would look alike and cancel, and the plan would stand still.
    """
    below = float(np.median(above)) - above
    spread = float(np.sqrt(np.mean(below[below >= 0.0] ** 2)))
    # Where half of them cost the least, nothing lies below the median, and the others are told by how much more they cost.
    return spread if spread > 0.0 else float(above.std())


def _weights(above: Array, temperature: float) -> Array:
    """Weights (n,), their sum 1, of costs (n,) above the least one. Temperature 0: all costs are equal, so are the weights."""
    raw = np.exp(-above / temperature) if temperature > 0 else np.ones(len(above))
    return np.asarray(raw / raw.sum())


def _temperature(above: Array, temperature: float, lowest: float) -> float:
    """The given temperature, or the least higher one at which `lowest` samples are effective."""

    def effective(beta: float) -> float:
        raw = np.exp(-beta * above)
        return float(raw.sum() ** 2 / (raw @ raw))

    if not temperature > 0 or effective(1.0 / temperature) >= lowest:
        return temperature
    # The effective number falls steadily with beta = 1 / lambda, from all samples at 0.
    low, high = 0.0, 1.0 / temperature
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if effective(middle) >= lowest else (low, middle)
    return 1.0 / low if low > 0 else math.inf
