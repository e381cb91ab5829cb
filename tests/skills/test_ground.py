"""How high the jaws are over the surface that was seen."""

from __future__ import annotations

import numpy as np
import pytest

from skills.expose.ground import Ground
from tests.skills.sheets import DEPTH, surface

UP = np.array([0.0, 0.0, -1.0])  # towards the camera


@pytest.mark.parametrize("height", [-1e-3, 0.0, 2e-3])
def test_over_a_flat_surface_it_is_the_distance_towards_the_camera(height):
    points = np.array([[[0.0, 0.0, DEPTH], [3.1e-3, -7.7e-3, DEPTH]]]) + height * UP

    assert Ground(surface()).height(points) == pytest.approx(np.full((1, 2), height), abs=1e-9)


@pytest.mark.parametrize("height", [-0.5e-3, 0.0, 1e-3])
@pytest.mark.parametrize("x", [0.0, 6e-3, 11e-3])
def test_over_a_dome_it_follows_the_slope_between_the_vertices(x, height):
    bump, width = 3e-3, 10e-3
    rise = bump * np.exp(-(x**2) / (2 * width**2))
    slope = -x / width**2 * rise
    normal = np.array([-slope, 0.0, -1.0]) / np.hypot(slope, 1.0)
    on_it = np.array([x, 0.0, DEPTH - rise])

    assert Ground(surface(21, bump=bump)).height(on_it + height * normal) == pytest.approx(height, abs=0.1e-3)
