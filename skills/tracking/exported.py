"""Trackers from a file: any network for flow or for points that was exported to ONNX or with torch.export.

Signatures, by name in ONNX and in this order in torch.export; all float32, images RGB 0..255, batch 1 (docs/trackers.md):

    flow    image1 (1, 3, H, W), image2 (1, 3, H, W) -> flow (1, 2, H, W) [px], how far each pixel of image1 went, (u, v)
    points  frames (1, 2, 3, H, W), queries (1, N, 2) [px] in the first frame
            -> points (1, N, 2) [px] in the second, visible (1, N), confidence (1, N), both 0..1

H, W and N may be fixed: smaller pictures are padded and larger ones resized, and points go in batches of N.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from hardware.codes import InputError
from hardware.interface import Array, Image
from skills.tracking.flow import Field
from skills.tracking.hidden import Mask
from skills.tracking.onnx_header import Shape, declared
from skills.tracking.padding import padded
from skills.tracking.picture import Picture

Floats = NDArray[np.float32]

FLOW = ("image1", "image2")
POINTS = ("frames", "queries")
FLOW_OUT = ("flow",)
POINTS_OUT = ("points", "visible", "confidence")
SUFFIXES = (".onnx", ".pt2")


@dataclass(frozen=True)
class Exported:
    """A network from a file: its two inputs' shapes, whether it gives flow or points, and how it is run."""

    shapes: tuple[Shape, Shape]
    gives_flow: bool
    run: Callable[[Floats, Floats], list[Floats]]


def load_exported(path: Path, device: str) -> Exported:
    """Load a `.onnx` file (by onnxruntime if it is installed, else by OpenCV) or a `.pt2` file (by torch, on `device`).

    Raises:
        InputError: the file is missing, cannot be read, or has another signature.
    """
    if not path.is_file():
        raise InputError(f"there is no model {path}")
    return _load_onnx(path) if path.suffix == ".onnx" else _load_torch(path, device)


class FlowExported:
    """The flow of an exported network, on pictures in colour."""

    def __init__(self, network: Exported) -> None:
        self._network = network

    def sees(self, picture: Picture) -> NDArray[np.uint8]:
        """Colour."""
        return picture.image

    def flow(self, old: NDArray[np.uint8], new: NDArray[np.uint8]) -> Field:
        """The network's flow, at the pictures' own size."""
        height, width = old.shape[:2]
        size = _fixed(self._network.shapes[0])
        scale = _scale((height, width), size)
        a, (top, left) = padded(_resized(old, scale), size)
        b, _ = padded(_resized(new, scale), size)
        (flow,) = self._network.run(_planes(a)[None], _planes(b)[None])
        rows, columns = round(height * scale), round(width * scale)
        inner = np.ascontiguousarray(flow[0, :, top : top + rows, left : left + columns].transpose(1, 2, 0))
        return inner if scale == 1.0 else np.asarray(cv2.resize(inner, (width, height)) / np.float32(scale))

    def near(self, old: NDArray[np.uint8], new: NDArray[np.uint8]) -> Field:
        """The same network's."""
        return self.flow(old, new)

    def check(self, old: NDArray[np.uint8], new: NDArray[np.uint8]) -> Field:
        """The same network's."""
        return self.flow(old, new)


class ModelExported:
    """A `PointModel` that asks an exported network where the points of the frame before are now."""

    def __init__(self, network: Exported) -> None:
        self._network = network

    def start(self, image: Image, points: Array) -> None:
        """Remember where the points are."""
        self._before, self._points = image, points

    def update(self, image: Image) -> tuple[Array, Mask, Array]:
        """Follow the points from the frame before."""
        size = _fixed(self._network.shapes[0])
        scale = _scale(image.shape[:2], size)
        a, (top, left) = padded(_resized(self._before, scale), size)
        b, _ = padded(_resized(image, scale), size)
        # Pixel centres are whole numbers, so a picture that shrinks does so around half a pixel off its corner.
        offset = np.array([left, top]) + (scale - 1.0) / 2.0
        queries = (self._points * scale + offset).astype(np.float32)
        frames = np.stack([_planes(a), _planes(b)])[None]
        points, visible, confidence = self._in_batches(frames, queries)
        self._before, self._points = image, (points.astype(np.float64) - offset) / scale
        return self._points.copy(), visible > 0.5, confidence.astype(np.float64)

    def _in_batches(self, frames: Floats, queries: Floats) -> tuple[Floats, Floats, Floats]:
        """Run the network on as many queries (N, 2) at once as it takes."""
        count, length = len(queries), self._network.shapes[1][1]
        length = length or count
        parts = []
        for first in range(0, count, length):
            batch = queries[first : first + length]
            # The last batch is filled up with its last point.
            filled = np.concatenate([batch, np.repeat(batch[-1:], length - len(batch), axis=0)])
            parts.append([out[0, : len(batch)] for out in self._network.run(frames, filled[None])])
        points, visible, confidence = (np.concatenate(pieces) for pieces in zip(*parts, strict=True))
        return points, visible, confidence


def _load_onnx(path: Path) -> Exported:
    inputs, outputs = declared(path)
    gives_flow = _signature(path, inputs, outputs)
    names, wanted = (FLOW, FLOW_OUT) if gives_flow else (POINTS, POINTS_OUT)
    shapes = inputs[names[0]], inputs[names[1]]
    _check_shapes(path, shapes, gives_flow)
    if find_spec("onnxruntime") is not None:
        import onnxruntime

        session = onnxruntime.InferenceSession(str(path), providers=onnxruntime.get_available_providers())
        return Exported(shapes, gives_flow, lambda a, b: session.run(list(wanted), {names[0]: a, names[1]: b}))
    try:
        net = cv2.dnn.readNetFromONNX(str(path))
    except cv2.error as error:
        raise InputError(f"OpenCV cannot run {path}: install onnxruntime (pip install onnxruntime) to run it") from error

    def run(a: Floats, b: Floats) -> list[Floats]:
        net.setInput(a, names[0])
        net.setInput(b, names[1])
        return [np.array(out) for out in net.forward(list(wanted))]

    return Exported(shapes, gives_flow, run)


def _signature(path: Path, inputs: dict[str, Shape], outputs: list[str]) -> bool:
    """Whether the network gives flow (True) or points (False)."""
    for names, wanted, gives_flow in ((FLOW, FLOW_OUT, True), (POINTS, POINTS_OUT, False)):
        if set(inputs) == set(names) and set(wanted) <= set(outputs):
            return gives_flow
    raise InputError(
        f"{path} takes {_listed(inputs)} and gives {_listed(outputs)}; a tracker takes image1 and image2 and gives flow, "
        "or takes frames and queries and gives points, visible and confidence"
    )


def _load_torch(path: Path, device: str) -> Exported:
    import torch

    try:
        program = torch.export.load(path)
    except Exception as error:  # whatever is wrong with the file, torch has an exception of its own for it
        raise InputError(f"{path} is not a file that torch.export.save wrote with this or an older torch") from error
    user = set(program.graph_signature.user_inputs)
    values = [node.meta["val"] for node in program.graph.nodes if node.op == "placeholder" and node.name in user]
    if len(values) != 2:
        raise InputError(f"{path} takes {len(values)} inputs; a tracker takes two images, or frames and queries")
    shapes = (
        tuple(int(n) if isinstance(n, int) else None for n in values[0].shape),
        tuple(int(n) if isinstance(n, int) else None for n in values[1].shape),
    )
    gives_flow = len(shapes[0]) == 4
    _check_shapes(path, shapes, gives_flow)
    outputs = len(program.graph_signature.user_outputs)
    if outputs != (1 if gives_flow else 3):
        raise InputError(
            f"{path} gives {outputs} outputs; a flow network gives flow, one for points gives points, visible, confidence"
        )
    network = program.module().to(device)

    def run(a: Floats, b: Floats) -> list[Floats]:
        with torch.no_grad():
            out = network(torch.from_numpy(a).to(device), torch.from_numpy(b).to(device))
        return [part.float().cpu().numpy() for part in (out if isinstance(out, tuple | list) else (out,))]

    return Exported(shapes, gives_flow, run)


def _check_shapes(path: Path, shapes: tuple[Shape, Shape], gives_flow: bool) -> None:
    wanted: tuple[Shape, Shape] = (
        ((1, 3, None, None), (1, 3, None, None)) if gives_flow else ((1, 2, 3, None, None), (1, None, 2))
    )
    for shape, right in zip(shapes, wanted, strict=True):
        fits = len(shape) == len(right) and all(n is None or m is None or n == m for n, m in zip(shape, right, strict=True))
        if not fits:
            raise InputError(f"{path} takes an input of shape {_shape_text(shape)}, not {_shape_text(right)}")
    height, width = shapes[0][-2:]
    if (height is None) != (width is None):
        raise InputError(f"{path} fixes either the height or the width of its pictures; it must fix both or neither")


def _fixed(shape: Shape) -> tuple[int, int] | None:
    height, width = shape[-2:]
    return None if height is None or width is None else (height, width)


def _scale(size: tuple[int, ...], fixed: tuple[int, int] | None) -> float:
    """By how much a picture of `size` (height, width) must shrink to fit."""
    return 1.0 if fixed is None else min(1.0, fixed[0] / size[0], fixed[1] / size[1])


def _resized(image: NDArray[np.uint8], scale: float) -> NDArray[np.uint8]:
    if scale == 1.0:
        return image
    size = round(image.shape[1] * scale), round(image.shape[0] * scale)
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _planes(image: NDArray[np.uint8]) -> Floats:
    return np.ascontiguousarray(image.transpose(2, 0, 1), dtype=np.float32)


def _listed(names: dict[str, Shape] | list[str]) -> str:
    return ", ".join(names) or "nothing"


def _shape_text(shape: Shape) -> str:
    return "(" + ", ".join("any" if n is None else str(n) for n in shape) + ")"
