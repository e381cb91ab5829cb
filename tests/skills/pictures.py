"""Synthetic pictures with a known truth: speckle textures, warped by a known motion, planes seen by a stereo pair."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array, CameraModel, Frame, Image, StereoFrame

SIZE = (320, 240)  # (width, height)


def speckle(seed: int, size: tuple[int, int] = SIZE, contrast: float = 1.0) -> NDArray[np.float32]:
    """Make a grey texture (H, W) with detail at several scales, mean about 128."""
    rng = np.random.default_rng(seed)
    width, height = size
    total = np.zeros((height, width), np.float32)
    for scale, weight in ((2, 0.3), (4, 0.4), (12, 0.3)):
        coarse = rng.random((height // scale + 2, width // scale + 2)).astype(np.float32) - 0.5
        total += weight * cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    return 128 + contrast * 220 * total


def coloured(grey: NDArray[Any], noise: float = 0.0, seed: int = 0) -> Image:
    """Make a skin-coloured RGB picture of a grey texture, with noise [grey levels]."""
    rgb = grey[..., None] * np.array([1.15, 0.95, 0.8], np.float32)
    noisy = rgb + np.random.default_rng(seed).normal(0.0, noise, rgb.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8)


def opened(
    texture: NDArray[np.float32], gap: float, line: float, stretch: float = 0.0
) -> tuple[NDArray[np.float32], Callable[[Array], Array]]:
    """Open `texture` (H, W) along the row `line` by `gap` [px], upper side moved up, and stretch it along by `stretch`.

    Gives the picture, dark in the gap, and where points (N, 2) of the texture went.
    """
    height, width = texture.shape
    v, u = np.mgrid[0:height, 0:width].astype(np.float32)
    centre = width / 2
    source_u = centre + (u - centre) / (1 + stretch)
    upper = v < line - gap / 2
    source_v = np.where(upper, v + gap / 2, v - gap / 2).astype(np.float32)
    picture = np.asarray(
        cv2.remap(texture, source_u, source_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT), dtype=np.float32
    )
    picture[(v > line - gap / 2) & (v < line + gap / 2)] = 12.0

    def went(points: Array) -> Array:
        side = np.where(points[:, 1] < line, -gap / 2, gap / 2)
        return np.column_stack([centre + (points[:, 0] - centre) * (1 + stretch), points[:, 1] + side])

    return picture, went


def frame(image: Image, sequence: int) -> Frame:
    """Make a frame of bench time `sequence` / 30 s."""
    return Frame(sequence, sequence / 30.0, image)


def plane_pair(
    camera: CameraModel, normal: Array, distance: float, seed: int = 0, noise: float = 1.5
) -> tuple[StereoFrame, Array]:
    """Look at a textured plane through (0, 0, `distance`) [m] with `normal` (3,): the pair and the left depth (H, W) [m]."""
    texture = speckle(seed, (1600, 1600))
    n = normal / np.linalg.norm(normal)
    offset = float(n @ np.array([0.0, 0.0, distance]))
    v, u = np.mgrid[0 : camera.height, 0 : camera.width].astype(np.float64)
    rays = np.stack([(u - camera.cu) / camera.focal, (v - camera.cv) / camera.focal, np.ones_like(u)], axis=-1)
    images, depths = [], []
    for eye in (0.0, camera.baseline):
        depth = (offset - n[0] * eye) / (rays @ n)
        x, y = rays[..., 0] * depth + eye, rays[..., 1] * depth
        at_u, at_v = ((q / 1.2e-4 + 800).astype(np.float32) for q in (x, y))
        seen = cv2.remap(texture, at_u, at_v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        images.append(coloured(seen, noise, seed + round(eye * 1e6) + 1))
        depths.append(depth)
    return StereoFrame(frame(images[0], 1), images[1]), depths[0]
