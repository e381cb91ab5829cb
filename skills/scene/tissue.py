"""What in the picture is tissue and what is tool, from colour and brightness.

Tissue is warm (red above blue) and bright for its neighbourhood; an opening and the bed under it are dark; instruments are grey.
Ratios of colour channels do not change with vignette and light falloff, and brightness is compared with the surroundings, so
one set of thresholds serves skin-coloured silicone, pale chicken and red beef.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from hardware.interface import Image

Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class TissueConfig:
    """Thresholds of both masks. Brightness is the largest channel, 0..255; masks are made at half resolution."""

    min_warmth: float = 0.10  # (red - blue) / brightness of tissue
    max_tool_warmth: float = 0.07  # of metal, which is grey or bluish; between the two nothing is said
    max_tool_saturation: float = 0.30  # (largest - smallest channel) / brightness of metal
    min_brightness: float = 22.0  # below this colour says nothing
    min_relative: float = 0.42  # of the surroundings' brightness
    min_global: float = 0.45  # of the picture's 95th percentile
    surroundings: int = 61  # [px]
    highlight: float = 0.95  # of the picture's 95th percentile: tissue, whatever its colour, unless it belongs to a tool
    largest_hole: int = 60  # [px^2] specks smaller than this are filled
    smallest_piece: int = 2000  # [px^2] of tissue
    smallest_tool: int = 300  # [px^2]
    tool_margin: int = 5  # [px] added around tools
    glare: float = 230.0  # of the smallest channel, 0..255: the sensor is saturated, and nothing is seen of what lies below
    glare_margin: int = 6  # [px] added around it: a highlight is soft at its border, and moves over the tissue


def tissue_mask(image: Image, config: TissueConfig | None = None) -> Mask:
    """Where tissue is seen in `image` (H, W, 3) uint8 RGB: (H, W) bool. Tools, openings and the bed are left out."""
    config = config or TissueConfig()
    brightness, warmth, _ = _measures(image)
    level = np.percentile(brightness, 95)
    # Closing by the surroundings' size bridges an opening; blurred, it is the brightness that tissue here would have.
    side = max(3, config.surroundings // 4) | 1
    coarse = cv2.resize(brightness, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    local = cv2.blur(cv2.dilate(coarse, np.ones((side, side), np.uint8)), (side, side))
    local = np.asarray(cv2.resize(local, (brightness.shape[1], brightness.shape[0])))
    bright = (brightness > config.min_brightness) & (brightness > config.min_relative * np.minimum(local, level))
    warm = (warmth > config.min_warmth) | ((brightness > config.highlight * level) & (warmth > 0.0))
    mask = bright & (brightness > config.min_global * level) & warm
    cleaned = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    kept = _without_small(cleaned, config.smallest_piece // 4)
    filled = 1 - _without_small(1 - kept, config.largest_hole // 4)
    return _full_size(filled, image)


def tissue_outline(mask: Mask) -> Mask:
    """Fill every opening that tissue surrounds: the region (H, W) within the outer borders of the `mask` (H, W)."""
    borders, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    filled = np.zeros(mask.shape, np.uint8)
    cv2.drawContours(filled, borders, -1, 1, cv2.FILLED)
    return np.asarray(filled, dtype=bool)


def tool_mask(image: Image, config: TissueConfig | None = None) -> Mask:
    """Where instruments are seen in `image` (H, W, 3) uint8 RGB, with a margin: (H, W) bool. Small highlights are left out."""
    config = config or TissueConfig()
    brightness, warmth, saturation = _measures(image)
    grey = (warmth < config.max_tool_warmth) & (saturation < config.max_tool_saturation) & (brightness > config.min_brightness)
    cleaned = cv2.morphologyEx(grey.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    kept = _without_small(cleaned, config.smallest_tool // 4)
    reach = 2 * max(1, round(config.tool_margin / 2)) + 1
    grown = cv2.dilate(kept, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach)))
    return _full_size(np.asarray(grown), image)


def hidden_mask(image: Image, config: TissueConfig | None = None) -> Mask:
    """What hides the tissue in `image` (H, W, 3) uint8 RGB: instruments, and highlights that saturate the sensor, (H, W) bool."""
    config = config or TissueConfig()
    red, green, blue = cv2.split(np.ascontiguousarray(image))
    glare = (cv2.min(cv2.min(red, green), blue) >= config.glare).astype(np.uint8)
    tools = tool_mask(image, config)
    if not glare.any():
        return tools
    reach = 2 * config.glare_margin + 1
    return np.asarray(tools | (cv2.dilate(glare, cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))) > 0))


def _measures(image: Image) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Brightness, warmth and saturation at half resolution, smoothed so that noise has no colour."""
    half = cv2.resize(np.ascontiguousarray(image), None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    red, green, blue = cv2.split(cv2.blur(half, (3, 3)))
    largest = cv2.max(cv2.max(red, green), blue)
    smallest = cv2.min(cv2.min(red, green), blue)
    brightness = largest.astype(np.float32)
    floor = np.maximum(brightness, np.float32(1))
    warmth = (red.astype(np.float32) - blue.astype(np.float32)) / floor
    saturation = (brightness - smallest.astype(np.float32)) / floor
    return brightness, np.asarray(warmth, dtype=np.float32), np.asarray(saturation, dtype=np.float32)


def _without_small(mask: NDArray[Any], area: int) -> NDArray[np.uint8]:
    """Drop connected pieces of less than `area` pixels."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    keep = stats[:, cv2.CC_STAT_AREA] >= area
    keep[0] = False
    return np.asarray(keep[labels], dtype=np.uint8)


def _full_size(mask: NDArray[np.uint8], image: Image) -> Mask:
    return np.asarray(cv2.resize(mask, (image.shape[1], image.shape[0]), interpolation=cv2.INTER_NEAREST), dtype=bool)
