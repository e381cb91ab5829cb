"""The controller's tissue model: what is split, what holds it, and how stiff it is."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hardware.codes import InputError
from skills.expose.model import ModelConfig, TissueModel, build_model, model_from_mesh, vertex_areas
from tests.skills.sheets import DEPTH, lattice, sheet_model, strip, surface

GRASP = np.array([7.5e-3, 0.0, DEPTH])


def membrane_energy(model: TissueModel, positions: np.ndarray) -> float:
    length = np.linalg.norm(positions[model.edges[:, 0]] - positions[model.edges[:, 1]], axis=1)
    return float(((length - model.rest_length) ** 2 / model.edge_compliance).sum() / 2)


def bending_energy(model: TissueModel, positions: np.ndarray) -> float:
    bent = np.einsum("hk,hkc->hc", model.hinge_weights, positions[model.hinges]) - model.hinge_rest
    return float(((bent**2).sum(axis=1) / model.hinge_compliance).sum() / 2)


def test_an_even_lattice_has_the_stiffness_of_theory() -> None:
    model = model_from_mesh(*strip(8, 8, 2e-3), ModelConfig(stretch=100.0))
    assert np.median(1.0 / model.edge_compliance) == pytest.approx(np.sqrt(0.75) * 100.0)


@pytest.mark.parametrize("strain", [(1e-4, 0.0, 0.0), (0.0, 1e-4, 0.0), (1e-4, 1e-4, 0.0), (0.0, 0.0, 1e-4), (1e-4, -5e-5, 3e-5)])
def test_a_strained_sheet_stores_the_energy_of_a_membrane(strain: tuple[float, float, float]) -> None:
    exx, eyy, exy = strain
    vertices, triangles = strip(9, 9, 2e-3)
    model = model_from_mesh(vertices, triangles, ModelConfig(stretch=100.0))
    strained = vertices @ (np.eye(3) + np.array([[exx, exy, 0.0], [exy, eyy, 0.0], [0.0, 0.0, 0.0]]))
    area, nu = vertex_areas(vertices, triangles).sum(), 1.0 / 3.0
    square = exx**2 + eyy**2 + 2 * exy**2
    theory = area * 100.0 / (1 - nu**2) / 2 * ((1 - nu) * square + nu * (exx + eyy) ** 2)
    assert membrane_energy(model, strained) == pytest.approx(theory, rel=1e-3)


@pytest.mark.parametrize("mesh", [lattice, strip])
def test_a_rolled_sheet_stores_the_energy_of_a_plate(mesh: Callable[..., tuple[np.ndarray, np.ndarray]]) -> None:
    vertices, triangles = mesh(61, 61, 1e-3)
    model = model_from_mesh(vertices, triangles, ModelConfig(bending=1e-5))
    curvature = 5.0
    rolled = vertices.copy()
    rolled[:, 0] = np.sin(curvature * vertices[:, 0]) / curvature
    rolled[:, 2] = DEPTH + (1 - np.cos(curvature * vertices[:, 0])) / curvature
    area = model.hinge_compliance.sum() * 1e-5 / 3.0  # a hinge stands for a third of its two triangles
    assert bending_energy(model, rolled) == pytest.approx(1e-5 / 2 * curvature**2 * area, rel=0.02)


def test_bending_does_not_resist_turning_or_moving_a_flat_sheet() -> None:
    vertices, triangles = lattice(7, 7, 2e-3)
    model = model_from_mesh(vertices, triangles)
    turned = vertices @ np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]) + 0.1
    assert bending_energy(model, turned) < 1e-20


def test_a_curved_surface_is_free_of_stress_at_rest() -> None:
    model = sheet_model(bump=6e-3)
    assert membrane_energy(model, model.rest) < 1e-30
    assert bending_energy(model, model.rest) < 1e-30


def test_the_goal_is_split_between_its_ends_and_nowhere_else() -> None:
    seen = surface(21, goal=20e-3)  # vertices on the line every 2.5 mm: 7 lie strictly inside, 2 are the tips
    model = build_model(seen, GRASP)
    near, far = model.seams.T
    assert len(model.seams) == 7
    assert len(model.rest) == len(seen.vertices) + 7
    assert (model.rest[near] == model.rest[far]).all()
    assert model.seam_station == pytest.approx(np.arange(1, 8) / 8)
    assert (far >= len(seen.vertices)).all()
    assert (near < len(seen.vertices)).all()


def test_the_near_copy_has_the_triangles_of_the_grasp_s_side() -> None:
    seen = surface(21)
    model = build_model(seen, GRASP)
    assert model.triangles.shape == seen.triangles.shape
    original = np.concatenate([np.arange(len(seen.vertices)), model.seams[:, 0]])
    assert (original[model.triangles] == seen.triangles).all()  # the order of triangles and corners is kept
    middle = model.rest[model.triangles].mean(axis=1)[:, 0]
    assert (middle[np.isin(model.triangles, model.seams[:, 0]).any(axis=1)] > 0.0).all()
    assert (middle[np.isin(model.triangles, model.seams[:, 1]).any(axis=1)] < 0.0).all()


def test_no_edge_and_no_hinge_crosses_the_goal() -> None:
    model = sheet_model()
    side = np.sign(np.round(model.rest[:, 0], 9))
    side[model.seams[:, 0]], side[model.seams[:, 1]] = 1.0, -1.0
    for rows in (model.edges, model.hinges):
        inside = np.isin(rows, model.seams).any(axis=1)
        assert (np.ptp(side[rows[inside]], axis=1) < 2.0).all()


def test_only_a_border_that_is_not_grasped_is_pinned() -> None:
    seen = surface(21)
    edge = np.array([25e-3, 0.0, DEPTH])
    model = build_model(seen, edge, ModelConfig(grasp_radius=3e-3))
    assert model.grasped.any()
    assert (model.pinned[: len(seen.vertices)] == (seen.border & ~model.grasped[: len(seen.vertices)])).all()


def test_the_jaws_hold_the_near_side_alone() -> None:
    seen = surface(21)
    model = build_model(seen, np.array([1e-3, 0.0, DEPTH]), ModelConfig(grasp_radius=4e-3))
    assert model.grasped.sum() > 3
    assert (model.rest[model.grasped, 0] >= 0.0).all()
    assert not model.grasped[model.seams[:, 1]].any()


def test_a_patch_smaller_than_the_lattice_still_grasps_the_nearest_vertex() -> None:
    model = build_model(surface(21), GRASP + np.array([0.9e-3, 0.5e-3, 0.0]), ModelConfig(grasp_radius=0.5e-3))
    assert np.flatnonzero(model.grasped).size == 1
    assert model.rest[model.grasped][0] == pytest.approx(GRASP)


def test_adhesion_is_per_area_and_weak_only_round_the_goal_and_the_grasp() -> None:
    config = ModelConfig(adhesion=1e6, free_adhesion=1e4, free_margin=5e-3)
    model = build_model(surface(21), GRASP, config)
    free = np.isfinite(model.adhesion_limit)
    density = model.adhesion / vertex_areas(model.rest, model.triangles)
    assert density[free] == pytest.approx(1e4)
    assert density[~free] == pytest.approx(1e6)
    assert (model.adhesion_limit[free] == config.adhesion_limit).all()
    assert free[model.seams].all()
    assert free[model.grasped].all()
    assert not free[model.rest[:, 0] < -5.1e-3].any()  # the far side beyond the margin
    assert free[np.argmin(np.linalg.norm(model.rest - [5e-3, 2.5e-3, DEPTH], axis=1))]  # between goal and grasp


@pytest.mark.parametrize("bump", [0.0, 6e-3])
def test_the_floor_lies_below_the_whole_surface_and_not_far_below(bump: float) -> None:
    model = sheet_model(config=ModelConfig(floor_clearance=0.3e-3), bump=bump)
    assert model.floor is not None
    height = model.rest @ model.floor[:3] + model.floor[3]
    assert height.min() == pytest.approx(0.3e-3)
    assert model.floor[2] < -0.99  # towards the camera


def test_bending_can_be_left_out() -> None:
    assert len(sheet_model(config=ModelConfig(bending=0.0)).hinges) == 0


def test_a_surface_that_the_goal_misses_is_refused() -> None:
    with pytest.raises(InputError, match="no vertex of the surface lies inside the goal"):
        build_model(replace(surface(21), goal_length=1.0), GRASP)


def test_a_triangle_across_the_goal_is_refused() -> None:
    seen = surface(21)
    lateral = np.where((seen.lateral == 0.0) & (seen.station < 50.0), 0.1, seen.lateral)  # one end of the line is off it
    lateral[(seen.lateral > 0.0) & (seen.lateral < 30.0)] = -30.0
    with pytest.raises(InputError, match="crosses the goal"):
        build_model(replace(seen, lateral=lateral), GRASP)


@pytest.mark.parametrize(
    ("grasp", "sentence"),
    [
        ([0.0, 0.0, DEPTH - 20e-3], "20.0 mm off the near side"),
        ([np.nan, 0.0, 0.0], "three finite numbers"),
        ([0.0, 0.0], "three finite"),
    ],
)
def test_a_grasp_off_the_surface_is_refused(grasp: list[float], sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        build_model(surface(21), grasp)


@pytest.mark.parametrize(
    ("name", "value"), [("stretch", 0.0), ("bending", -1.0), ("adhesion", float("nan")), ("grasp_radius", -1e-3)]
)
def test_a_configuration_of_no_tissue_is_refused(name: str, value: float) -> None:
    with pytest.raises(InputError, match=name):
        ModelConfig(**{name: value})


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"rest_length": np.ones(3)}, "rest_length has shape"),
        ({"edge_compliance": -1.0}, "edge_compliance must be above 0"),
        ({"adhesion": -1.0}, "adhesion must be at least 0"),
        ({"weight": np.nan}, "weight holds numbers that are not finite"),
        ({"pinned": True}, "both pinned and grasped"),
        ({"edges": 10_000}, "edges names a vertex outside"),
        ({"edges": 3}, "edges names a vertex twice"),
        ({"floor": np.array([0.0, 0.0, -2.0, 1.0])}, "floor must be"),
        ({"floor": np.array([0.0, 0.0, -1.0, DEPTH - 1e-3])}, "1.00 mm below the floor"),
    ],
)
def test_a_model_that_fits_together_badly_is_refused(change: dict[str, Any], sentence: str) -> None:
    model = sheet_model(11)
    name, value = next(iter(change.items()))
    if np.isscalar(value):
        value = np.full_like(getattr(model, name), value)
    with pytest.raises(ValueError, match=sentence):
        replace(model, **{name: value})


def test_meshes_that_are_no_sheet_are_refused() -> None:
    vertices, triangles = lattice(4, 4, 1e-3)
    with pytest.raises(ValueError, match="more than two triangles meet"):
        model_from_mesh(vertices, np.concatenate([triangles, triangles[:1]]))
    with pytest.raises(ValueError, match="has no area"):
        model_from_mesh(vertices, np.concatenate([triangles, [[0, 1, 2]]]))
    with pytest.raises(ValueError, match=r"outside 0\.\.15"):
        model_from_mesh(vertices, triangles + 5)
