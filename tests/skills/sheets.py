"""Small sheets of tissue for tests."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hardware.interface import Array
from skills.expose.model import ModelConfig, TissueModel, build_model
from skills.expose.xpbd import Rollout, State, XpbdConfig, XpbdSolver
from skills.scene.surface import Surface

DEPTH = 0.075  # [m] of every sheet before the camera
PIXEL = 1e-4  # [m] that a pixel sees there


def lattice(columns: int, rows: int, spacing: float) -> tuple[Array, NDArray[np.int32]]:
    """A flat sheet round (0, 0, DEPTH), rows along y, alternating diagonals, wound towards the camera: vertices, triangles."""
    x, y = np.meshgrid(np.arange(columns) - (columns - 1) / 2, np.arange(rows) - (rows - 1) / 2)
    vertices = np.stack([x.ravel() * spacing, y.ravel() * spacing, np.full(x.size, DEPTH)], axis=1)
    index = np.arange(x.size).reshape(rows, columns)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    falling = (np.add.outer(np.arange(rows - 1), np.arange(columns - 1)) % 2 == 0).ravel()[:, None]
    one = np.where(falling, np.stack([a, c, b], axis=1), np.stack([a, c, d], axis=1))
    two = np.where(falling, np.stack([b, c, d], axis=1), np.stack([a, d, b], axis=1))
    return vertices, np.concatenate([one, two]).astype(np.int32)


def strip(columns: int, rows: int, spacing: float) -> tuple[Array, NDArray[np.int32]]:
    """A flat strip along x of equilateral triangles; every second row is shifted by half a spacing."""
    x, y = np.meshgrid(np.arange(columns, dtype=float), np.arange(rows, dtype=float))
    x += 0.5 * (y % 2)
    vertices = np.stack([x.ravel() * spacing, y.ravel() * spacing * np.sqrt(0.75), np.full(x.size, DEPTH)], axis=1)
    index = np.arange(x.size).reshape(rows, columns)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, :-1], index[1:, 1:]))
    even = (np.arange(rows - 1) % 2 == 0).repeat(columns - 1)[:, None]
    one = np.where(even, np.stack([a, c, b], axis=1), np.stack([a, c, d], axis=1))
    two = np.where(even, np.stack([b, c, d], axis=1), np.stack([a, d, b], axis=1))
    return vertices, np.concatenate([one, two]).astype(np.int32)


def surface(size: int = 21, side: float = 50e-3, bump: float = 0.0, goal: float = 20e-3) -> Surface:
    """A square surface of size x size vertices with the goal along y in its middle, the grasp's side at x > 0; `size` is odd."""
    vertices, triangles = lattice(size, size, side / (size - 1))
    x, y = vertices[:, 0].copy(), vertices[:, 1].copy()
    vertices[:, 2] -= bump * np.exp(-(x**2 + y**2) / (2 * (side / 5) ** 2))
    border = np.maximum(abs(x), abs(y)) > side / 2 - 1e-9
    return Surface(
        stamp=0.0,
        vertices=vertices,
        triangles=triangles,
        pixels=np.stack([x, y], axis=1) / PIXEL + 320.0,
        station=(y + goal / 2) / PIXEL,
        lateral=np.where(abs(x) < 1e-9, 0.0, x / PIXEL),
        border=border,
        measured=np.ones(len(vertices), dtype=bool),
        goal_length=goal / PIXEL,
    )


def sheet_model(size: int = 21, config: ModelConfig | None = None, bump: float = 0.0) -> TissueModel:
    """The model of `surface`, grasped 8 mm from the goal's middle."""
    seen = surface(size, bump=bump)
    grasp = seen.vertices[np.argmin(np.hypot(seen.vertices[:, 0] - 8e-3, seen.vertices[:, 1]))]
    return build_model(seen, grasp, config or ModelConfig(grasp_radius=3e-3))


def pulls(samples: int, horizon: int, seed: int = 0) -> Array:
    """Control sequences (K, h, 3) of 0.5 mm steps away from the goal and up, each its own way."""
    draw = np.random.default_rng(seed).normal(size=(samples, 1, 3)) * 0.5 + np.array([1.0, 0.0, -0.5])
    draw = draw + np.random.default_rng(seed + 1).normal(size=(samples, horizon, 3)) * 0.2
    return np.asarray(0.5e-3 * draw / np.linalg.norm(draw, axis=2, keepdims=True))


def rolled(model: TissueModel, state: State, controls: Array, config: XpbdConfig | None = None) -> Rollout:
    """One rollout by a solver of its own."""
    return XpbdSolver(model, controls.shape[0], controls.shape[1], config).rollout(state, controls)


def settled(model: TissueModel, state: State, config: XpbdConfig, steps: int = 1) -> Rollout:
    """One sample held where it is for `steps` steps."""
    return rolled(model, state, np.zeros((1, steps, 3)), config)
