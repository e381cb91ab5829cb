"""Tissue and tool masks on painted scenes: three tissues, a vignette, a bed, an opening, a tool, highlights."""

import cv2
import numpy as np
import pytest

from skills.scene.tissue import TissueConfig, hidden_mask, tissue_mask, tissue_outline, tool_mask

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


# What hides the tissue


def glaring(at: tuple[int, int] = (200, 330), radius: int = 9) -> tuple[np.ndarray, np.ndarray]:
    """The silicone scene with a highlight that saturates the sensor, and the distance [px] of each pixel from it."""
    image, _ = painted(COLOURS["silicone"])
    cv2.circle(image, at, radius, (255, 255, 255), -1)
    v, u = np.mgrid[0:480, 0:640]
    return image, np.hypot(u - at[0], v - at[1]) - radius


def plain(colour: tuple[int, int, int]) -> np.ndarray:
    """Tissue alone, with noise and with a highlight that does not saturate the sensor."""
    image = np.full((480, 640, 3), colour, np.float32)
    cv2.circle(image, (200, 330), 9, (236, 234, 226), -1)
    return np.clip(image + np.random.default_rng(2).normal(0, 2, image.shape), 0, 229).astype(np.uint8)


@pytest.mark.parametrize("tissue", COLOURS)
def test_an_ordinary_picture_hides_nothing(tissue: str) -> None:
    assert not hidden_mask(plain(COLOURS[tissue])).any()


@pytest.mark.parametrize("tissue", COLOURS)
def test_an_opening_and_the_bed_are_dark_and_not_hidden(tissue: str) -> None:
    image, parts = painted(COLOURS[tissue])
    assert not hidden_mask(image)[parts["opening"]].any()


@pytest.mark.parametrize("tissue", COLOURS)
def test_tools_hide_what_is_below_them(tissue: str) -> None:
    image, parts = painted(COLOURS[tissue])
    hidden = hidden_mask(image)
    assert hidden[parts["tool"]].mean() > 0.99
    assert (hidden >= tool_mask(image)).all()


def test_a_highlight_that_saturates_the_sensor_hides_the_tissue_with_a_margin() -> None:
    image, away = glaring()
    before, _ = painted(COLOURS["silicone"])
    margin, hidden = TissueConfig().glare_margin, hidden_mask(image)
    assert hidden[away < margin - 1].all()
    assert (hidden == hidden_mask(before))[away > margin + 1].all()
    assert not hidden_mask(before)[away <= margin + 1].any()


@pytest.mark.parametrize("margin", [4, 16, 30])
def test_the_margin_of_a_highlight_is_the_one_that_is_set(margin: int) -> None:
    image, away = glaring()
    hidden = hidden_mask(image, TissueConfig(glare_margin=margin))
    reach = away[hidden & (away < 60)].max()
    assert reach == pytest.approx(margin, abs=1.5)


def test_a_single_saturated_pixel_hides_its_surroundings() -> None:
    image = plain(COLOURS["chicken"])
    image[100, 500] = 255
    v, u = np.argwhere(hidden_mask(image, TissueConfig(glare_margin=9))).T
    assert (v.min(), v.max(), u.min(), u.max()) == (91, 109, 491, 509)


def test_what_is_bright_in_some_channels_only_is_no_glare() -> None:
    image = plain(COLOURS["silicone"])
    cv2.circle(image, (400, 240), 20, (255, 255, 210), -1)
    assert not hidden_mask(image)[220:260, 380:420].any()


def test_a_highlight_at_the_border_hides_only_what_is_in_the_picture() -> None:
    image, away = glaring((2, 470))
    hidden = hidden_mask(image)
    assert hidden.shape == image.shape[:2]
    assert hidden[away < TissueConfig().glare_margin - 1].all()


def test_the_picture_is_left_as_it_was() -> None:
    image, _ = glaring()
    before = image.copy()
    hidden_mask(image)
    assert np.array_equal(image, before)
