"""Cutting keeps the mesh a mesh, whatever is cut, and opens it exactly along the line."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hardware.stub.cutting import SHORTEST, SheetMesh
from hardware.stub.sheetmesh import MeshSpacing, triangulate
from hardware.stub.topology import components, edges_of, triangle_areas

SPACING = MeshSpacing(1.0e-3, 2.5e-3, 4e-3)
REST, TRIANGLES = triangulate(0.040, 0.030, np.array([[-0.01, 0.0], [0.01, 0.0]]), SPACING)


def fresh() -> SheetMesh:
    return SheetMesh(REST, TRIANGLES)


def cut(mesh: SheetMesh, *points: tuple[float, float], damage: float = 1.0) -> np.ndarray:
    """Cut along points given in mm; what is carried along are the rest coordinates, so that interpolation can be checked."""
    return mesh.cut(np.array(points) * 1e-3, damage, mesh.rest.copy())


def piece_count(mesh: SheetMesh) -> int:
    _, pairs, _ = edges_of(mesh.triangles)
    return len(set(components(len(mesh.triangles), pairs[(pairs >= 0).all(axis=1)]).tolist()))


def total_cut(mesh: SheetMesh) -> float:
    return sum(edge.length for edge in mesh.cut_edges)


coordinate = st.floats(-24, 24, allow_nan=False)
segment = st.tuples(coordinate, coordinate, coordinate, coordinate, st.sampled_from([1.0, 0.5]))


@settings(max_examples=60, deadline=None)
@given(st.lists(segment, min_size=1, max_size=12))
def test_any_cuts_keep_area_orientation_and_carried_values(segments):
    mesh = fresh()
    for x0, y0, x1, y1, damage in segments:
        carried = cut(mesh, (x0, y0), (x1, y1), damage=damage)
        areas = triangle_areas(mesh.rest, mesh.triangles)
        assert areas.min() > 0
        assert areas.sum() == pytest.approx(0.040 * 0.030, rel=1e-9)
        assert np.abs(carried - mesh.rest).max() < 1e-9
        assert set(mesh.triangles.ravel().tolist()) == set(range(len(mesh.rest)))


def test_a_cut_inside_the_sheet_opens_it_without_separating_it():
    mesh = fresh()
    cut(mesh, (-6, 0.3), (6, 0.3))

    assert piece_count(mesh) == 1
    assert total_cut(mesh) == pytest.approx(12e-3, abs=0.5e-3)
    assert len(mesh.rest) > len(REST)


def test_joined_snips_make_one_cut_without_a_bridge():
    mesh = fresh()
    for x in range(-24, 24, 4):
        cut(mesh, (x, 0.2), (x + 4, 0.2))

    assert piece_count(mesh) == 2


def test_a_cut_that_leaves_the_border_separates_a_corner():
    mesh = fresh()
    cut(mesh, (10, -20), (25, 5))

    assert piece_count(mesh) == 2


def test_crossing_cuts_make_four_pieces():
    mesh = fresh()
    cut(mesh, (-25, 0.1), (25, 0.1))
    cut(mesh, (0.3, -20), (0.3, 20))

    assert piece_count(mesh) == 4


def test_a_closed_cut_makes_a_detached_island():
    mesh = fresh()
    corners = [(-5, -5), (5, -5), (5, 5), (-5, 5), (-5, -5)]
    for a, b in itertools.pairwise(corners):
        cut(mesh, a, b)

    assert piece_count(mesh) == 2


def test_an_island_can_be_cut_again():
    mesh = fresh()
    test_corners = [(-5, -5), (5, -5), (5, 5), (-5, 5), (-5, -5)]
    for a, b in itertools.pairwise(test_corners):
        cut(mesh, a, b)
    cut(mesh, (-7, 0.2), (7, 0.2))

    assert piece_count(mesh) == 3


def test_a_cut_along_an_older_one_cuts_nothing_new():
    mesh = fresh()
    cut(mesh, (-6, 0.0), (6, 0.0))
    before = total_cut(mesh)
    cut(mesh, (-5, 0.0), (5, 0.0))

    assert total_cut(mesh) == pytest.approx(before, abs=0.3e-3)


def test_a_partly_severed_edge_is_held_by_seams_until_a_second_cut():
    mesh = fresh()
    cut(mesh, (-25, 0.0), (25, 0.0), damage=0.6)
    assert piece_count(mesh) == 2
    assert mesh.seams and all(seam.damage == pytest.approx(0.6) for seam in mesh.seams)

    cut(mesh, (-25, 0.05), (25, 0.05), damage=1.0)

    assert all(seam.damage == 1.0 for seam in mesh.seams)
    assert all(edge.damage == 1.0 for edge in mesh.cut_edges)


def test_a_slit_as_short_as_one_edge_still_opens():
    mesh = fresh()
    a, b = REST[edges_of(TRIANGLES)[0][len(REST)]]
    mesh.cut(np.stack([a, b]), 1.0, mesh.rest.copy())

    assert len(np.unique(mesh.rest, axis=0)) < len(mesh.rest)


def test_a_line_that_comes_again_and_again_does_not_divide_an_edge_without_end(monkeypatch):
    mesh = fresh()
    cut(mesh, (-6, 0.0), (6, 0.0))
    monkeypatch.setattr(mesh, "_move", lambda *_: False)  # as beside slivers, whose corners cannot go anywhere
    pairs, beside, _ = edges_of(mesh.triangles)
    inner = [pair for pair in pairs[(beside >= 0).all(axis=1)].tolist() if not any(map(mesh._on_border, pair))]
    near, far = inner[0]
    for _ in range(12):
        point = mesh.rest[near] + 0.05 * (mesh.rest[far] - mesh.rest[near])
        far = mesh._cross_edge(near, far, 0.05, point, set())
        if far == near:
            break

    corners = mesh.rest[mesh.triangles]
    assert far == near
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min() >= SHORTEST


def test_a_cut_that_misses_the_sheet_changes_nothing():
    mesh = fresh()
    cut(mesh, (30, 0), (40, 0))

    assert len(mesh.rest) == len(REST)
    assert mesh.cut_edges == []
