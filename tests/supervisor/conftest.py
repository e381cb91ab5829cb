"""A scene small enough that a whole session takes seconds."""

from pathlib import Path

import pytest

SMALL = """
description = "A small silicone sheet with a 14 mm goal."

[tissue]
width = 0.056
height = 0.050
fine_spacing = 1.0e-3
coarse_spacing = 3.0e-3
puncture_variation = 0.2

[goal]
line = [[-0.007, 0.0], [0.007, 0.0]]
grasp = [0.0, 0.008]
"""


@pytest.fixture
def small_scene(tmp_path: Path) -> Path:
    path = tmp_path / "small.toml"
    path.write_text(SMALL)
    return path
