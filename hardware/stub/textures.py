"""Procedural textures of the stub's tissues and instruments: 8-bit RGBA in display values, alpha holds the gloss.

Every texture is a pure function of its arguments. Sizes in texels; `mm` is the number of texels per millimetre, so
that structures keep their size whatever the resolution.
"""

from collections.abc import Callable
from enum import StrEnum

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Texture = NDArray[np.uint8]


class Material(StrEnum):
    """What the sheet is made of: printed elastomer (well trackable), chicken skin (poor texture), beef (rich texture)."""

    SILICONE = "silicone"
    CHICKEN = "chicken"
    BEEF = "beef"


def sheet_texture(material: Material, size: tuple[int, int], mm: float, rng: np.random.Generator) -> Texture:
    """The outer face of the sheet, (height, width, 4) uint8 for `size` (width, height)."""
    return _SHEETS[material]((size[1], size[0]), mm, rng)


def inner_texture(material: Material, side: int, mm: float, rng: np.random.Generator) -> Texture:
    """Cut faces and underside, a tile (side, side, 4) uint8 that repeats without a seam."""
    shape = (side, side)
    dark, light, wet = {
        Material.SILICONE: ((168, 92, 84), (212, 142, 126), 0.35),
        Material.CHICKEN: ((176, 108, 98), (226, 176, 160), 0.8),
        Material.BEEF: ((118, 24, 26), (182, 62, 54), 0.9),
    }[material]
    mix = 0.5 + 0.28 * _noise(shape, 0.5 * mm, rng, tile=True) + 0.22 * _noise(shape, 2.5 * mm, rng, tile=True)
    colour = _blend(dark, light, mix)
    return _pack(colour, wet * (0.6 + 0.25 * _noise(shape, 0.6 * mm, rng, tile=True)))


def bed_texture(side: int, mm: float, rng: np.random.Generator) -> Texture:
    """The moist dark bed under the tissue, a tile that repeats without a seam."""
    shape = (side, side)
    large, fine = _noise(shape, 5 * mm, rng, tile=True), _noise(shape, 1.1 * mm, rng, tile=True)
    colour = _blend((58, 12, 16), (106, 30, 31), 0.5 + 0.26 * large + 0.10 * fine)
    return _pack(colour, 0.5 + 0.25 * _noise(shape, 0.9 * mm, rng, tile=True) + 0.15 * large)


def metal_texture(side: int, mm: float, rng: np.random.Generator) -> Texture:
    """Instruments, a tile: dark coated shaft on the left half, brushed steel on the right. Rows run along the shaft."""
    shape = (side, side)
    brushed = _stretched_noise(shape, (0.12 * mm, 3.0 * mm), rng)
    coated = np.full((*shape, 3), (62, 65, 72), np.float32) * (1 + 0.05 * brushed[..., None])
    steel = np.full((*shape, 3), (118, 121, 126), np.float32) * (1 + 0.05 * brushed[..., None])
    left = np.arange(side)[None, :, None] < side // 2
    gloss = np.where(left[..., 0], 0.35, 0.9) * (1 + 0.15 * brushed)
    return _pack(np.where(left, coated, steel), gloss)


def _silicone(shape: tuple[int, int], mm: float, rng: np.random.Generator) -> Texture:
    """Skin-coloured elastomer with a printed pattern: speckles, dots, and two generations of vessel lines."""
    colour = _blend(
        (206, 158, 134), (226, 184, 160), 0.5 + 0.35 * _noise(shape, 6 * mm, rng) + 0.2 * _noise(shape, 1.2 * mm, rng)
    )
    speckle = np.clip(_noise(shape, 0.28 * mm, rng) - 0.9, 0, 1.2)
    colour *= 1 - 0.30 * speckle[..., None]
    blue = _vessels(shape, mm, rng, trunks=max(3, shape[1] // int(20 * mm)), width=0.75 * mm)
    red = _vessels(shape, mm, rng, trunks=max(5, shape[1] // int(9 * mm)), width=0.55 * mm)
    colour = _over(colour, (112, 92, 128), 0.55 * blue)
    colour = _over(colour, (158, 48, 48), 0.78 * red)
    colour = _over(colour, (126, 58, 46), 0.8 * _dots(shape, rng, per_area=0.10 * mm**-2, radius=(0.16 * mm, 0.34 * mm)))
    gloss = 0.42 + 0.16 * _noise(shape, 0.5 * mm, rng) + 0.10 * _noise(shape, 3 * mm, rng)
    return _pack(colour, gloss)


def _chicken(shape: tuple[int, int], mm: float, rng: np.random.Generator) -> Texture:
    """Pale skin, poor in texture: soft mottling, fat shining through, and faint follicles in uneven rows."""
    mottle = 0.5 + 0.24 * _noise(shape, 9 * mm, rng) + 0.12 * _noise(shape, 2.2 * mm, rng)
    colour = _blend((206, 156, 136), (232, 194, 166), mottle)
    fat = np.clip(_noise(shape, 7 * mm, rng) - 0.5, 0, 1)
    colour = _over(colour, (232, 206, 142), 0.45 * fat)
    creases = np.exp(-((_noise(shape, 1.6 * mm, rng) / 0.10) ** 2))
    colour *= 1 - 0.030 * creases[..., None]
    bumps = cv2.GaussianBlur(_dots(shape, rng, per_area=0.045 * mm**-2, radius=(0.22 * mm, 0.38 * mm)), (0, 0), 0.22 * mm)
    colour *= 1 - 0.16 * bumps[..., None] * np.array([0.5, 1.0, 1.0], dtype=np.float32)
    veins = cv2.GaussianBlur(_vessels(shape, mm, rng, trunks=2, width=0.6 * mm), (0, 0), 0.35 * mm)
    colour = _over(colour, (176, 112, 118), 0.30 * veins)
    gloss = 0.62 + 0.22 * _noise(shape, 0.45 * mm, rng) + 0.15 * _noise(shape, 2.5 * mm, rng) - 0.2 * bumps
    return _pack(colour, gloss)


def _beef(shape: tuple[int, int], mm: float, rng: np.random.Generator) -> Texture:
    """Red muscle: fibres in bundles that wander, fat marbling, a few vessels, and a moist film."""
    bend = 1.6 * mm * _noise(shape, 11 * mm, rng)
    fibres = _warped(_stretched_noise(shape, (14 * mm, 0.22 * mm), rng), bend)
    bundles = _warped(_stretched_noise(shape, (22 * mm, 1.1 * mm), rng), bend)
    mix = 0.46 + 0.17 * fibres + 0.17 * bundles + 0.14 * _noise(shape, 5 * mm, rng) + 0.05 * _noise(shape, 0.25 * mm, rng)
    colour = _blend((112, 22, 26), (196, 78, 68), mix)
    # Marbling follows the seams between bundles: narrow zero crossings of a stretched field, thick where fat is plenty.
    plenty = np.clip(0.55 + 0.55 * _noise(shape, 8 * mm, rng), 0, 1.6)
    seam = _warped(_stretched_noise(shape, (7 * mm, 2.4 * mm), rng), bend)
    fat = np.exp(-((seam / (0.17 * plenty + 0.01)) ** 2)) * np.clip(plenty, 0, 1)
    flecks = _warped(_stretched_noise(shape, (4.5 * mm, 0.9 * mm), rng), bend)
    fat = np.maximum(fat, np.clip(1.4 * (flecks - 1.5), 0, 1))
    fat *= np.clip(0.82 + 0.22 * _noise(shape, 0.4 * mm, rng), 0, 1)
    colour = _over(colour, (232, 202, 176), 0.74 * fat)
    vessels = _vessels(shape, mm, rng, trunks=max(3, shape[1] // int(18 * mm)), width=0.7 * mm)
    colour = _over(colour, (84, 10, 22), 0.62 * vessels)
    gloss = 0.60 + 0.22 * fibres + 0.15 * _noise(shape, 0.5 * mm, rng) + 0.15 * fat
    return _pack(colour, gloss)


_SHEETS: dict[Material, Callable[[tuple[int, int], float, np.random.Generator], Texture]] = {
    Material.SILICONE: _silicone,
    Material.CHICKEN: _chicken,
    Material.BEEF: _beef,
}


def _noise(shape: tuple[int, int], scale: float, rng: np.random.Generator, tile: bool = False) -> Floats:
    """Smooth noise (H, W) with zero mean and unit deviation, and features of about `scale` texels."""
    return _stretched_noise(shape, (scale, scale), rng, tile)


def _stretched_noise(shape: tuple[int, int], scale: tuple[float, float], rng: np.random.Generator, tile: bool = False) -> Floats:
    """As `_noise`, with features `scale` (along u, along v) texels long; with `tile` the borders fit each other."""
    height, width = shape
    rows, columns = max(3, round(height / max(scale[1], 1.0))), max(3, round(width / max(scale[0], 1.0)))
    coarse = rng.standard_normal((rows, columns)).astype(np.float32)
    pad = 3
    coarse = np.pad(coarse, pad, mode="wrap" if tile else "symmetric")
    full = (round((columns + 2 * pad) * width / columns), round((rows + 2 * pad) * height / rows))
    fine = cv2.resize(coarse, full, interpolation=cv2.INTER_CUBIC)
    u, v = round(pad * width / columns), round(pad * height / rows)
    fine = fine[v : v + height, u : u + width]
    return (fine - fine.mean()) / max(float(fine.std()), 1e-6)


def _warped(field: Floats, shift: Floats) -> Floats:
    """`field` with each texel fetched `shift` texels further down."""
    v, u = np.mgrid[: field.shape[0], : field.shape[1]].astype(np.float32)
    moved = cv2.remap(field, np.asarray(u), np.asarray(v + shift), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    return np.asarray(moved, dtype=np.float32)


def _vessels(shape: tuple[int, int], mm: float, rng: np.random.Generator, trunks: int, width: float) -> Floats:
    """Coverage (H, W) 0 to 1 of branching lines that thin out from `width` texels."""
    height, length = shape
    # One layer for each width class, blurred once: to blur each branch by itself would take ten times as long.
    layers: dict[int, Texture] = {}
    step = 1.2 * mm
    open_ends = []
    for _ in range(trunks):
        side = rng.integers(4)
        along = rng.uniform(0, 1)
        start = [(0, along), (1, along), (along, 0), (along, 1)][side]
        heading = [0.0, np.pi, np.pi / 2, -np.pi / 2][side] + rng.normal(0, 0.5)
        open_ends.append((np.array([start[0] * length, start[1] * height]), heading, width * rng.uniform(0.7, 1.0), 0))
    while open_ends:
        point, heading, thick, order = open_ends.pop()
        curl = rng.normal(0, 0.04)
        for _ in range(int(rng.uniform(14, 44) / (1 + 0.6 * order))):
            heading += curl + rng.normal(0, 0.16)
            end = point + step * np.array([np.cos(heading), np.sin(heading)])
            layer = layers.setdefault(max(1, round(thick)), np.zeros(shape, np.uint8))
            ends = [tuple(int(x) for x in np.round(q * 16)) for q in (point, end)]
            cv2.line(layer, ends[0], ends[1], 255, max(1, round(thick)), cv2.LINE_AA, 4)
            point, thick = end, thick * 0.985
            if order < 3 and thick > 0.16 * width and rng.random() < 0.13:
                turn = rng.choice([-1, 1]) * rng.uniform(0.4, 1.0)
                open_ends.append((point.copy(), heading + turn, thick * rng.uniform(0.5, 0.75), order + 1))
            if not (-step < point[0] < length + step and -step < point[1] < height + step):
                break
    cover = np.zeros(shape, np.float32)
    for thick, layer in layers.items():
        # Fine branches are also fainter: they run deeper.
        strength = min(1.0, 0.45 + 0.55 * thick / max(width, 1.0))
        cover = np.maximum(cover, cv2.GaussianBlur(layer, (0, 0), 0.6 + 0.12 * thick).astype(np.float32) * (strength / 255))
    return cover


def _dots(shape: tuple[int, int], rng: np.random.Generator, per_area: float, radius: tuple[float, float]) -> Floats:
    """Coverage (H, W) 0 to 1 of round dots, `per_area` of them per square texel, on a jittered hexagonal lattice."""
    layer = np.zeros(shape, np.uint8)
    pitch = 1.0 / np.sqrt(max(per_area, 1e-9))
    for row, v in enumerate(np.arange(0.5 * pitch, shape[0], pitch)):
        for u in np.arange((0.25 + 0.5 * (row % 2)) * pitch, shape[1], pitch):
            centre = np.array([u, v]) + rng.normal(0, 0.22 * pitch, 2)
            cv2.circle(
                layer, tuple(int(x) for x in np.round(centre * 16)), int(rng.uniform(*radius) * 16), 255, -1, cv2.LINE_AA, 4
            )
    return (layer / 255).astype(np.float32)


def _blend(dark: tuple[int, int, int], light: tuple[int, int, int], mix: Floats) -> Floats:
    """Colours (H, W, 3) from `dark` to `light` by `mix` (H, W), which is clipped to [-0.3, 1.3]."""
    a, b = np.array(dark, dtype=np.float32), np.array(light, dtype=np.float32)
    return (a + np.clip(mix, -0.3, 1.3)[..., None] * (b - a)).astype(np.float32)


def _over(colour: Floats, paint: tuple[int, int, int], cover: Floats) -> Floats:
    """`paint` laid over `colour` (H, W, 3) with `cover` (H, W)."""
    return colour + cover[..., None] * (np.array(paint, dtype=np.float32) - colour)


def _pack(colour: Floats, gloss: Floats) -> Texture:
    """Colour (H, W, 3) 0 to 255 and gloss (H, W) 0.2 to 1 as RGBA: even a dry spot shines a little."""
    return np.clip(np.dstack([colour, 255 * np.clip(gloss, 0.2, 1.0)]) + 0.5, 0, 255).astype(np.uint8)
