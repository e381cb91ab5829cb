"""What holds the lips of a half cut together, and what the endoscope sees of it."""

import numpy as np
import pytest

from hardware.interface import Array, Pose
from hardware.stub.bench import STEP, StubBench
from hardware.stub.cutting import SheetMesh
from hardware.stub.ligaments import ligaments
from hardware.stub.renderer import Label, Rendering
from hardware.stub.scene import load_scene
from hardware.stub.sheet_solver import bed_height
from hardware.stub.sheetmesh import MeshSpacing, triangulate

GOAL = np.array([[-0.020, 0.0], [0.020, 0.0]])


def sheet() -> SheetMesh:
    return SheetMesh(*triangulate(0.08, 0.06, GOAL, MeshSpacing(0.8e-3, 2.4e-3, 5e-3)))


def cut(mesh: SheetMesh, start: float, end: float, damage: float) -> None:
    mesh.cut(np.array([[start, 0.0], [end, 0.0]]), damage, np.zeros((len(mesh.rest), 0)))


def joined_length(mesh: SheetMesh) -> float:
    """Length [m] of cut that ligaments span."""
    joined = ligaments(mesh)
    rest = mesh.rest[joined.ends]
    return float((joined.reach * np.linalg.norm(rest[:, 2] - rest[:, 0], axis=1)).sum())


def cut_length(mesh: SheetMesh) -> float:
    return sum(edge.length for edge in mesh.cut_edges if edge.damage < 1.0)


def test_ligaments_span_a_half_cut_from_tip_to_tip() -> None:
    mesh = sheet()
    cut(mesh, -0.010, 0.010, 0.4)

    joined = ligaments(mesh)

    assert joined_length(mesh) == pytest.approx(cut_length(mesh), rel=1e-6)
    assert (joined.ends[:, 2] == joined.ends[:, 3]).sum() == 2  # at the two tips
    np.testing.assert_allclose(joined.depth, 0.4)


def test_nothing_spans_what_is_cut_through_or_torn() -> None:
    mesh = sheet()
    cut(mesh, -0.010, 0.010, 1.0)
    assert len(ligaments(mesh).ends) == 0
    cut(mesh, 0.012, 0.018, 0.5)
    assert len(ligaments(mesh).ends) == len(mesh.seams)

    for i in range(len(mesh.seams)):
        mesh.tear_seam(i)

    assert len(ligaments(mesh).ends) == 0


def test_where_one_seam_of_an_edge_has_torn_the_other_half_stays() -> None:
    mesh = sheet()
    cut(mesh, -0.010, 0.010, 0.5)
    whole = joined_length(mesh)
    seam = mesh.seams[10]

    mesh.tear_seam(10)

    assert joined_length(mesh) == pytest.approx(whole - seam.edge.length / 2, rel=1e-6)


@pytest.mark.parametrize(("damage", "missing"), [(0.7, 0.0), (1.0, 0.5)])
def test_a_cut_that_goes_on_from_the_tip_of_a_half_cut_may_hold_its_last_edge(damage: float, missing: float) -> None:
    mesh = sheet()
    cut(mesh, -0.010, 0.0, 0.4)
    last = mesh.cut_edges[-1]

    cut(mesh, 0.0, 0.010, damage)

    assert joined_length(mesh) == pytest.approx(cut_length(mesh) - missing * last.length, rel=1e-6)


@pytest.mark.parametrize("seed", range(6))
def test_both_lips_of_every_ligament_were_one_whatever_was_cut_since(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = sheet()

    for _ in range(10):
        start = rng.uniform([-0.015, -0.003], [0.015, 0.003])
        line = np.stack([start, start + rng.uniform([-0.006, -0.003], [0.006, 0.003])])
        mesh.cut(line, float(rng.choice([0.3, 0.8, 1.0])), np.zeros((len(mesh.rest), 0)))
        ends = ligaments(mesh).ends

        assert (mesh.rest[ends[:, 0]] == mesh.rest[ends[:, 1]]).all() and (ends[:, 0] != ends[:, 1]).all()
        assert (mesh.rest[ends[:, 2]] == mesh.rest[ends[:, 3]]).all()


def pulled(bench: StubBench, distance: float) -> None:
    """Grasp behind the goal and pull across it."""
    grasp = np.array(bench.scene.goal.grasp)
    height = bed_height(grasp[None], bench.scene.bump)[0] + bench.scene.tissue.thickness / 2
    pose = Pose.looking(np.array([*grasp, height]), np.array([0.0, -0.5, -0.85]), np.array([1.0, 0.0, 0.0]))
    assert bench.phantom.grasp(pose)
    steps = round(distance / 10e-3 / STEP)
    for i in range(steps):
        bench.phantom.advance(pose.moved(np.array([0.0, distance * (i + 1) / steps, 0.0])))


def along_the_goal(bench: StubBench, rendering: Rendering) -> Array:
    """Labels of pixels that show something within 12 mm of the goal's line, in table coordinates."""
    v, u = np.nonzero(rendering.label)
    points = bench.endoscope.camera.unproject(np.column_stack([u, v]).astype(float), rendering.depth[v, u].astype(np.float64))
    x, y = bench.to_table(points)[:, :2].T
    return np.asarray(rendering.label[v, u][(np.abs(x) < 0.022) & (np.abs(y) < 0.012)])


@pytest.mark.parametrize("material", ["silicone", "chicken", "beef"])
def test_the_bed_shows_in_a_half_cut_only_once_it_has_torn(material: str) -> None:
    bench = StubBench(load_scene(material), 0)
    for start in (-0.020, -0.010, 0.0, 0.010):
        bench.phantom.cut([(np.array([[start, 0.0], [start + 0.010, 0.0]]), 0.9)])
    pulled(bench, 6e-3)

    held = along_the_goal(bench, bench.endoscope.rendering())
    revision = bench.phantom.mesh.revision
    for i in range(len(bench.phantom.mesh.seams)):
        bench.phantom.mesh.tear_seam(i)
    bench.advance(0.05)
    torn = along_the_goal(bench, bench.endoscope.rendering())

    assert (held == Label.SEAM).sum() > 200 and not (held == Label.BASE).any()
    assert (torn == Label.BASE).sum() > 200 and not (torn == Label.SEAM).any()
    assert bench.phantom.mesh.revision == revision
