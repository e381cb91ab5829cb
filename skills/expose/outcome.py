"""What an exposure gives back: the gripper's path, what was expected and seen on it, and why it ended."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hardware.codes import Code
from hardware.interface import Array


@dataclass(frozen=True)
class Forecast:
    """How the model expects the edges of the keypoint grid to lengthen, if the goal is severed and if it is connected.

    `edges` (C,) index the grid's edges that cross the goal; `severed` and `connected` (S, C) are their expected elongation after
    each step of the path, `connected` being that of a strand left alone where the edge is, which stretches most; `gap` (S, C) [px] is the
    opening expected along a severed edge (below 0 its lips overlap); `separation` (S,) in standard deviations, that of the edge which is
    hardest to tell.
    """

    edges: NDArray[np.int64]
    severed: Array
    connected: Array
    gap: Array
    separation: Array


@dataclass(frozen=True)
class Planned:
    """What the controller had in mind at each step of the path, (S,) each: terms of its loss, means over samples and horizon.

    `camera`, `deform` as in the paper's equations, per pixel; `opening` [px^2] the area of the cut that it expects the camera to see;
    `tension` [N] expected; `effective` samples of the update; `feasible` share of them; `agreement` 0..1, the length of the mean
    step over the mean length of the sampled ones (1: all agree).
    """

    camera: Array
    deform: Array
    opening: Array
    tension: Array
    effective: Array
    feasible: Array
    agreement: Array


@dataclass(frozen=True)
class ExposeOutcome:
    """`code` OK when the tissue was pulled as far as planned or as far as a limit allows (then `stopped_by` says which).

    `path` (S, 3) [m] are the gripper positions after each step, `tension` (S,) [N], `strain` (S,) the strain seen by tracking (nan
    unknown), `stamps` (S,) [s] the bench's time. `forecast` comes from the tissue model, `planned` from the controller alone.
    """

    code: Code
    message: str
    stopped_by: Code
    path: Array
    tension: Array
    strain: Array
    stamps: Array
    forecast: Forecast | None = None
    planned: Planned | None = None
