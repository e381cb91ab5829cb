"""The surface mesh of the tissue around the goal at t_d, from a depth map and the picture's masks (paper, Exposure Maximization).

The mesh is a lattice that follows the goal, so that the controller's model can part it along the goal's line. It covers the tissue
as if there were no cut: where an opening, a tool or poor texture hides the surface, its neighbours fill it in.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray

from hardware.codes import Code
from hardware.interface import Array, CameraModel
from skills.scene.depth_fit import DepthFit, FitConfig, fit_disparity
from skills.scene.lattice import Lattice, lay
from skills.scene.polyline import arc_lengths, side_of
from skills.scene.segments import distances
from skills.scene.stereo import DepthMap
from skills.scene.tissue import Mask, tissue_outline
from skills.scene.triangles import covers, edges_of, mesh_of, piece_with, turn


@dataclass(frozen=True)
class SurfaceConfig:
    """Size of the lattice and what a usable surface must have. Lengths become pixels at the goal's median depth."""

    spacing_along: float = 2.2e-3  # [m] between vertices along the goal
    spacing_across: float = 1.8e-3  # [m]
    margin_along: float = 14e-3  # [m] beyond both ends of the goal
    margin_across: float = 18e-3  # [m] to both sides of it
    beyond_grasp: float = 10e-3  # [m] around the grasp
    fit: FitConfig = field(default_factory=FitConfig)
    goal_band: float = 6e-3  # [m] around the goal in which its depth is measured
    min_measured: float = 0.5  # share of the vertices that saw depth
    max_residual: float = 0.5e-3  # [m] robust standard deviation of the depth's distance from the surface
    max_rejected: float = 0.3  # share of the depth that fits no smooth surface
    min_vertices: int = 60
    max_vertices: int = 4000
    max_depth_ratio: float = 3.0  # of the deepest vertex to the goal
    min_goal: float = 0.9  # share of the goal that has tissue on both sides
    support: float = 0.3  # share of the samples around a vertex that makes it a measured one
    max_slant: float = 80.0  # [deg] between a triangle's normal and the line of sight
    max_slanted: float = 0.02  # share of the triangles that may slant more, before the mesh counts as torn

    def __post_init__(self) -> None:
        lengths = (
            self.spacing_along,
            self.spacing_across,
            self.margin_along,
            self.margin_across,
            self.beyond_grasp,
            self.goal_band,
        )
        if not all(length > 0 for length in (*lengths, self.max_residual)):
            raise ValueError("the lengths of a surface's configuration must be positive")
        shares = (self.min_measured, self.max_rejected, self.min_goal, self.support, self.max_slanted)
        if not all(0.0 <= share <= 1.0 for share in shares):
            raise ValueError("the shares of a surface's configuration must lie between 0 and 1")


@dataclass(frozen=True)
class Surface:
    """The tissue around the goal at t_d as a lattice mesh that follows the goal, left camera frame.

    Nothing is said about what is connected. `vertices` (V, 3) float64 [m], seen at `pixels` (V, 2); `triangles` (F, 3) int32, wound
    so that normals face the camera; `station` (V,) [px] along the goal from its start, below 0 before it and above `goal_length`
    beyond it; `lateral` (V,) [px] across it, positive on the grasp's side and exactly 0 on the goal's line; `border` (V,) on the
    mesh's outer border; `measured` (V,) depth was seen there, not filled in; `goal_length` [px]; `stamp` [s] of the depth.
    """

    stamp: float
    vertices: Array
    triangles: NDArray[np.int32]
    pixels: Array
    station: Array
    lateral: Array
    border: NDArray[np.bool_]
    measured: NDArray[np.bool_]
    goal_length: float


@dataclass(frozen=True)
class SurfaceOutcome:
    """`surface` when `code` is OK, else None and `message` says what is wrong with the picture."""

    code: Code
    message: str
    surface: Surface | None = None


def reconstruct(
    depth: DepthMap,
    camera: CameraModel,
    tissue: Mask,
    tools: Mask,
    polyline: Array,
    grasp: Array,
    config: SurfaceConfig | None = None,
) -> SurfaceOutcome:
    """Reconstruct the surface around the goal `polyline` (M, 2) and the `grasp` (2,), both in pixels.

    `tissue` and `tools` (H, W) are the masks of the left picture that `depth` belongs to. A picture that shows too little is an
    outcome, DEPTH_INVALID or SURFACE_INVALID, never an exception.

    Raises:
        ValueError: an array is not of the shape said here, not finite, or the goal has no length.
    """
    config = config or SurfaceConfig()
    polyline, grasp = np.asarray(polyline, np.float64), np.asarray(grasp, np.float64)
    _check(depth, camera, tissue, tools, polyline, grasp)
    polyline = polyline[np.concatenate([[True], np.diff(arc_lengths(polyline)) > 1e-6])]
    usable = np.isfinite(depth.depth) & (depth.depth > 0) & tissue & ~tools
    disparity = np.where(usable, camera.focal * camera.baseline / np.where(usable, depth.depth, 1.0), np.nan)
    z = _goal_depth(depth.depth, usable, polyline, camera, config)
    if z is None:
        return SurfaceOutcome(Code.DEPTH_INVALID, "No depth is known around the goal; the surface cannot be reconstructed.")
    lattice = _lattice(polyline, grasp, camera.focal / z, config)
    if lattice is None:
        return _invalid(f"at the goal's depth, {z * 1e3:.0f} mm, it would need more than {config.max_vertices} vertices")
    covered = covered_by_tissue(tissue, tools)
    fit = fit_disparity(disparity, lattice.pixels, covered, config.fit)
    if fit is None:
        return SurfaceOutcome(Code.DEPTH_INVALID, "Too little depth is known around the goal to fit a surface.")
    return _judged(_surface(lattice, fit, z, covered, depth.stamp, camera, config), fit, z, camera, grasp, config)


def covered_by_tissue(tissue: Mask, tools: Mask) -> Mask:
    """Where tissue is (H, W), seen or hidden: within its outline, and under tools as far as its convex hull reaches."""
    outline = tissue_outline(tissue)
    hidden = tools & ~outline
    if hidden.any() and outline.any():
        borders, _ = cv2.findContours(outline.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
        hull = cv2.convexHull(np.concatenate(borders))
        filled = np.zeros(tissue.shape, np.uint8)
        cv2.fillConvexPoly(filled, hull, 1)
        outline = tissue_outline(outline | (hidden & (filled > 0)))
    return outline


def _goal_depth(depth: Array, usable: Mask, polyline: Array, camera: CameraModel, config: SurfaceConfig) -> float | None:
    """Median depth [m] of the tissue in a band around the goal; None if there is none."""
    if not usable.any():
        return None
    z = float(np.median(depth[usable]))
    band = np.zeros(depth.shape, np.uint8)
    width = max(3, round(2 * config.goal_band * camera.focal / z))
    points = np.rint(np.clip(polyline, -(2.0**14), 2.0**14)).astype(np.int32)
    cv2.polylines(band, [points[:, None]], False, 1, thickness=width)
    near = usable & (band > 0)
    return float(np.median(depth[near])) if near.any() else None


def _lattice(polyline: Array, grasp: Array, scale: float, config: SurfaceConfig) -> Lattice | None:
    """Lay the lattice at `scale` [px/m], large enough for the goal's margins and for the surroundings of the grasp.

    None when that takes too many vertices: the scale is wrong.
    """
    side = side_of(polyline, grasp)
    segments = np.stack([polyline[:-1], polyline[1:]], axis=1)
    away = float(distances(grasp[None], segments).min())
    ends = polyline[[0, -1]] - polyline[[1, -2]]
    ends = ends / np.maximum(np.linalg.norm(ends, axis=1, keepdims=True), 1e-12)
    # How far the grasp lies beyond either end of the goal, along its straight continuation.
    past = ((grasp - polyline[[0, -1]]) * ends).sum(1)
    reach = config.beyond_grasp * scale
    before, beyond = (max(config.margin_along * scale, float(p) + reach) for p in past)
    margin = config.margin_across * scale
    near = max(margin, away + reach)
    spacing = (config.spacing_along * scale, config.spacing_across * scale)
    size = (arc_lengths(polyline)[-1] + before + beyond, margin + near)
    if size[0] / spacing[0] * size[1] / spacing[1] > config.max_vertices:
        return None
    return lay(polyline, side, spacing, (before, beyond), (margin, near))


def _surface(
    lattice: Lattice, fit: DepthFit, z: float, covered: Mask, stamp: float, camera: CameraModel, config: SurfaceConfig
) -> Surface:
    """Put the lattice at its fitted depth, and keep the piece of it that lies on tissue and contains the goal."""
    rows, columns = fit.disparity.shape
    station, lateral = (q.ravel() for q in np.meshgrid(lattice.station, lattice.lateral))
    on_goal = (lateral == 0.0) & (station >= 0.0) & (station <= lattice.goal_length)
    seen = fit.support >= config.support
    triangles = lattice.triangles(covered)
    triangles = piece_with(on_goal, triangles[_known(seen).ravel()[triangles].all(axis=1)])
    kept = np.unique(triangles)
    number = np.full(rows * columns, -1, np.int32)
    number[kept] = np.arange(len(kept), dtype=np.int32)
    triangles = number[triangles]
    pixels = lattice.pixels.reshape(-1, 2)[kept]
    border = np.zeros(len(kept), bool)
    border[edges_of(triangles, 1)] = True
    fb = camera.focal * camera.baseline
    # A fit that runs away to infinity stays finite here, and is refused for its depth.
    vertices = camera.unproject(pixels, fb / np.maximum(fit.disparity.ravel()[kept], 0.01 * fb / z))
    return Surface(
        stamp, vertices, triangles, pixels, station[kept], lateral[kept], border, seen.ravel()[kept], lattice.goal_length
    )


def _known(seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which vertices (rows, columns) have a depth that can be believed: those seen, their neighbours, and those in between.

    Filling in between two seen vertices of a row or column is safe; going on past the last one is a guess.
    """
    between = np.zeros_like(seen)
    for axis in (0, 1):
        upward = np.logical_or.accumulate(seen, axis)
        downward = np.flip(np.logical_or.accumulate(np.flip(seen, axis), axis), axis)
        between |= upward & downward
    return between | (cv2.dilate(seen.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0)


def _judged(
    surface: Surface, fit: DepthFit, z: float, camera: CameraModel, grasp: Array, config: SurfaceConfig
) -> SurfaceOutcome:
    """Say what makes the surface useless, if anything does."""
    count = len(surface.vertices)
    if count < config.min_vertices:
        return _invalid(f"it has {count} vertices on tissue, {config.min_vertices} are needed")
    mesh = mesh_of(surface.vertices, surface.triangles)
    corners = surface.pixels[surface.triangles]
    folded = int((turn(corners) >= 0).sum())
    if folded or not mesh.is_winding_consistent:
        return _invalid(f"{folded} of its triangles fold over, because the goal bends too sharply")
    on_goal = (surface.lateral == 0.0) & (surface.station > -1e-6) & (surface.station < surface.goal_length + 1e-6)
    inner = edges_of(surface.triangles, 2)
    along = surface.station[inner[on_goal[inner].all(axis=1)]]
    share = float(np.abs(np.diff(along, axis=1)).sum()) / surface.goal_length
    if share < config.min_goal:
        return _invalid(f"only {share:.0%} of the goal has tissue on both sides, {config.min_goal:.0%} is needed")
    if not covers(corners, grasp):
        return _invalid("the grasp does not lie on it")
    measured = float(surface.measured.mean())
    if measured < config.min_measured:
        fault = f"Depth is known at {measured:.0%} of the surface around the goal, {config.min_measured:.0%} is needed."
        return SurfaceOutcome(Code.DEPTH_INVALID, fault)
    centres = surface.vertices[surface.triangles].mean(axis=1)
    facing = -(mesh.face_normals * centres).sum(axis=1) / np.linalg.norm(centres, axis=1)
    # From disparity to depth along the ray, and from there to the distance from a surface that is seen at a slant.
    residual = fit.residual * z * z / (camera.focal * camera.baseline) * float(np.median(facing))
    if residual > config.max_residual:
        figures = f"{residual * 1e3:.2f} mm, {config.max_residual * 1e3:.2f} mm is allowed"
        return _invalid(f"the depth scatters about it by {figures}")
    if fit.rejected > config.max_rejected:
        return _invalid(f"{fit.rejected:.0%} of the depth lies off it, {config.max_rejected:.0%} is allowed")
    deepest = float(surface.vertices[:, 2].max())
    if deepest > config.max_depth_ratio * z:
        return _invalid(f"it runs away to a depth of {deepest * 1e3:.0f} mm, while the goal lies at {z * 1e3:.0f} mm")
    slanted = float((facing < np.cos(np.deg2rad(config.max_slant))).mean())
    if slanted > config.max_slanted:
        return _invalid(f"{slanted:.0%} of its triangles are seen edge on; it runs through a step in depth")
    return SurfaceOutcome(Code.OK, f"Surface of {count} vertices, {measured:.0%} of them measured.", surface)


def _invalid(why: str) -> SurfaceOutcome:
    return SurfaceOutcome(Code.SURFACE_INVALID, f"The reconstructed surface cannot be used: {why}.")


def _check(depth: DepthMap, camera: CameraModel, tissue: Mask, tools: Mask, polyline: Array, grasp: Array) -> None:
    size = (camera.height, camera.width)
    for name, array in (("depth map", depth.depth), ("tissue mask", tissue), ("tool mask", tools)):
        if array.shape != size:
            raise ValueError(f"the {name} must have the camera's size {size}, not {array.shape}")
    if polyline.ndim != 2 or polyline.shape[1] != 2 or len(polyline) < 2 or not np.isfinite(polyline).all():
        raise ValueError(f"the goal must be at least two finite pixels (M, 2), not {polyline.shape}")
    if not arc_lengths(polyline)[-1] > 0:
        raise ValueError("the goal has no length")
    if grasp.shape != (2,) or not np.isfinite(grasp).all():
        raise ValueError(f"the grasp must be one finite pixel (2,), not {grasp}")
