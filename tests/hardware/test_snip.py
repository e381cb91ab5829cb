"""A snip severs what its closing blades pass through, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from hardware.interface import Pose
from hardware.stub.phantom import Phantom
from hardware.stub.scene import Scene, load_scene
from hardware.stub.snip import ESCAPE, BladeSweep, bed_depth, severed

STEP = 1 / 120
OPEN = np.deg2rad(45)


@pytest.fixture
def scene() -> Scene:
    flat = load_scene("silicone")
    return replace(flat, tissue=replace(flat.tissue, puncture_variation=0.0), bed=replace(flat.bed, bump_height=0.0))


def above(scene: Scene, depth: float, x: float = 0.0) -> Pose:
    """Scissors pointing straight down, jaws opening along x, the closed tip `depth` below the sheet's mid-surface."""
    tip = np.array([x, 0.0, scene.tissue.thickness / 2 - depth])
    return Pose.looking(tip, np.array([0.0, 0.0, -1.0]), np.array([1.0, 0.0, 0.0]))


def cut_length(stretches) -> float:
    return sum(float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum()) for line, damage in stretches if damage >= 1.0)


def test_a_deep_snip_severs_a_stretch_along_the_jaws(scene):
    stretches = severed(Phantom(scene, 0, 4.5, STEP), BladeSweep(above(scene, 2.5e-3), OPEN, 0.0))

    between_the_blades = 2 * 7.5e-3 * np.tan(OPEN / 2)
    assert between_the_blades - 2 * ESCAPE - 0.8e-3 < cut_length(stretches) < between_the_blades
    line = stretches[0][0]
    assert np.abs(line[:, 1]).max() < 0.1e-3


def test_a_snip_above_the_tissue_severs_nothing(scene):
    assert severed(Phantom(scene, 0, 4.5, STEP), BladeSweep(above(scene, -1.5e-3), OPEN, 0.0)) == []


def test_a_shallow_snip_leaves_damage_but_no_cut(scene):
    stretches = severed(Phantom(scene, 0, 4.5, STEP), BladeSweep(above(scene, 0.2e-3), OPEN, 0.0))

    assert cut_length(stretches) == 0.0
    assert stretches and all(0.0 < damage < 1.0 for _, damage in stretches)


def test_deeper_snips_sever_no_less_of_the_thickness(scene):
    phantom = Phantom(scene, 0, 4.5, STEP)
    deepest = [
        max((damage for _, damage in severed(phantom, BladeSweep(above(scene, depth), OPEN, 0.0))), default=0.0)
        for depth in np.linspace(-1e-3, 2.5e-3, 15)
    ]

    assert (np.diff(deepest) >= -1e-9).all()
    assert deepest[0] == 0.0 and deepest[-1] == 1.0


def test_an_interrupted_closing_severs_only_what_was_swept(scene):
    phantom = Phantom(scene, 0, 4.5, STEP)
    full = severed(phantom, BladeSweep(above(scene, 2.5e-3), OPEN, 0.0))
    half = severed(phantom, BladeSweep(above(scene, 2.5e-3), OPEN, OPEN / 2))

    assert 0.0 < cut_length(half) < 0.75 * cut_length(full)
    assert len(half) == 2


def test_tough_unsupported_tissue_gives_way_before_the_blade(scene):
    def severed_depth(force: float) -> float:
        tissue = replace(scene.tissue, puncture_force=force)
        phantom = Phantom(replace(scene, tissue=tissue), 0, 4.5, STEP)
        lift = np.array([0.0, 0.0, 6e-3])
        grip = above(scene, 0.0, x=0.006)
        assert phantom.grasp(grip)
        for i in range(240):
            phantom.advance(grip.moved(lift * min(1.0, (i + 1) / 120)))
        at = int(np.argmin(np.linalg.norm(phantom.mesh.rest, axis=1)))
        pose = Pose.looking(phantom.positions[at] - [0, 0, 1.2e-3], np.array([0.0, 0.0, -1.0]), np.array([0.0, 1.0, 0.0]))
        return max((damage for _, damage in severed(phantom, BladeSweep(pose, OPEN, 0.0))), default=0.0)

    assert severed_depth(0.01) > severed_depth(0.2)


def test_snips_off_the_goal_cut_there(scene):
    pose = Pose.looking(np.array([0.01, 0.015, -1.5e-3]), np.array([0.0, 0.0, -1.0]), np.array([0.6, 0.8, 0.0]))
    stretches = severed(Phantom(scene, 0, 4.5, STEP), BladeSweep(pose, OPEN, 0.0))

    direction = stretches[0][0][-1] - stretches[0][0][0]
    assert abs(direction @ [0.8, -0.6]) < 0.1e-3
    assert np.linalg.norm(stretches[0][0].mean(axis=0) - [0.01, 0.015]) < 1e-3


def test_blades_in_the_bed_are_reported(scene):
    phantom = Phantom(scene, 0, 4.5, STEP)

    assert bed_depth(phantom, BladeSweep(above(scene, 3e-3), 0.0, 0.0)) == pytest.approx(2.25e-3, abs=1e-6)
    assert bed_depth(phantom, BladeSweep(above(scene, 0.0), 0.0, 0.0)) == 0.0
