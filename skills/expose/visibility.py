"""How well the camera sees the dissected region in predicted states: the losses and the constraint of exposure maximization.

    L_cam    = sum_i n_i'w_c                                  (Eq. normal_loss)   surface normals against the camera's forward direction
    L_deform = sum_p -w_n (n'F^p n)^2 + w_s (n'F^p m)^2       (Eq. deform_loss)   the region widened across the goal, not sheared along it
    C_vis    = 1 if a tracked pixel lies outside the image    (visibility constraint)

Sums are taken as means over the pixels, so that no weight depends on how many there are. One more term is not in the paper: `opening`,
the area of the parted cut that the camera sees. All samples and steps of a rollout are judged in one launch on its device.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Protocol

import numpy as np
import warp as wp
from numpy.typing import NDArray

from hardware.interface import Array, CameraModel
from skills.expose import visibility_kernels as kernels
from skills.expose.region import Region
from skills.scene.surface import Surface

FLAT = 1e-3  # lattice cells thinner than this share of a square tell no deformation gradient


class Expansion(StrEnum):
    """How a pixel that is turned inside out (n'Fn < 0: the tissue is folded over) counts in the deformation expanding loss."""

    SIGNED = "signed"  # n'Fn |n'Fn|: it costs
    SQUARED = "squared"  # (n'Fn)^2, the paper's: it gains as much as an expanded one


@dataclass(frozen=True)
class VisibilityConfig:
    """Weights within the deformation expanding loss."""

    stretch_weight: float = 1.0  # w_n
    shear_weight: float = 0.5  # w_s; several times w_n makes the controller dither
    expansion: Expansion = Expansion.SIGNED

    def __post_init__(self) -> None:
        for name in ("stretch_weight", "shear_weight"):
            _check_weight(name, getattr(self, name))
        object.__setattr__(self, "expansion", Expansion(self.expansion))


@dataclass(frozen=True)
class LossWeights:
    """What each term weighs in the cost of a rollout."""

    camera: float = 1.0  # lambda_c
    deform: float = 1.0  # lambda_d
    opening: float = 0.0  # lambda_o [1/px^2], a reward; the paper has none

    def __post_init__(self) -> None:
        for name in ("camera", "deform", "opening"):
            _check_weight(name, getattr(self, name))


@dataclass(frozen=True)
class Terms:
    """Unweighted terms of every step and sample of a rollout, each (h, K)."""

    camera: Array  # L_cam: mean over the pixels, -1 (all face the camera) to 1
    deform: Array  # L_deform: mean over the pixels that have a deformation gradient
    visible: NDArray[np.bool_]  # no tracked pixel is outside the image or behind the camera
    opening: Array  # [px^2] area of the parted cut that the camera sees


@dataclass(frozen=True)
class Lips:
    """The edges of the cut in a mesh that is split along the goal: one place a row, in order along the goal.

    `station` (S,) [px], increasing; `far` and `near` (S,) int32 vertices. At a tip of the cut both are the same vertex.
    """

    station: Array
    far: NDArray[np.int32]
    near: NDArray[np.int32]


class Rolled(Protocol):
    """What is needed of a rollout: its trajectory on the device, and how many samples it has, (h, K) being the tension's shape."""

    @property
    def trajectory(self) -> Any:
        """(h, K / 8, V) of 3x8 float32 matrices or (h, V, K) of vec3 [m]."""

    @property
    def tension(self) -> Array:
        """(h, K)."""


def lips_of(surface: Surface, seams: NDArray[np.int32]) -> Lips:
    """Lips of a mesh made from `surface` by splitting its goal line at `seams` (S, 2): vertex and its copy on the far side.

    The unsplit vertices of the line that come next before and after are the tips.
    """
    line = np.flatnonzero(surface.lateral == 0)
    near = line[np.argsort(surface.station[line], kind="stable")].astype(np.int32)
    copy = np.arange(len(surface.vertices), dtype=np.int32)
    copy[seams[:, 0]] = seams[:, 1]
    split = np.flatnonzero(copy[near] != near)
    if len(split) < len(seams):
        raise ValueError("a seam is not on the goal's line")
    part = slice(max(split[0] - 1, 0), split[-1] + 2) if len(split) else slice(0)
    return Lips(surface.station[near[part]], copy[near[part]], near[part])


def cost(terms: Terms, weights: LossWeights) -> tuple[Array, NDArray[np.bool_]]:
    """Cost of every sample (K,), summed over the horizon, and which samples (K,) are feasible; the others cost infinitely much.

    Infeasible is what leaves the image at any step, or has a term that is not finite.
    """
    total = (weights.camera * terms.camera + weights.deform * terms.deform - weights.opening * terms.opening).sum(axis=0)
    feasible = terms.visible.all(axis=0) & np.isfinite(total)
    return np.where(feasible, total, np.inf), feasible


class Visibility:
    """Judges rollouts by what the camera would see of `region`.

    `triangles` (F, 3) are the model's, in the order of the surface's. `lips` are where its cut may open; without them, and in columns
    beyond them, the opening is judged by how far the innermost rows have moved apart. On a processor the work is shared by `threads`;
    with a hundred samples one is as fast as two. One caller at a time: the buffers are kept from call to call.
    """

    def __init__(
        self,
        region: Region,
        triangles: NDArray[np.int32],
        camera: CameraModel,
        lips: Lips | None = None,
        config: VisibilityConfig | None = None,
        *,
        device: str = "cpu",
        threads: int = 1,
    ) -> None:
        self._config = config or VisibilityConfig()
        self._device = wp.get_device(device)
        if threads < 1:
            raise ValueError(f"threads must be at least 1, not {threads}")
        self._threads = threads if self._device.is_cpu else 1
        self._pool = ThreadPoolExecutor(self._threads) if self._threads > 1 else None
        self._lattice, self._vertices = _lattice(region, np.asarray(triangles), lips, str(self._device))
        self._pixels = int(region.used.sum())
        lens = kernels.Lens()
        lens.focal, lens.cu, lens.cv = camera.focal, camera.cu, camera.cv
        lens.width, lens.height = camera.width, camera.height
        self._lens = lens
        loss = kernels.Loss()
        loss.w_n, loss.w_s = self._config.stretch_weight, self._config.shear_weight
        loss.folds_cost = int(self._config.expansion is Expansion.SIGNED)
        self._loss = loss
        self._buffers: tuple[Any, ...] | None = None

    def terms(self, rollout: Rolled) -> Terms:
        """Terms of every step and sample of `rollout`."""
        return self.judge(rollout.trajectory, rollout.tension.shape[1])

    def judge(self, trajectory: Any, samples: int) -> Terms:
        """Terms of every step and of the first `samples` samples of `trajectory`.

        Raises:
            ValueError: it is no trajectory, is on another device, or has too few samples or vertices.
        """
        lanes = kernels.lanes_of(trajectory)
        blocks, vertices = kernels.blocks_of(trajectory)
        if trajectory.device != self._device:
            raise ValueError(f"the trajectory is on {trajectory.device}, not on {self._device}")
        if not 0 < samples <= blocks * lanes:
            raise ValueError(f"samples must be 1 to {blocks * lanes}, the samples of the trajectory, not {samples}")
        if vertices < self._vertices:
            raise ValueError(f"the trajectory has {vertices} vertices, but the region and its lips name {self._vertices}")
        scratch, out = self._room(trajectory)
        kernel = kernels.visibility_kernel(lanes)

        def launch(first: int, count: int) -> None:
            inputs = [trajectory, scratch, self._lattice, self._lens, self._loss, first]
            wp.launch(kernel, dim=(trajectory.shape[0], count), inputs=inputs, outputs=[out], device=self._device)

        share = -(-blocks // self._threads)
        parts = [(first, min(share, blocks - first)) for first in range(0, blocks, share)]
        if self._pool is None or len(parts) == 1:
            for part in parts:
                launch(*part)
        else:
            running = [self._pool.submit(launch, *part) for part in parts]
            wait(running)
            for done in running:
                done.result()
        # (h, blocks, 4, lanes) -> (4, h, K)
        terms = out.numpy().transpose(2, 0, 1, 3).reshape(4, trajectory.shape[0], -1)[..., :samples].astype(np.float64)
        return Terms(camera=terms[0], deform=terms[1], visible=terms[3] > 0.5, opening=terms[2])

    def _room(self, trajectory: Any) -> tuple[Any, Any]:
        """Buffers for this shape of trajectory, made anew only when the shape changes; its kernel is loaded then too."""
        key = (kernels.lanes_of(trajectory), trajectory.shape[0], kernels.blocks_of(trajectory)[0])
        if self._buffers is None or self._buffers[0] != key:
            # Here, so that the threads do not all load it at once.
            module = kernels.visibility_kernel(key[0]).module
            wp.load_module(module, device=self._device, block_dim=1 if self._device.is_cpu else None)
            self._buffers = (key, kernels.scratch(trajectory, self._pixels), kernels.terms_array(trajectory))
        return self._buffers[1], self._buffers[2]


def _lattice(region: Region, triangles: NDArray[np.int32], lips: Lips | None, device: str) -> tuple[Any, int]:
    """Lay the used pixels of `region` out for the kernel; also how many vertices a mesh must have."""
    used = region.used
    if not used.any():
        raise ValueError("no pixel of the region can be used")
    index = np.full(region.shape, -1)
    index.T[used.T] = np.arange(used.sum())  # column by column
    order = np.arange(used.size).reshape(region.shape).T[used.T]
    if region.points.triangle[order].min() < 0 or region.points.triangle[order].max() >= len(triangles):
        raise ValueError(f"a used pixel of the region is on none of the {len(triangles)} triangles")
    corners = triangles[region.points.triangle[order]]
    gradient = _gradient(region, index)
    columns = _columns(region, index, lips)
    lattice = kernels.Lattice()
    for name, dtype, values in (
        ("corners", wp.vec3i, corners),
        ("barycentric", wp.vec3, region.points.barycentric[order]),
        ("ends", wp.vec4i, gradient[0]),
        ("normal", wp.vec2, gradient[1]),
        ("stretch", wp.vec2, gradient[2]),
        ("shear", wp.vec2, gradient[3]),
        ("span", wp.vec3i, columns[0]),
        ("direction", wp.vec2, region.normal),
        ("origin", wp.vec2, region.origin),
        ("lips", wp.vec4i, columns[1]),
        ("share", wp.float32, columns[2]),
        ("closed", wp.float32, columns[3]),
        ("width", wp.float32, columns[4]),
    ):
        scalar = np.int32 if dtype in (wp.vec3i, wp.vec4i) else np.float32
        setattr(lattice, name, wp.array(np.ascontiguousarray(values, scalar), dtype=dtype, device=device))
    return lattice, 1 + max(int(corners.max()), int(columns[1].max()))


def _gradient(region: Region, index: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array, Array, Array]:
    """Prepare n'Fn and n'Fm of every pixel that has a used neighbour both across and along the goal.

    With D the two differences of tracked pixels and D0 those at t_d, F = D D0^-1; so n'Fn = n'D (D0^-1 n), and only D changes.
    Central differences where both neighbours are used, else one-sided. On a straight goal D0^-1 n = (1 / step across, 0).
    """
    before_across, after_across = _neighbours(index)
    before_along, after_along = (ends.T for ends in _neighbours(index.T))
    ends = np.stack([before_across, after_across, before_along, after_along], axis=-1)
    node = np.argwhere((index >= 0) & (before_across != after_across) & (before_along != after_along))
    ends = ends[node[:, 0], node[:, 1]]
    place = region.pixels.reshape(*region.shape, 2)[index >= 0]
    pixels = np.empty_like(place)
    pixels[index[index >= 0]] = place
    D0 = np.stack([pixels[ends[:, 1]] - pixels[ends[:, 0]], pixels[ends[:, 3]] - pixels[ends[:, 2]]], axis=-1)
    sizes = np.linalg.norm(D0, axis=1).prod(axis=1)
    wide = np.abs(np.linalg.det(D0)) > FLAT * np.maximum(sizes, 1e-12)
    ends, D0, column = ends[wide], D0[wide], node[wide, 1]
    n, m = region.normal[column], region.tangent[column]
    inverse = np.linalg.inv(D0)
    return ends, n, (inverse @ n[..., None])[..., 0], (inverse @ m[..., None])[..., 0]


def _neighbours(index: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The used neighbours of each node in the row before and the row after, the node itself where there is none."""
    padded = np.pad(index, ((1, 1), (0, 0)), constant_values=-1)
    before, after = padded[:-2], padded[2:]
    return np.where(before >= 0, before, index), np.where(after >= 0, after, index)


def _columns(region: Region, index: NDArray[np.int64], lips: Lips | None) -> tuple[Array | NDArray[np.int64], ...]:
    """Span, lips, share, closed gap and width of every column."""
    far, near = region.lateral < 0, region.lateral > 0
    used = index >= 0
    ends = np.cumsum(used.sum(axis=0))
    span = np.stack([ends - used.sum(axis=0), ends - used[near].sum(axis=0), ends], axis=1)
    count = region.shape[1]
    corners, share = np.full((count, 4), -1), np.zeros(count)
    if lips is not None and len(lips.station):
        if not (len(lips.station) == len(lips.far) == len(lips.near) and (np.diff(lips.station) > 0).all()):
            raise ValueError("lips must have one far and one near vertex at each station, and stations that increase")
        held = (region.station >= lips.station[0]) & (region.station <= lips.station[-1])
        after = np.clip(np.searchsorted(lips.station, region.station), 1, max(len(lips.station) - 1, 1))
        before, after = after - 1, np.minimum(after, len(lips.station) - 1)
        step = np.maximum(lips.station[after] - lips.station[before], 1e-12)
        share = np.where(held, (region.station - lips.station[before]) / step, 0.0)
        pairs = np.stack([lips.far[before], lips.far[after], lips.near[before], lips.near[after]], axis=1)
        corners = np.where(held[:, None], pairs, -1)
    # Between the innermost rows there is tissue already at t_d; what they part by is beyond that.
    reach_far = np.where(used[far], region.lateral[far, None], -np.inf).max(axis=0)
    reach_near = np.where(used[near], region.lateral[near, None], np.inf).min(axis=0)
    lipless = corners[:, 0] < 0
    judged = ~lipless | (np.isfinite(reach_far) & np.isfinite(reach_near))
    closed = np.where(lipless & judged, reach_near - reach_far, 0.0)
    span[~judged] = 0  # such a column has no gap and no width, but still reads a pixel, and the first one always exists
    return span, corners, share, closed, np.where(judged, region.spacing[1], 0.0)


def _check_weight(name: str, value: float) -> None:
    if not (np.isfinite(value) and value >= 0):
        raise ValueError(f"{name} must be a finite number of at least 0, not {value}")
