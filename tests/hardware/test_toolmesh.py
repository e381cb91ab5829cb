"""The instruments' meshes: where the tip is, how the jaws open, and that each body is closed."""

import numpy as np
import pytest

from hardware.interface import Pose
from hardware.stub.surface import ToolShape
from hardware.stub.toolmesh import BLADE_LENGTH, SHAFT_RADIUS, ToolMesh, tool_mesh

HOME = Pose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
KINDS = ["grasper", "scissors"]


def made(kind: str, jaw: float, pose: Pose = HOME) -> ToolMesh:
    return tool_mesh(ToolShape(kind, pose, jaw))


@pytest.mark.parametrize("kind", KINDS)
def test_closed_blades_meet_at_the_origin(kind: str) -> None:
    points = made(kind, 0.0).positions

    assert points[:, 2].max() == pytest.approx(0.0, abs=1e-6)
    tip = points[points[:, 2] > -1e-4]
    assert np.abs(tip[:, :2]).max() < 0.7e-3
    assert tip[:, 0].min() < 0 < tip[:, 0].max()


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("jaw", [0.4, 1.0])
def test_the_jaws_open_along_x_by_the_full_angle(kind: str, jaw: float) -> None:
    points = made(kind, jaw).positions

    reach = BLADE_LENGTH[kind] * np.sin(jaw / 2)
    blades = points[points[:, 2] > -0.3 * BLADE_LENGTH[kind]]
    assert blades[:, 0].max() == pytest.approx(reach, abs=1.0e-3)
    assert blades[:, 0].min() == pytest.approx(-reach, abs=1.0e-3)


@pytest.mark.parametrize("kind", KINDS)
def test_the_shaft_lies_behind_the_tip(kind: str) -> None:
    points = made(kind, 0.0).positions

    shaft = points[points[:, 2] < -0.03]
    assert shaft[:, 2].min() < -0.12
    np.testing.assert_allclose(np.hypot(shaft[:, 0], shaft[:, 1]), SHAFT_RADIUS, rtol=1e-4)


@pytest.mark.parametrize("kind", KINDS)
def test_triangles_face_outwards(kind: str) -> None:
    mesh = made(kind, 0.5)

    a, b, c = (mesh.positions[mesh.triangles[:, k]].astype(float) for k in range(3))
    face = np.cross(b - a, c - a)
    lit = mesh.normals[mesh.triangles].mean(axis=1)
    assert (np.einsum("ij,ij->i", face, lit) >= -1e-12).all()
    # Closed bodies with outward faces enclose a positive volume (divergence theorem), each of them.
    assert np.einsum("ij,ij->", face, a) / 6 > np.pi * SHAFT_RADIUS**2 * 0.11


def test_the_mesh_follows_the_pose() -> None:
    pose = Pose.looking(np.array([0.01, 0.02, 0.07]), np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]))

    moved = made("scissors", 0.3, pose)

    expected = made("scissors", 0.3).positions @ pose.rotation().T + pose.position
    np.testing.assert_allclose(moved.positions, expected, atol=1e-7)
