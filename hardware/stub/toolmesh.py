"""The instruments as triangle meshes: a shaft, a wrist, and two jaws that open; fenestrated forceps and slim Potts scissors.

Built in the tool frame (tip at the origin, z out of the tip, jaws open along x), so the shaft lies towards -z.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from hardware.codes import InputError
from hardware.stub.surface import ToolShape

Floats = NDArray[np.float32]

SHAFT_RADIUS = 2.5e-3  # [m]
SHAFT_LENGTH = 0.12  # [m], from the wrist backwards
WRIST_LENGTH = 9e-3  # [m]
BLADE_LENGTH = {"grasper": 12e-3, "scissors": 10e-3}  # [m], pivot to tip

# Texture coordinates [m] in the metal tile: dark coated shaft on the left half, bare steel on the right.
COATED, STEEL = 0.004, 0.024


@dataclass(frozen=True)
class ToolMesh:
    """A closed mesh: `positions`, `normals` (N, 3) float32, `triangles` (M, 3) int32 outward, `texture` (N, 2) float32 [m]."""

    positions: Floats
    normals: Floats
    triangles: NDArray[np.int32]
    texture: Floats


@dataclass(frozen=True)
class _Section:
    """Cross-section of a bar: at height `z`, centre (x, y), half widths (rx, ry) [m]; `square` 0 is an ellipse, 1 a rectangle."""

    z: float
    x: float
    y: float
    rx: float
    ry: float
    square: float = 0.0


def tool_mesh(shape: ToolShape) -> ToolMesh:
    """The instrument `shape` in the camera frame.

    Raises:
        InputError: the kind is unknown, or pose or jaw are not finite.
    """
    if shape.kind not in BLADE_LENGTH:
        raise InputError(f"tool kind is {shape.kind!r}; it must be one of {', '.join(BLADE_LENGTH)}")
    if not (shape.pose.is_finite() and np.isfinite(shape.jaw)):
        raise InputError(f"the pose or the jaw angle of the {shape.kind} is not finite")
    body, blades = _parts(shape.kind)
    positions: list[Floats] = [body.positions]
    normals: list[Floats] = [body.normals]
    for blade, side in zip(blades, (1.0, -1.0), strict=True):
        half = 0.5 * shape.jaw * side
        turn = np.array([[np.cos(half), 0, np.sin(half)], [0, 1, 0], [-np.sin(half), 0, np.cos(half)]], dtype=np.float32)
        pivot = np.array([0, 0, -BLADE_LENGTH[shape.kind]], dtype=np.float32)
        positions.append(np.asarray((blade.positions - pivot) @ turn.T + pivot, dtype=np.float32))
        normals.append(np.asarray(blade.normals @ turn.T, dtype=np.float32))
    rotation = shape.pose.rotation().astype(np.float32)
    triangles, texture = _joined(shape.kind)
    return ToolMesh(
        np.concatenate(positions) @ rotation.T + shape.pose.position.astype(np.float32),
        np.concatenate(normals) @ rotation.T,
        triangles,
        texture,
    )


@cache
def _joined(kind: str) -> tuple[NDArray[np.int32], Floats]:
    body, blades = _parts(kind)
    whole = _join([body, *blades])
    return whole.triangles, whole.texture


@cache
def _parts(kind: str) -> tuple[ToolMesh, tuple[ToolMesh, ToolMesh]]:
    """Shaft and wrist, and the two closed blades, in the tool frame."""
    length = BLADE_LENGTH[kind]
    r = SHAFT_RADIUS
    collar = -length - WRIST_LENGTH
    rings = np.linspace(collar - SHAFT_LENGTH, collar, 25)
    shaft = _bar([_Section(z, 0, 0, r, r) for z in rings], COATED, sides=24)
    wrist = _bar(
        [
            _Section(collar, 0, 0, r * 1.04, r * 1.04, 0.1),
            _Section(collar + 1.2e-3, 0, 0, r * 1.04, r * 1.04, 0.1),
            _Section(collar + 2.2e-3, 0, 0, r * 0.92, r * 0.92, 0.3),
            _Section(-length - 2.5e-3, 0, 0, r * 0.80, r * 0.94, 0.6),
            _Section(-length + 0.8e-3, 0, 0, r * 0.62, r * 0.90, 0.5),
            _Section(-length + 1.8e-3, 0, 0, r * 0.30, r * 0.80, 0.2),
        ],
        STEEL,
        sides=20,
    )
    # The pin on which the blades turn lies along y.
    pin = _turned(_bar([_Section(z, 0, 0, 0.8e-3, 0.8e-3) for z in (-r * 1.08, r * 1.08)], STEEL, sides=12), -length)
    blade = _grasper_blade(length) if kind == "grasper" else _scissor_blade(length)
    return _join([shaft, wrist, pin]), (blade, _opposite(blade))


def _grasper_blade(length: float) -> ToolMesh:
    """The +x jaw of fenestrated forceps: two rails around a window, joined by a blunt tip."""
    m = 1e-3
    root = [
        _Section(-length - 1.0 * m, 0.9 * m, 0, 0.8 * m, 1.5 * m, 0.5),
        _Section(-length + 2.6 * m, 0.9 * m, 0, 0.85 * m, 2.0 * m, 0.5),
        _Section(-length + 3.4 * m, 0.85 * m, 0, 0.8 * m, 2.0 * m, 0.5),
    ]
    tip = [
        _Section(-2.6 * m, 0.60 * m, 0, 0.58 * m, 1.75 * m, 0.5),
        _Section(-1.2 * m, 0.52 * m, 0, 0.50 * m, 1.55 * m, 0.4),
        _Section(-0.3 * m, 0.42 * m, 0, 0.40 * m, 1.0 * m, 0.2),
        _Section(0.0, 0.30 * m, 0, 0.20 * m, 0.45 * m, 0.0),
    ]
    rails = [
        _bar(
            [
                _Section(-length + 2.8 * m, 0.85 * m, side * 1.55 * m, 0.75 * m, 0.45 * m, 0.4),
                _Section(-2.2 * m, 0.60 * m, side * 1.35 * m, 0.55 * m, 0.40 * m, 0.4),
            ],
            STEEL,
            sides=12,
        )
        for side in (1.0, -1.0)
    ]
    return _join([_bar(root, STEEL, sides=16), _bar(tip, STEEL, sides=16), *rails])


def _scissor_blade(length: float) -> ToolMesh:
    """The +x blade of Potts scissors: slim, lying beside its counterpart (y > 0), tapering to a fine point."""
    m = 1e-3
    return _bar(
        [
            _Section(-length - 1.5 * m, 0.30 * m, 0.50 * m, 1.10 * m, 0.50 * m, 0.5),
            _Section(-length + 1.0 * m, 0.45 * m, 0.45 * m, 1.05 * m, 0.45 * m, 0.6),
            _Section(-length + 4.5 * m, 0.45 * m, 0.36 * m, 0.75 * m, 0.36 * m, 0.6),
            _Section(-2.5 * m, 0.25 * m, 0.26 * m, 0.42 * m, 0.26 * m, 0.5),
            _Section(-0.5 * m, 0.08 * m, 0.16 * m, 0.20 * m, 0.16 * m, 0.3),
            _Section(0.0, 0.0, 0.06 * m, 0.08 * m, 0.06 * m, 0.0),
        ],
        STEEL,
        sides=14,
    )


def _bar(sections: list[_Section], tone: float, sides: int) -> ToolMesh:
    """A closed bar through `sections` (z rising): smooth around, with flat caps."""
    angle = 2 * np.pi * np.arange(sides) / sides
    cos, sin = np.cos(angle), np.sin(angle)
    rings = []
    for s in sections:
        # Between ellipse and rectangle: the p-norm of the direction sets the radius, p = 2 round, p = 8 nearly square.
        p = 2.0 + 6.0 * s.square
        radius = (np.abs(cos) ** p + np.abs(sin) ** p) ** (-1.0 / p)
        rings.append(np.stack([s.x + s.rx * radius * cos, s.y + s.ry * radius * sin, np.full(sides, s.z)], axis=1))
    points = np.array(rings)
    around = np.roll(points, -1, axis=1) - np.roll(points, 1, axis=1)
    along = np.gradient(points, axis=0)
    normals = np.cross(around, along)
    normals /= np.maximum(np.linalg.norm(normals, axis=2, keepdims=True), 1e-15)

    count = len(sections)
    ring, k = np.meshgrid(np.arange(count - 1), np.arange(sides), indexing="ij")
    a, b = ring * sides + k, ring * sides + (k + 1) % sides
    c, d = a + sides, b + sides
    skin = np.concatenate([np.stack([a, b, c], axis=-1).reshape(-1, 3), np.stack([b, d, c], axis=-1).reshape(-1, 3)])
    first = count * sides
    fan = np.stack([np.zeros(sides - 2, int), np.arange(1, sides - 1), np.arange(2, sides)], axis=1)
    caps = [first + fan[:, ::-1], first + sides + fan]
    flat = np.repeat([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]], sides, axis=0)
    positions = np.concatenate([points.reshape(-1, 3), points[0], points[-1]])
    texture = np.stack([tone + 0.8 * positions[:, 0], positions[:, 2]], axis=1)
    return ToolMesh(
        positions.astype(np.float32),
        np.concatenate([normals.reshape(-1, 3), flat]).astype(np.float32),
        np.concatenate([skin, *caps]).astype(np.int32),
        texture.astype(np.float32),
    )


def _opposite(mesh: ToolMesh) -> ToolMesh:
    """The counterpart on the other side: half a turn about the shaft."""
    turn = np.array([-1, -1, 1], dtype=np.float32)
    return ToolMesh(mesh.positions * turn, mesh.normals * turn, mesh.triangles, mesh.texture)


def _turned(mesh: ToolMesh, z: float) -> ToolMesh:
    """A bar along z laid along y, at height `z`."""
    turn = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], dtype=np.float32)
    return ToolMesh(
        mesh.positions @ turn.T + np.array([0, 0, z], np.float32), mesh.normals @ turn.T, mesh.triangles, mesh.texture
    )


def _join(meshes: list[ToolMesh]) -> ToolMesh:
    """Several meshes as one."""
    first = np.cumsum([0, *(len(mesh.positions) for mesh in meshes)])
    return ToolMesh(
        np.concatenate([mesh.positions for mesh in meshes]),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate([mesh.triangles + n for mesh, n in zip(meshes, first, strict=False)]).astype(np.int32),
        np.concatenate([mesh.texture for mesh in meshes]),
    )
