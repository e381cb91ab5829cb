"""The smallest ONNX files that a test needs, written field by field (onnx.proto), so that no test needs the onnx package."""

from __future__ import annotations

from pathlib import Path

import numpy as np

FLOAT, INT64 = 1, 7


def field(number: int, value: int | str | bytes) -> bytes:
    """One field of a protocol buffer."""
    if isinstance(value, int):
        return _varint(number << 3) + _varint(value)
    data = value.encode() if isinstance(value, str) else value
    return _varint(number << 3 | 2) + _varint(len(data)) + data


def _varint(value: int) -> bytes:
    out = b""
    while value > 127:
        out, value = out + bytes([value & 127 | 128]), value >> 7
    return out + bytes([value])


def tensor(name: str, values: np.ndarray) -> bytes:
    kind = INT64 if values.dtype == np.int64 else FLOAT
    return b"".join(field(1, n) for n in values.shape) + field(2, kind) + field(8, name) + field(9, values.tobytes())


def value(name: str, shape: tuple[int | str, ...]) -> bytes:
    dims = b"".join(field(1, field(1 if isinstance(n, int) else 2, n)) for n in shape)
    return field(1, name) + field(2, field(1, field(1, FLOAT) + field(2, dims)))


def node(op: str, inputs: list[str], outputs: list[str], **integers: int) -> bytes:
    attributes = b"".join(field(5, field(1, name) + field(3, n) + field(20, 2)) for name, n in integers.items())
    return b"".join(field(1, i) for i in inputs) + b"".join(field(2, o) for o in outputs) + field(4, op) + attributes


def write(path: Path, nodes: list[bytes], tensors: list[bytes], inputs: list[bytes], outputs: list[bytes]) -> Path:
    graph = b"".join(field(1, n) for n in nodes) + field(2, "graph") + b"".join(field(5, t) for t in tensors)
    graph += b"".join(field(11, v) for v in inputs) + b"".join(field(12, v) for v in outputs)
    path.write_bytes(field(1, 8) + field(7, graph) + field(8, field(1, "") + field(2, 17)))
    return path


def flow_model(
    path: Path, shape: tuple[int | str, ...], shift: tuple[float, float], inputs: tuple[str, str] = ("image1", "image2")
) -> Path:
    """Write a network whose flow is `shift` everywhere: a convolution of image2 - image1 with weights 0 and bias `shift`."""
    weights = tensor("weights", np.zeros((2, 3, 1, 1), np.float32)), tensor("shift", np.array(shift, np.float32))
    nodes = [node("Sub", [inputs[1], inputs[0]], ["change"]), node("Conv", ["change", "weights", "shift"], ["flow"])]
    size = shape[-2:]
    return write(path, nodes, list(weights), [value(name, shape) for name in inputs], [value("flow", (1, 2, *size))])


def points_model(path: Path, shape: tuple[int | str, ...], count: int | str, shift: tuple[float, float]) -> Path:
    """Write a network whose points are queries + `shift`; visible and confidence are 0.75 for every point."""
    tensors = [
        tensor("shift", np.array(shift, np.float32)),
        tensor("zero", np.zeros(1, np.float32)),
        tensor("share", np.array([0.75], np.float32)),
        tensor("last", np.array([2], np.int64)),
    ]
    nodes = [
        # The frames have no say, but a runtime wants every input used.
        node("ReduceMean", ["frames"], ["mean"], keepdims=0),
        node("Mul", ["mean", "zero"], ["nothing"]),
        node("Add", ["queries", "nothing"], ["same"]),
        node("Add", ["same", "shift"], ["points"]),
        node("Mul", ["same", "zero"], ["zeros"]),
        node("ReduceSum", ["zeros", "last"], ["sums"], keepdims=0),
        node("Add", ["sums", "share"], ["visible"]),
        node("Add", ["sums", "share"], ["confidence"]),
    ]
    inputs = [value("frames", shape), value("queries", (1, count, 2))]
    return write(
        path,
        nodes,
        tensors,
        inputs,
        [value("points", (1, count, 2)), value("visible", (1, count)), value("confidence", (1, count))],
    )
