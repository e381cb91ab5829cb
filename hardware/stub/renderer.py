"""The stub's endoscope camera: a stereo rasteriser on the processor, without a display and without a GPU.

Textured sheet with cut walls and underside, dark bed in its openings, instruments that occlude, a lamp beside the lens with 1/r^2
falloff, highlights, vignette, lens blur and sensor noise; with each image come depth, labels and triangle numbers as drawn.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import warp as wp
from numpy.typing import NDArray

from hardware.codes import InputError
from hardware.interface import CameraModel, Image
from hardware.stub.renderkernels import Layer, Setup, View, project, rasterise, set_up, shade
from hardware.stub.rendermesh import Label, RenderMesh, TextureScale, topology_key
from hardware.stub.surface import BaseSurface, SheetSurface, ToolShape
from hardware.stub.textures import Material, bed_texture, inner_texture, metal_texture, sheet_texture
from hardware.stub.toolmesh import ToolMesh, tool_mesh

__all__ = ["Label", "Look", "Renderer", "Rendering"]

SHEET_TEXELS = 1024  # the sheet's longer side fills this many texels but for a margin; at 80 mm a texel is smaller than a pixel
SHEET_MARGIN = 4  # [texels] of tissue beyond the sheet's border, for interpolation
TILE_TEXELS = 512
TILE_LENGTH = 0.04  # [m] covered by one repeat of the tiled textures
LAMP = (0.0015, -0.005, 0.0)  # [m], left camera frame
WORKING_DISTANCE = 0.08  # [m], where `Look.light` = 1 gives a well exposed image
CELL = 8  # pixels per cell of the coarse depth that darkens cavities


@dataclass(frozen=True)
class Look:
    """How the scene looks to the camera."""

    material: Material | str = Material.SILICONE
    seed: int = 0
    size: tuple[float, float] = (0.08, 0.06)  # [m] sheet width and height in rest coordinates
    light: float = 1.0  # lamp intensity times exposure, relative
    noise: float = 1.6  # [grey levels] standard deviation of the sensor noise
    vignette: float = 0.4  # share of light lost in the image corners
    gloss: float = 1.0  # strength of the highlights, relative
    blur: float = 0.55  # [px] standard deviation of the lens blur

    def __post_init__(self) -> None:
        """Refuse what cannot be drawn."""
        if self.material not in list(Material):
            raise InputError(f"look.material is {self.material!r}; it must be one of {', '.join(Material)}")
        if isinstance(self.seed, bool) or not isinstance(self.seed, int) or self.seed < 0:
            raise InputError(f"look.seed is {self.seed!r}; it must be a whole number, 0 or greater")
        if len(self.size) != 2:
            raise InputError(f"look.size is {self.size!r}; it must be a width and a height [m]")
        _within("size[0]", self.size[0], 0.005, 0.5, " m")
        _within("size[1]", self.size[1], 0.005, 0.5, " m")
        _within("light", self.light, 0.01, 20.0)
        _within("noise", self.noise, 0.0, 20.0, " grey levels")
        _within("vignette", self.vignette, 0.0, 0.95)
        _within("gloss", self.gloss, 0.0, 5.0)
        _within("blur", self.blur, 0.0, 2.0, " px")


@dataclass(frozen=True)
class Rendering:
    """One eye's view: `image` (H, W, 3) uint8 RGB; `depth` (H, W) float32 [m], 0 where nothing is.

    `label` (H, W) uint8 of `Label`; `triangle` (H, W) int32 indexes `SheetSurface.triangles` on TOP and UNDERSIDE pixels and
    is -1 elsewhere.
    """

    image: Image
    depth: NDArray[np.float32]
    label: NDArray[np.uint8]
    triangle: NDArray[np.int32]


class Eye:
    """Buffers and constants of one camera. Only one thread at a time may render into an eye."""

    def __init__(self, camera: CameraModel, offset: float, illumination: NDArray[np.float32]) -> None:
        view = View()
        view.focal, view.cu, view.cv = camera.focal, camera.cu, camera.cv
        view.width, view.height, view.offset = camera.width, camera.height, offset
        view.light = wp.vec3(LAMP[0] - offset, LAMP[1], LAMP[2])
        self.view = view
        self.shape = (camera.height, camera.width)
        count = camera.width * camera.height
        self.keys = wp.zeros(count, dtype=wp.uint64, device="cpu")
        self.illumination: wp.array = wp.array(illumination.reshape(-1), dtype=float, device="cpu")
        self.screen = wp.empty(0, dtype=wp.vec3, device="cpu")
        self.setups = wp.empty(0, dtype=Setup, device="cpu")

    def fit(self, vertices: int, triangles: int) -> None:
        """Make room for a mesh of this size."""
        if len(self.screen) < vertices:
            self.screen = wp.empty(vertices, dtype=wp.vec3, device="cpu")
        if len(self.setups) < triangles:
            self.setups = wp.zeros(triangles, dtype=Setup, device="cpu")


class DeviceMesh:
    """A `RenderMesh` as the kernels see it; positions and normals share the mesh's memory, so an update needs no copy."""

    def __init__(self, mesh: RenderMesh) -> None:
        self.mesh = mesh
        self.vertices: wp.array = wp.array(mesh.positions, dtype=wp.vec3, device="cpu", copy=False)
        self.normals: wp.array = wp.array(mesh.normals, dtype=wp.vec3, device="cpu", copy=False)
        self.corners: wp.array = wp.array(mesh.corners, dtype=wp.vec3i, device="cpu", copy=False)
        self.texels: wp.array = wp.array(mesh.texels, dtype=wp.vec2, device="cpu", copy=False)
        self.labels: wp.array = wp.array(mesh.labels, dtype=wp.uint8, device="cpu", copy=False)


class Renderer:
    """Draws one sheet over one bed. Repeatable to the byte: an image depends on the look, the scene, `sequence` and `eye` alone.

    One renderer follows one sheet, whose `revision` must grow with each change of topology; its ligaments may tear
    without one. One thread at a time may use it.
    """

    def __init__(self, look: Look, camera: CameraModel, base: BaseSurface) -> None:
        wp.load_module("hardware.stub.renderkernels", device="cpu")  # here, so that two eyes never compile it at the same moment
        self.look, self.camera = look, camera
        self._base = base
        self._atlas, self._layers, self._scales = _atlas(look)
        illumination = _illumination(look, camera)
        self._eyes = (Eye(camera, 0.0, illumination), Eye(camera, camera.baseline, illumination))
        self._noise = _noise_tile(look, camera)
        self._second = ThreadPoolExecutor(max_workers=1, thread_name_prefix="right-eye")
        self._scene: DeviceMesh | None = None

    def render(self, sheet: SheetSurface, tools: Sequence[ToolShape], sequence: int, eye: int = 0) -> Rendering:
        """The view of one eye (0 left, 1 right) of `sheet` and `tools`; `sequence` picks the sensor noise.

        Raises:
            InputError: an unknown kind of tool, or a tool pose that is not finite.
            ValueError: a position of the sheet is not finite.
        """
        return self._view(self._placed(sheet, tools), sequence, eye)

    def render_pair(self, sheet: SheetSurface, tools: Sequence[ToolShape], sequence: int) -> tuple[Rendering, Rendering]:
        """Both views at once, the same as two `render` calls, on two threads: Warp frees the interpreter while a kernel runs."""
        scene = self._placed(sheet, tools)
        right = self._second.submit(self._view, scene, sequence, 1)
        left = self._view(scene, sequence, 0)
        return left, right.result()

    def _placed(self, sheet: SheetSurface, tools: Sequence[ToolShape]) -> DeviceMesh:
        """The mesh with everything where it is now; built anew only after a cut, a tear or a change of instruments."""
        if not np.isfinite(sheet.positions).all():
            raise ValueError("the sheet has vertices whose positions are not finite")
        meshes: list[ToolMesh] = [tool_mesh(tool) for tool in tools]
        if self._scene is None or self._scene.mesh.key != topology_key(sheet, meshes):
            self._scene = DeviceMesh(RenderMesh(sheet, self._base, meshes, *self._scales))
        self._scene.mesh.update(sheet, meshes)
        return self._scene

    def _view(self, scene: DeviceMesh, sequence: int, number: int) -> Rendering:
        eye = self._eyes[number]
        triangles = len(scene.corners)
        eye.fit(len(scene.vertices), triangles)
        wp.launch(project, len(scene.vertices), [eye.view, scene.vertices], [eye.screen], device="cpu")
        inputs = [scene.vertices, scene.normals, eye.screen, scene.corners, scene.texels, scene.labels]
        wp.launch(set_up, triangles, inputs, [eye.setups], device="cpu")
        eye.keys.zero_()
        self._find_visible(scene, eye)

        height, width = eye.shape
        image = np.empty((height, width, 3), np.uint8)
        depth = np.empty((height, width), np.float32)
        label = np.empty((height, width), np.uint8)
        triangle = np.empty((height, width), np.int32)
        surroundings = _surroundings(eye.keys.numpy().reshape(eye.shape), scene.mesh.labels)
        visible = [eye.view, eye.keys, eye.setups, scene.labels]
        light = [self._layers, self._atlas, _flat(surroundings), eye.illumination]
        sheet = [scene.mesh.first_top, scene.mesh.first_bottom, scene.mesh.sheet_triangles]
        colours: wp.array = wp.array(image.reshape(-1, 3), dtype=wp.vec3ub, device="cpu", copy=False)
        outputs = [colours, _flat(depth), _flat(label), _flat(triangle)]
        wp.launch(shade, height, [*visible, *light, *sheet], outputs, device="cpu")
        return Rendering(self._sensed(image, sequence, number), depth, label, triangle)

    def _find_visible(self, scene: DeviceMesh, eye: Eye) -> None:
        """Leave the key of the nearest triangle in each pixel of `eye.keys`."""
        count = len(scene.corners)
        wp.launch(rasterise, count, [eye.view, eye.screen, scene.corners, eye.setups, count - 1], [eye.keys], device="cpu")

    def _sensed(self, image: Image, sequence: int, eye: int) -> Image:
        """What the sensor makes of `image`: lens blur, then noise, a window of the noise tile drawn by sequence and eye."""
        if self.look.blur > 0:
            image = np.asarray(cv2.GaussianBlur(image, (3, 3), self.look.blur), dtype=np.uint8)
        if self.look.noise == 0:
            return image
        height, width = image.shape[:2]
        rng = np.random.default_rng((self.look.seed, sequence, eye))
        row = int(rng.integers(self._noise.shape[0] - height + 1))
        column = int(rng.integers(self._noise.shape[1] - width + 1))
        noise = self._noise[row : row + height, column : column + width]
        return np.asarray(cv2.add(image, noise, dtype=cv2.CV_8U), dtype=np.uint8)


_DTYPES = {np.dtype(np.uint8): wp.uint8, np.dtype(np.float32): wp.float32, np.dtype(np.int32): wp.int32}


def _flat(values: np.ndarray) -> wp.array:
    """The same memory as a one-dimensional Warp array."""
    return wp.array(values.reshape(-1), dtype=_DTYPES[values.dtype], device="cpu", copy=False)


def _within(name: str, value: float, low: float, high: float, unit: str = "") -> None:
    if not low <= value <= high:
        raise InputError(f"look.{name} is {value}{unit}; it must lie between {low:g} and {high:g}{unit}")


def _surroundings(keys: NDArray[np.uint64], labels: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Smoothed depth (H, W) [m] of tissue and bed around each pixel, without the tools; far away where there is none.

    Depth of the scene sampled in coarse cells and blurred at two scales: a pixel far below it lies in a cavity. On an even slope
    it equals the depth itself, so that open surfaces stay bright.
    """
    height, width = keys.shape
    cells = keys[CELL // 2 :: CELL, CELL // 2 :: CELL]
    inverse = (cells >> np.uint64(32)).astype(np.uint32).view(np.float32)
    number = (cells & np.uint64(0xFFFFFFFF)).astype(np.int64)
    seen = number > 0
    seen &= labels[np.maximum(number - 1, 0)] != Label.TOOL
    weight = seen.astype(np.float32)
    depth = np.where(seen, 1.0 / np.maximum(inverse, 1e-3), 0.0).astype(np.float32)
    smooth = np.zeros_like(depth)
    for sigma in (1.5, 5.0):
        share = cv2.GaussianBlur(weight, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
        total = cv2.GaussianBlur(depth, (0, 0), sigma, borderType=cv2.BORDER_REPLICATE)
        smooth += 0.5 * np.where(share > 1e-3, total / np.maximum(share, 1e-3), 1.0)
    return np.asarray(cv2.resize(smooth, (width, height), interpolation=cv2.INTER_LINEAR), dtype=np.float32)


def _illumination(look: Look, camera: CameraModel) -> NDArray[np.float32]:
    """Light (H, W) [m^2, to be divided by the squared distance] that reaches the sensor: lamp strength times vignette."""
    v, u = np.indices((camera.height, camera.width), dtype=np.float32)
    r2 = (u - camera.cu) ** 2 + (v - camera.cv) ** 2
    corner = max(camera.cu, camera.width - camera.cu) ** 2 + max(camera.cv, camera.height - camera.cv) ** 2
    return np.asarray(look.light * WORKING_DISTANCE**2 * (1 - look.vignette * r2 / corner), dtype=np.float32)


def _noise_tile(look: Look, camera: CameraModel) -> NDArray[np.int8]:
    """Noise [grey levels], larger than the image so that windows differ; even over all levels, as photons under a root."""
    rng = np.random.default_rng((look.seed, 1))
    tile = rng.normal(0.0, look.noise, (camera.height + 97, camera.width + 131, 3))
    return np.clip(np.round(tile), -127, 127).astype(np.int8)


def _atlas(look: Look) -> tuple[wp.array, wp.array, tuple[TextureScale, TextureScale]]:
    """All textures in one array of 64-bit texels, the `Layer` of each label, and the scales of sheet and tiles."""
    sheet, tile = _scales(look.size)
    texels, places = _painted(Material(look.material), look.seed, look.size)
    # Which texture each surface wears, and how it shines: sheen, glint, and how far light creeps around the terminator.
    surfaces = {
        Label.TOP: (0, 0.10, 0.9, 0.25),
        Label.UNDERSIDE: (1, 0.08, 0.6, 0.25),
        Label.WALL: (1, 0.05, 0.5, 0.25),
        Label.BASE: (2, 0.08, 0.7, 0.2),
        Label.TOOL: (3, 0.9, 2.2, 0.0),
        Label.SEAM: (1, 0.05, 0.5, 0.25),
    }
    layers = [Layer() for _ in Label]
    for label, (texture, sheen, glint, wrap) in surfaces.items():
        start, height, width = places[texture]
        layer = layers[label]
        layer.start, layer.stride, layer.mask_u, layer.mask_v = start, width, width - 1, height - 1
        layer.sheen, layer.glint = sheen * look.gloss, glint * look.gloss
        layer.lambert, layer.wrap = 1.0 / (1.0 + wrap), wrap / (1.0 + wrap)
    return wp.array(texels, dtype=wp.uint64, device="cpu", copy=False), wp.array(layers, dtype=Layer, device="cpu"), (sheet, tile)


def _scales(size: tuple[float, float]) -> tuple[TextureScale, TextureScale]:
    """Texel scales of the sheet's texture, whose origin is its middle, and of the tiles."""
    scale = (SHEET_TEXELS - 2 * SHEET_MARGIN) / max(size)
    middle = (0.5 * size[0] * scale + SHEET_MARGIN - 0.5, 0.5 * size[1] * scale + SHEET_MARGIN - 0.5)
    return TextureScale(scale, middle), TextureScale(TILE_TEXELS / TILE_LENGTH, (0.0, 0.0))


@lru_cache(maxsize=4)
def _painted(material: Material, seed: int, size: tuple[float, float]) -> tuple[NDArray[np.uint64], list[tuple[int, int, int]]]:
    """The textures of sheet, flesh, bed and metal as one array of texels, with (start, height, width) of each."""
    sheet, tile = _scales(size)
    used = [round(side * sheet.texels) + 2 * SHEET_MARGIN for side in size]
    rngs = [np.random.default_rng((seed, 2, part)) for part in range(4)]
    # Sides are powers of two, so that a mask wraps them; what the sheet leaves over stays black and is never seen.
    whole = [1 << (side - 1).bit_length() for side in used]
    top = np.zeros((whole[1], whole[0], 4), np.uint8)
    top[: used[1], : used[0]] = sheet_texture(material, (used[0], used[1]), sheet.texels * 1e-3, rngs[0])
    textures = [
        top,
        inner_texture(material, TILE_TEXELS, tile.texels * 1e-3, rngs[1]),
        bed_texture(TILE_TEXELS, tile.texels * 1e-3, rngs[2]),
        metal_texture(TILE_TEXELS, tile.texels * 1e-3, rngs[3]),
    ]
    starts = np.cumsum([0, *(texture.shape[0] * texture.shape[1] for texture in textures)])
    places = [(int(start), *texture.shape[:2]) for start, texture in zip(starts, textures, strict=False)]
    return np.concatenate([_texels(texture) for texture in textures]), places


def _texels(texture: NDArray[np.uint8]) -> NDArray[np.uint64]:
    """RGBA (H, W, 4) as (H * W,) 64-bit texels, one 8-bit channel in each 16-bit lane."""
    lanes = texture.reshape(-1, 4).astype(np.uint64)
    return lanes[:, 0] | lanes[:, 1] << np.uint64(16) | lanes[:, 2] << np.uint64(32) | lanes[:, 3] << np.uint64(48)
