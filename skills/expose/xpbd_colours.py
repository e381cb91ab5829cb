"""The order in which constraints are projected: greedy colours, the same in every form of the solver.

Constraints of one colour share no vertex that moves. Projecting them all at once (CUDA, NumPy) or one after the other (CPU) is
therefore the same Gauss-Seidel sweep, and the forms differ by rounding alone.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array
from skills.expose.model import Flags, Indices, TissueModel

Array32 = NDArray[np.float32]


@dataclass(frozen=True)
class Schedule:
    """The constraints of a model in the order of a sweep, without those that join no free vertex. Float64.

    `*_start` (colours + 1,) says where each colour begins. `gain` is 1 / (sum of w |grad C|^2 + compliance), constant as every
    gradient here is of constant length; w is 1 / inertia of a free vertex, 0 of a held one.
    """

    inverse_inertia: Array  # (V,) [m/N]
    shift: Array  # (V, 3) [m]: what the external force moves a vertex in one substep, without constraints
    edges: Indices  # (E, 2)
    rest_length: Array  # (E,) [m]
    edge_compliance: Array  # (E,) [m/N]
    edge_gain: Array  # (E,) [N/m]
    edge_start: Indices
    hinges: Indices  # (H, 4)
    hinge_weights: Array  # (H, 4)
    hinge_rest: Array  # (H, 3) [m]
    hinge_compliance: Array  # (H,) [m/N]
    hinge_gain: Array  # (H,) [N/m]
    hinge_start: Indices
    seams: Indices  # (S, 2), of the model, in its order where one colour suffices
    seam_of: Indices  # (S,) which seam of the model
    seam_stiffness: Array  # (S,) [N/m] when whole
    seam_start: Indices
    anchored: Indices  # (A,) free vertices with an adhesion
    # What the jaws feel: edges from a grasped vertex (first) to another; hinges over the patch's rim, the stiffness with which each
    # acts on the patch as a whole; seams of the schedule with one grasped end, +1 where it is the first.
    pulling: Indices  # (P, 2)
    pulling_length: Array  # (P,) [m]
    pulling_stiffness: Array  # (P,) [N/m]
    rim: Indices  # (R, 4)
    rim_weights: Array  # (R, 4)
    rim_rest: Array  # (R, 3) [m]
    rim_stiffness: Array  # (R,) [N/m]
    gripped_seams: Indices  # (G,)
    gripped_sign: Array  # (G,)
    watched: Indices  # (W, 2): edges whose strain counts
    watched_length: Array  # (W,) [m]


def schedule(model: TissueModel, inertia: float) -> Schedule:
    """Order the constraints of `model` for vertices of `inertia` [N/m]."""
    free = model.free
    w = np.where(free, 1.0 / inertia, 0.0)
    edge, edge_start = _ordered(model.edges, free)
    hinge, hinge_start = _ordered(model.hinges, free)
    seam, seam_start = _ordered(model.seams, free)
    edges, hinges = model.edges[edge], model.hinges[hinge]
    held = model.grasped[model.edges]
    pulling = held[:, 0] != held[:, 1]
    pairs = model.edges[pulling]
    on_patch = (model.hinge_weights * model.grasped[model.hinges]).sum(axis=1) / model.hinge_compliance
    held_corners = model.grasped[model.hinges].sum(axis=1)
    rim = (held_corners > 0) & (held_corners < 4)
    seams = model.seams[seam]
    ends = model.grasped[seams]
    gripped = np.flatnonzero(ends[:, 0] != ends[:, 1])
    watched = ~held.any(axis=1) & free[model.edges].any(axis=1)
    return Schedule(
        inverse_inertia=w,
        shift=model.weight * w[:, None],
        edges=edges,
        rest_length=model.rest_length[edge],
        edge_compliance=model.edge_compliance[edge],
        edge_gain=1.0 / (w[edges].sum(axis=1) + model.edge_compliance[edge]),
        edge_start=edge_start,
        hinges=hinges,
        hinge_weights=model.hinge_weights[hinge],
        hinge_rest=model.hinge_rest[hinge],
        hinge_compliance=model.hinge_compliance[hinge],
        hinge_gain=1.0 / ((w[hinges] * model.hinge_weights[hinge] ** 2).sum(axis=1) + model.hinge_compliance[hinge]),
        hinge_start=hinge_start,
        seams=seams,
        seam_of=seam.astype(np.int32),
        seam_stiffness=1.0 / model.seam_compliance[seam],
        seam_start=seam_start,
        anchored=np.flatnonzero(free & (model.adhesion > 0.0)).astype(np.int32),
        pulling=np.where(model.grasped[pairs[:, :1]], pairs, pairs[:, ::-1]),
        pulling_length=model.rest_length[pulling],
        pulling_stiffness=1.0 / model.edge_compliance[pulling],
        rim=model.hinges[rim],
        rim_weights=model.hinge_weights[rim],
        rim_rest=model.hinge_rest[rim],
        rim_stiffness=on_patch[rim],
        gripped_seams=gripped.astype(np.int32),
        gripped_sign=np.where(ends[gripped, 0], 1.0, -1.0),
        watched=model.edges[watched],
        watched_length=model.rest_length[watched],
    )


def greedy_colours(rows: Indices, free: Flags) -> NDArray[np.int64]:
    """A colour (N,) for each row (N, n) of vertices, so that rows of one colour share no free vertex.

    First fit in the given order: at most n (m - 1) + 1 colours where m rows meet at a vertex.
    """
    used: list[int] = [0] * len(free)  # per vertex, a bit for each colour that meets it
    colours = np.zeros(len(rows), dtype=np.int64)
    for k, row in enumerate(rows.tolist()):
        moving = [v for v in row if free[v]]
        taken = 0
        for v in moving:
            taken |= used[v]
        lowest = ~taken & (taken + 1)
        for v in moving:
            used[v] |= lowest
        colours[k] = lowest.bit_length() - 1
    return colours


def _ordered(rows: Indices, free: Flags) -> tuple[NDArray[np.int64], Indices]:
    """The rows (N,) with a free vertex, by colour, and where each colour starts (colours + 1,)."""
    live = np.flatnonzero(free[rows].any(axis=1))
    colours = greedy_colours(rows[live], free)
    order = live[np.argsort(colours, kind="stable")]
    start = np.concatenate([[0], np.cumsum(np.bincount(colours))])
    return order, start.astype(np.int32)
