"""Depth from a rectified stereo pair by semi-global matching, and what is read from it: depth at pixels, surface normals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array, CameraModel, StereoFrame

Region = tuple[int, int, int, int]  # u0, v0, u1, v1 [px], the last column and row excluded


@dataclass(frozen=True)
class StereoConfig:
    """Settings of the matcher. The searched disparities follow from the working distance and the camera."""

    nearest: float = 0.045  # [m] of the working distance
    farthest: float = 0.130  # [m]
    block: int = 9  # [px] matching window
    left_right_difference: int = 1  # [px] allowed between the two directions of matching
    uniqueness: int = 5  # [%] by which the best match must beat the second
    speckle_size: int = 100  # [px] islands of disparity smaller than this are dropped
    speckle_range: int = 2  # [px] within one island
    prefilter_cap: int = 31
    refine_window: int = 25  # [px] of the sub-pixel refinement; 0 leaves the matcher's own
    refine_steps: int = 3
    min_contrast: float = 0.7  # [grey levels] standard deviation over a window; flatter ground matches anything
    contrast_window: int = 21  # [px]


@dataclass(frozen=True)
class DepthMap:
    """`depth` (H, W) float64 z-depth [m] of the left image, nan where unknown or outside the region asked for.

    `valid_fraction` is the share of the region's pixels that have a depth; `stamp` [s] that of the pair.
    """

    stamp: float
    depth: Array
    valid_fraction: float


def region_around(points: Array, margin: float, image_size: tuple[int, int]) -> Region:
    """Give the box of `points` (N, 2) pixels with `margin` [px] on each side, clipped to `image_size` (width, height)."""
    low, high = np.floor(points.min(axis=0) - margin), np.ceil(points.max(axis=0) + margin) + 1
    width, height = image_size
    u0, v0 = int(np.clip(low[0], 0, width - 1)), int(np.clip(low[1], 0, height - 1))
    return u0, v0, int(np.clip(high[0], u0 + 1, width)), int(np.clip(high[1], v0 + 1, height))


def disparity_range(camera: CameraModel, config: StereoConfig) -> tuple[int, int]:
    """Least disparity [px] and number of disparities (a multiple of 16) that span the working distance: d = f B / Z."""
    fb = camera.focal * camera.baseline
    least = int(np.floor(fb / config.farthest))
    most = int(np.ceil(fb / config.nearest))
    return least, 16 * max(1, int(np.ceil((most - least + 1) / 16)))


def depth_from_stereo(
    stereo: StereoFrame, camera: CameraModel, config: StereoConfig | None = None, region: Region | None = None
) -> DepthMap:
    """Depth of the left image, within `region` only if given (the cost follows the region's size).

    Raises:
        ValueError: the images are not of the camera's size.
    """
    config = config or StereoConfig()
    left, right = stereo.left.image, stereo.right
    if left.shape != right.shape or left.shape[:2] != (camera.height, camera.width):
        raise ValueError("both images of a stereo pair must have the camera's size")
    u0, v0, u1, v1 = region or (0, 0, camera.width, camera.height)
    least, number = disparity_range(camera, config)
    # A left pixel u matches right pixels down to u - least - number, so the crop reaches that much further left.
    pad = 2 * config.block
    c0, c1 = max(0, u0 - least - number - pad), min(camera.width, u1 + pad)
    r0, r1 = max(0, v0 - pad), min(camera.height, v1 + pad)
    gray = [cv2.cvtColor(np.ascontiguousarray(image[r0:r1, c0:c1]), cv2.COLOR_RGB2GRAY) for image in (left, right)]
    # Without columns to the left of the image's own border, nothing there could be matched at all.
    border = least + number if c0 == 0 else 0
    if border:
        gray = [cv2.copyMakeBorder(g, 0, 0, border, 0, cv2.BORDER_CONSTANT, value=0) for g in gray]
    matcher = cv2.StereoSGBM.create(
        minDisparity=least,
        numDisparities=number,
        blockSize=config.block,
        P1=8 * config.block**2,
        P2=32 * config.block**2,
        disp12MaxDiff=config.left_right_difference,
        preFilterCap=config.prefilter_cap,
        uniquenessRatio=config.uniqueness,
        speckleWindowSize=config.speckle_size,
        speckleRange=config.speckle_range,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    disparity = matcher.compute(*gray)[:, border:].astype(np.float64) / 16.0
    if config.refine_window:
        disparity = _refined(gray[0][:, border:], gray[1][:, border:], disparity, least, config)
    disparity = np.where(_contrast(gray[0][:, border:], config) >= config.min_contrast, disparity, 0.0)
    disparity = disparity[v0 - r0 : v1 - r0, u0 - c0 : u1 - c0]
    seen_by_both = np.arange(u0, u1)[None, :] - disparity >= 0
    valid = (disparity >= max(least, 1)) & seen_by_both
    depth = np.full((camera.height, camera.width), np.nan)
    depth[v0:v1, u0:u1] = np.where(valid, camera.focal * camera.baseline / np.where(valid, disparity, 1.0), np.nan)
    return DepthMap(stereo.left.stamp, depth, float(valid.mean()))


def _refined(left: NDArray[Any], right: NDArray[Any], disparity: Array, least: int, config: StereoConfig) -> Array:
    """Refine `disparity` (H, W) [px] below the matcher's sub-pixel step; values under `least` are invalid and stay.

    The matcher's parabola is drawn to whole pixels ("pixel locking"), about 0.13 px here, which is 0.3 mm and tilts every normal.
    A few Gauss-Newton steps on the brightness difference over a window (Lucas and Kanade, along the epipolar line) remove that.
    """
    window = (config.refine_window, config.refine_window)
    valid = disparity >= least
    share = np.maximum(cv2.blur(valid.astype(np.float32), window), 1e-6)
    d = np.where(valid, disparity, 0.0).astype(np.float32)
    d = np.where(valid, cv2.blur(d, window) / share, least).astype(np.float32)
    # Smoothing must not cross a depth edge: where it moved the value much, the matcher's own stays, unrefined.
    steady = valid & (np.abs(d - disparity) < 0.75)
    a, b = left.astype(np.float32), right.astype(np.float32)
    slope = cv2.Sobel(b, cv2.CV_32F, 1, 0, ksize=3, scale=1 / 8)
    grid = np.indices(disparity.shape, dtype=np.float32)
    v, u = grid[0], grid[1]
    for _ in range(config.refine_steps):
        warped = cv2.remap(b, u - d, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        g = cv2.remap(slope, u - d, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        e = warped - a
        e -= cv2.blur(e, window)
        step = cv2.blur(e * g, window) / (cv2.blur(g * g, window) + 1.0)
        d += np.clip(step, -0.5, 0.5)
    return np.where(steady & (np.abs(d - disparity) < 1.0), d, disparity).astype(np.float64)


def _contrast(gray: NDArray[Any], config: StereoConfig) -> Array:
    """Give the standard deviation (H, W) of `gray` (H, W) over a window around each pixel [grey levels]."""
    window = (config.contrast_window, config.contrast_window)
    g = gray.astype(np.float32) - np.float32(128.0)
    variance = cv2.blur(g * g, window) - cv2.blur(g, window) ** 2
    return np.sqrt(np.maximum(np.asarray(variance, dtype=np.float64), 0.0))


def depth_at(depth_map: DepthMap, pixels: Array, radius: int = 4, min_valid: float = 0.25) -> Array:
    """Median depth (N,) [m] in a square of `radius` [px] around each of `pixels` (N, 2).

    nan where less than the share `min_valid` of the square has a depth, or the pixel is not finite or outside the image.
    """
    height, width = depth_map.depth.shape
    padded = np.pad(depth_map.depth, radius, constant_values=np.nan)
    finite: NDArray[np.bool_] = np.asarray(np.isfinite(pixels).all(axis=1))
    nearest = np.rint(np.where(finite[:, None], pixels, -1.0)).astype(np.int64)
    inside: NDArray[np.bool_] = np.asarray(
        finite & (nearest >= 0).all(axis=1) & (nearest[:, 0] < width) & (nearest[:, 1] < height)
    )
    side = np.arange(2 * radius + 1)
    result = np.full(len(pixels), np.nan)
    u, v = nearest[inside, 0], nearest[inside, 1]
    windows = padded[v[:, None, None] + side[None, :, None], u[:, None, None] + side[None, None, :]].reshape(
        len(u), len(side) ** 2
    )
    enough: NDArray[np.bool_] = np.asarray(np.isfinite(windows).mean(axis=1) >= min_valid)
    values = np.full(len(u), np.nan)
    if enough.any():
        values[enough] = np.nanmedian(windows[enough], axis=1)
    result[inside] = values
    return result


def surface_normal_at(depth_map: DepthMap, camera: CameraModel, pixel: Array, radius: int = 16, min_valid: float = 0.25) -> Array:
    """Fit the unit normal (3,) of the surface around `pixel` (2,), facing the camera; nan if too little depth is known there.

    A plane m . X = 1 reads 1 / Z = m . ray, linear in 1 / Z, where the matcher's noise is even; Tukey weights drop what lies on
    another surface (a lip, a tool).
    """
    unknown = np.full(3, np.nan)
    if not np.isfinite(pixel).all():
        return unknown
    height, width = depth_map.depth.shape
    u, v = round(float(pixel[0])), round(float(pixel[1]))
    u0, u1, v0, v1 = max(0, u - radius), min(width, u + radius + 1), max(0, v - radius), min(height, v + radius + 1)
    if u0 >= u1 or v0 >= v1:
        return unknown
    z = depth_map.depth[v0:v1, u0:u1]
    known = np.isfinite(z)
    if known.sum() < max(12, min_valid * (2 * radius + 1) ** 2):
        return unknown
    vs, us = np.nonzero(known)
    rays = np.column_stack([(us + u0 - camera.cu) / camera.focal, (vs + v0 - camera.cv) / camera.focal, np.ones(len(us))])
    inverse = 1.0 / z[known]
    spread = np.abs(inverse - np.median(inverse))
    weights: Array = np.asarray(spread <= 4 * np.median(spread) + 0.1, dtype=np.float64)
    m: Array = np.zeros(3)
    for _ in range(6):
        m = np.asarray(np.linalg.lstsq(rays * weights[:, None], inverse * weights, rcond=None)[0], dtype=np.float64)
        residual = inverse - rays @ m
        scale = 4.7 * max(1.4826 * float(np.median(np.abs(residual))), 1e-3)
        weights = np.asarray(np.clip(1.0 - (residual / scale) ** 2, 0.0, None))
    length = float(np.linalg.norm(m))
    return -m / length if length > 1e-9 else unknown
