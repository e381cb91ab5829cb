"""Tissue and tool masks on painted scenes: three tissues, a vignette, a bed, an opening, a tool, a highlight."""

import cv2
import numpy as np
import pytest

from skills.scene.tissue import tissue_mask, tissue_outline, tool_mask

COLOURS = {"silicone": (185, 156, 128), "chicken": (176, 150, 132), "beef": (150, 62, 52)}


def painted(colour: tuple[int, int, int]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Paint a scene and give it and the true masks of its parts."""
    height, width = 480, 640
    image = np.zeros((height, width, 3), np.float32)
    image[:] = (52, 16, 14)
    parts = {name: np.zeros((height, width), np.uint8) for name in ("sheet", "opening", "tool", "highlight")}
    cv2.fillPoly(parts["sheet"], [np.array([[60, 80], [580, 80], [620, 440], [20, 440]])], 1)
    cv2.ellipse(parts["opening"], (300, 260), (120, 18), 0, 0, 360, 1, -1)
    cv2.line(parts["tool"], (639, 0), (420, 180), 1, 34)
    cv2.circle(parts["highlight"], (200, 380), 9, 1, -1)
    masks = {name: part.astype(bool) for name, part in parts.items()}
    image[masks["sheet"]] = colour
    image[masks["opening"]] = (48, 18, 15)
    image[masks["highlight"]] = (236, 234, 230)
    image[masks["tool"]] = (96, 99, 106)
    v, u = np.mgrid[0:height, 0:width]
    vignette = 1.0 - 0.35 * ((u - 320) ** 2 + (v - 240) ** 2) / (320**2 + 240**2)
    noisy = image * vignette[..., None] + np.random.default_rng(1).normal(0, 2, image.shape)
    return np.clip(noisy, 0, 255).astype(np.uint8), masks


@pytest.mark.parametrize("tissue", COLOURS)
def test_tissue_is_found_and_bed_opening_and_tool_are_left_out(tissue: str) -> None:
    image, parts = painted(COLOURS[tissue])
    mask = tissue_mask(image)
    visible = parts["sheet"] & ~parts["opening"] & ~parts["tool"]
    assert mask[visible].mean() > 0.97
    assert mask[~parts["sheet"]].mean() < 0.03
    assert mask[parts["opening"]].mean() < 0.15  # its rim is blurred
    assert mask[parts["tool"]].mean() < 0.08


@pytest.mark.parametrize("tissue", COLOURS)
def test_tools_are_found_whole_and_highlights_are_not_tools(tissue: str) -> None:
    image, parts = painted(COLOURS[tissue])
    mask = tool_mask(image)
    assert mask[parts["tool"]].mean() > 0.99
    assert not mask[parts["highlight"]].any()
    far = cv2.dilate(parts["tool"].astype(np.uint8), np.ones((25, 25))) == 0
    assert not mask[far].any()


def test_the_outline_fills_the_opening_but_not_the_surroundings() -> None:
    image, parts = painted(COLOURS["silicone"])
    outline = tissue_outline(tissue_mask(image))
    assert outline[parts["opening"]].all()
    assert outline[~parts["sheet"] & ~parts["tool"]].mean() < 0.02


def test_a_black_picture_holds_neither() -> None:
    black = np.zeros((480, 640, 3), np.uint8)
    assert not tissue_mask(black).any()
    assert not tool_mask(black).any()
