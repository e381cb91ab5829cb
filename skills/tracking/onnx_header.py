"""What an ONNX file declares as its inputs and outputs, read from the file itself: OpenCV runs such files, but does not say.

ONNX is a protocol buffer; only the few fields on the way to the names and shapes are looked at (onnx.proto: ModelProto.graph = 7,
GraphProto.initializer = 5, input = 11, output = 12).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from hardware.codes import InputError

Shape = tuple[int | None, ...]  # None: any length

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5  # wire types


def declared(path: Path) -> tuple[dict[str, Shape], list[str]]:
    """Inputs by name with their shapes, and the names of the outputs.

    Raises:
        InputError: the file is missing, or no ONNX model.
    """
    try:
        data = memoryview(path.read_bytes())
    except OSError as error:
        raise InputError(f"the model {path} cannot be read: {error.strerror}") from error
    try:
        graph = _only(data, 7)
        weights = {bytes(_only(tensor, 8)).decode() for tensor in _all(graph, 5)}
        inputs = {_name(value): _shape(value) for value in _all(graph, 11)}
        outputs = [_name(value) for value in _all(graph, 12)]
    except (IndexError, ValueError) as error:
        raise InputError(f"{path} is not an ONNX model") from error
    return {name: shape for name, shape in inputs.items() if name not in weights}, outputs


def _name(value: memoryview) -> str:
    return bytes(_only(value, 1)).decode()


def _shape(value: memoryview) -> Shape:
    """ValueInfoProto.type (2) . tensor_type (1) . shape (2) . dim (1) . dim_value (1)."""
    tensor = _only(_only(value, 2), 1)
    shape = _all(tensor, 2)
    return tuple(_length(dim) for dim in _all(shape[0], 1)) if shape else ()


def _length(dim: memoryview) -> int | None:
    numbers = [value for number, value in _fields(dim) if number == 1 and isinstance(value, int)]
    return numbers[0] if numbers and numbers[0] > 0 else None


def _only(message: memoryview, number: int) -> memoryview:
    return _all(message, number)[0]


def _all(message: memoryview, number: int) -> list[memoryview]:
    return [value for at, value in _fields(message) if at == number and isinstance(value, memoryview)]


def _fields(message: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    """Each field's number with its value: a number, or bytes."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        wire = key & 7
        if wire == VARINT:
            value, at = _varint(message, at)
            yield key >> 3, value
            continue
        if wire == BYTES:
            length, at = _varint(message, at)
        elif wire in (FIXED32, FIXED64):
            length = 4 if wire == FIXED32 else 8
        else:
            raise ValueError("not a protocol buffer")
        if at + length > len(message):
            raise ValueError("cut short")
        yield key >> 3, message[at : at + length]
        at += length


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    value, shift = 0, 0
    while True:
        byte = message[at]
        value |= (byte & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if byte < 0x80:
            return value, at
        if shift > 63:
            raise ValueError("not a protocol buffer")
