"""The procedural textures: repeatable, seamless where tiled, and as rich or poor as the material they stand for."""

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from hardware.stub.textures import Material, Texture, bed_texture, inner_texture, metal_texture, sheet_texture

MM = 8.0  # texels per millimetre
SIZE = (400, 300)


def made(material: Material, seed: int = 0) -> Texture:
    return sheet_texture(material, SIZE, MM, np.random.default_rng(seed))


def richness(texture: Texture) -> float:
    """Mean strength of structures of one to three millimetres, which survive the camera's noise: what a tracker holds on to."""
    grey = cv2.cvtColor(texture[..., :3], cv2.COLOR_RGB2GRAY).astype(np.float32)
    band = cv2.GaussianBlur(grey, (0, 0), 0.12 * MM) - cv2.GaussianBlur(grey, (0, 0), 0.8 * MM)
    return float(band.std())


@pytest.mark.parametrize("material", list(Material))
def test_a_seed_gives_the_same_texture_again(material: Material) -> None:
    first, again, other = made(material, 3), made(material, 3), made(material, 4)

    assert first.shape == (300, 400, 4) and first.dtype == np.uint8
    assert first.tobytes() == again.tobytes()
    assert (first != other).mean() > 0.3


def test_chicken_skin_is_poor_and_beef_and_silicone_are_rich() -> None:
    silicone, chicken, beef = (richness(made(material)) for material in (Material.SILICONE, Material.CHICKEN, Material.BEEF))

    assert chicken > 0.5
    assert silicone > 2.5 * chicken
    assert beef > 2.5 * chicken


def test_beef_is_redder_than_the_pale_materials() -> None:
    red_excess = {m: np.subtract(*made(m)[..., :2].reshape(-1, 2).astype(float).mean(axis=0)) for m in Material}

    assert red_excess[Material.BEEF] > red_excess[Material.SILICONE] + 30
    assert red_excess[Material.BEEF] > red_excess[Material.CHICKEN] + 30


@pytest.mark.parametrize("material", list(Material))
def test_albedo_leaves_room_for_highlights(material: Material) -> None:
    colour = made(material)[..., :3]

    assert (colour > 245).mean() < 0.01


def inner(side: int, mm: float, rng: np.random.Generator) -> Texture:
    return inner_texture(Material.BEEF, side, mm, rng)


@pytest.mark.parametrize("tile", [inner, bed_texture])
def test_tiles_repeat_without_a_seam(tile: Callable[[int, float, np.random.Generator], Texture]) -> None:
    texture = tile(256, MM, np.random.default_rng(0)).astype(float)

    for axis in (0, 1):
        steps = np.abs(np.diff(texture, axis=axis, append=texture.take([0], axis=axis))).mean(axis=(1 - axis, 2))
        assert steps[-1] < 1.5 * np.percentile(steps[:-1], 99)


def test_the_coated_shaft_is_darker_and_duller_than_steel() -> None:
    texture = metal_texture(128, MM, np.random.default_rng(0)).astype(float)

    coated, steel = texture[:, 5:59].mean(axis=(0, 1)), texture[:, 69:123].mean(axis=(0, 1))
    assert (steel > 1.4 * coated).all()
