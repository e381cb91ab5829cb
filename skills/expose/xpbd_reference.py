"""The solver in plain NumPy and float64: what the fast forms are held against."""

import itertools
from dataclasses import dataclass

import numpy as np

from hardware.interface import Array
from skills.expose.model import Indices, TissueModel
from skills.expose.xpbd_colours import Schedule, schedule


@dataclass(frozen=True)
class ReferenceRollout:
    """What a rollout gives, float64, on the host."""

    positions: Array  # (h, K, V, 3) [m]
    tension: Array  # (h, K) [N]
    strain: Array  # (h, K)
    adhesion: Array  # (K, V) [N/m] what is left at the end


def reference_rollout(
    model: TissueModel,
    positions: Array,
    adhesion: Array,
    joined: Array,
    controls: Array,
    *,
    inertia: float,
    substeps: int,
    iterations: int,
) -> ReferenceRollout:
    """Roll out `controls` (K, h, 3) [m] from `positions` (K, V, 3), `adhesion` (K, V) [N/m] and `joined` (K, S)."""
    plan = schedule(model, inertia)
    samples, horizon = controls.shape[:2]
    x = np.array(np.broadcast_to(positions, (samples, len(model.rest), 3)), dtype=np.float64)
    left = np.array(np.broadcast_to(adhesion, (samples, len(model.rest))), dtype=np.float64)
    share = np.broadcast_to(joined, (samples, len(model.seams))).astype(np.float64)[:, plan.seam_of]
    trajectory = np.empty((horizon, *x.shape))
    tension, strain = np.empty((horizon, samples)), np.empty((horizon, samples))
    for step in range(horizon):
        for _ in range(substeps):
            x[:, model.grasped] += controls[:, step, None] / substeps
            x += plan.shift
            _substep(model, plan, x, left, share * plan.seam_stiffness, iterations)
            left[model.free & (np.linalg.norm(x - model.rest, axis=2) > model.adhesion_limit)] = 0.0
        trajectory[step] = x
        tension[step] = _tension(plan, x, share * plan.seam_stiffness)
        strain[step] = _strain(plan, x)
    return ReferenceRollout(trajectory, tension, strain, left)


def _substep(model: TissueModel, plan: Schedule, x: Array, adhesion: Array, seam: Array, iterations: int) -> None:
    """Project `x` (K, V, 3) in place, multipliers from 0."""
    samples, w = len(x), plan.inverse_inertia
    edge_force = np.zeros((samples, len(plan.edges)))
    hinge_force = np.zeros((samples, len(plan.hinges), 3))
    seam_force = np.zeros((samples, len(plan.seams), 3))
    bed_force = np.zeros((samples, len(plan.anchored), 3))
    for _ in range(iterations):
        for at in _colours(plan.edge_start):
            i, j = plan.edges[at].T
            apart = x[:, i] - x[:, j]
            length = np.linalg.norm(apart, axis=2)
            change = (plan.rest_length[at] - length - plan.edge_compliance[at] * edge_force[:, at]) * plan.edge_gain[at]
            edge_force[:, at] += change
            push = apart * (change / np.maximum(length, 1e-9))[:, :, None]
            x[:, i] += w[i, None] * push
            x[:, j] -= w[j, None] * push
        for at in _colours(plan.hinge_start):
            corners, weights = plan.hinges[at], plan.hinge_weights[at]
            bent = np.einsum("hk,shkc->shc", weights, x[:, corners]) - plan.hinge_rest[at]
            push = -(bent + plan.hinge_compliance[at, None] * hinge_force[:, at]) * plan.hinge_gain[at, None]
            hinge_force[:, at] += push
            for k in range(4):
                x[:, corners[:, k]] += (w[corners[:, k]] * weights[:, k])[:, None] * push
        for at in _colours(plan.seam_start):
            i, j = plan.seams[at].T
            stiffness = seam[:, at, None]
            push = -(stiffness * (x[:, i] - x[:, j]) + seam_force[:, at]) / (stiffness * (w[i] + w[j])[:, None] + 1.0)
            seam_force[:, at] += push
            x[:, i] += w[i, None] * push
            x[:, j] -= w[j, None] * push
        on = plan.anchored
        hold = adhesion[:, on, None]
        push = -(hold * (x[:, on] - model.rest[on]) + bed_force) / (hold * w[on, None] + 1.0)
        bed_force += push
        x[:, on] += w[on, None] * push
        if model.floor is not None:
            depth = np.minimum(x @ model.floor[:3] + model.floor[3], 0.0) * (w > 0.0)
            x -= depth[:, :, None] * model.floor[:3]


def _colours(start: Indices) -> list[slice]:
    return [slice(int(a), int(b)) for a, b in itertools.pairwise(start)]


def _tension(plan: Schedule, x: Array, seam: Array) -> Array:
    held, other = plan.pulling.T
    apart = x[:, other] - x[:, held]
    length = np.linalg.norm(apart, axis=2)
    force = plan.pulling_stiffness * (length - plan.pulling_length) / np.maximum(length, 1e-9)
    total = (force[:, :, None] * apart).sum(axis=1)
    bent = np.einsum("rk,srkc->src", plan.rim_weights, x[:, plan.rim]) - plan.rim_rest
    total -= (plan.rim_stiffness[:, None] * bent).sum(axis=1)
    first, second = plan.seams[plan.gripped_seams].T
    pull = (seam[:, plan.gripped_seams] * plan.gripped_sign)[:, :, None]
    total += (pull * (x[:, second] - x[:, first])).sum(axis=1)
    return np.asarray(np.linalg.norm(total, axis=1))


def _strain(plan: Schedule, x: Array) -> Array:
    i, j = plan.watched.T
    length = np.linalg.norm(x[:, i] - x[:, j], axis=2)
    return np.asarray((length / plan.watched_length - 1.0).max(axis=1, initial=0.0))
