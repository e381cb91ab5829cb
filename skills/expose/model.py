"""The controller's tissue: a sheet of springs, hinges, seams and adhesions, made from the surface seen at t_d."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hardware.codes import InputError
from hardware.interface import Array

if TYPE_CHECKING:
    from skills.scene.surface import Surface

Indices = NDArray[np.int32]
Flags = NDArray[np.bool_]

# A triangle of springs k = c A / L^2 (A a third of its area) stores, averaged over directions, the energy of a plane-stress membrane with
# c / 4 = Eh / (1 + nu) and c / 8 = Eh nu / (1 - nu^2): springs can have nu = 1/3 only, and then c = 3 Eh. Exact for equilateral triangles.
SPRING_FACTOR = 3.0


@dataclass(frozen=True)
class ModelConfig:
    """What the controller believes of the tissue. It plans motions, which hardly depend on stiffness; forces do."""

    stretch: float = 80.0  # [N/m] Young's modulus times thickness, Eh
    # [J] flexural rigidity, here Eh t^2 / 12 (1 - nu^2) of a sheet 0.9 mm thick. This form of bending also resists a gradient of stretch,
    # beside the jaws with a fifth of the springs' force already; with a third of it, tissue before the jaws folds.
    bending: float = 6e-6
    adhesion: float = 2e6  # [N/m per m^2] to the bed, outside the free region; never breaks
    free_margin: float = 8e-3  # [m] round the goal, the grasp and what lies between them: the free region
    free_adhesion: float = 1e5  # [N/m per m^2] to the bed, in the free region
    adhesion_limit: float = 1.5e-3  # [m] lift at which an adhesion of the free region breaks
    grasp_radius: float = 2e-3  # [m] of the patch that moves with the jaws
    seam_ratio: float = 30.0  # stiffness of a whole seam, in that of the median edge
    floor_clearance: float = 0.2e-3  # [m] between the floor and the lowest vertex at rest

    def __post_init__(self) -> None:
        """Refuse what is no tissue."""
        for field in fields(self):
            value, zero = getattr(self, field.name), field.name in ("bending", "adhesion", "free_adhesion", "floor_clearance")
            if not (np.isfinite(value) and (value >= 0.0 if zero else value > 0.0)):
                raise InputError(f"{field.name} is {value}, but must be finite and {'at least' if zero else 'above'} 0")


@dataclass(frozen=True)
class TissueModel:
    """A sheet with all that holds it: what an XPBD solver needs, and nothing about samples or devices.

    Energies: edge 1/2 (|xi - xj| - rest_length)^2 / compliance; hinge 1/2 |sum_k w_k x_k - hinge_rest|^2 / compliance (isometric
    bending: linear in the positions, so no angle is ever taken); seam and adhesion 1/2 stiffness |distance|^2.
    """

    rest: Array  # (V, 3) float64 [m], left camera frame: the state at t_d, taken as free of stress
    triangles: Indices  # (F, 3)
    edges: Indices  # (E, 2)
    rest_length: Array  # (E,) [m]
    edge_compliance: Array  # (E,) [m/N]
    hinges: Indices  # (H, 4): the shared edge's two ends, then the two opposite corners
    hinge_weights: Array  # (H, 4): cotangents
    hinge_rest: Array  # (H, 3) [m]: what the weighted sum is at rest, so that a curved rest state is free of stress
    hinge_compliance: Array  # (H,) [m/N]
    seams: Indices  # (S, 2): the near and the far copy of a vertex on the goal
    seam_compliance: Array  # (S,) [m/N] when whole
    seam_station: Array  # (S,) 0..1 along the goal
    pinned: Flags  # (V,) never moves
    grasped: Flags  # (V,) moves with the jaws
    adhesion: Array  # (V,) [N/m]: zero-length spring to `rest`
    adhesion_limit: Array  # (V,) [m]: an adhesion longer than this breaks for good; inf = never
    weight: Array  # (V, 3) [N]: external force on each vertex
    floor: Array | None  # (4,) plane n.x + d >= 0 that no free vertex passes, |n| = 1

    def __post_init__(self) -> None:
        """Refuse shapes that do not fit, indices off the mesh, and numbers that no tissue has."""
        count, edges, hinges, seams = len(self.rest), len(self.edges), len(self.hinges), len(self.seams)
        shapes = {
            "rest": (count, 3),
            "triangles": (len(self.triangles), 3),
            "edges": (edges, 2),
            "rest_length": (edges,),
            "edge_compliance": (edges,),
            "hinges": (hinges, 4),
            "hinge_weights": (hinges, 4),
            "hinge_rest": (hinges, 3),
            "hinge_compliance": (hinges,),
            "seams": (seams, 2),
            "seam_compliance": (seams,),
            "seam_station": (seams,),
            "pinned": (count,),
            "grasped": (count,),
            "adhesion": (count,),
            "adhesion_limit": (count,),
            "weight": (count, 3),
        }
        for name, shape in shapes.items():
            array = getattr(self, name)
            if array.shape != shape:
                raise ValueError(f"{name} has shape {array.shape}, but {shape} fits the {count} vertices")
            if name in ("triangles", "edges", "hinges", "seams"):
                if array.dtype != np.int32:
                    raise ValueError(f"{name} is {array.dtype}, but must be int32")
                if array.size and (array.min() < 0 or array.max() >= count):
                    raise ValueError(f"{name} names a vertex outside 0..{count - 1}")
                if (np.diff(np.sort(array, axis=1), axis=1) == 0).any():
                    raise ValueError(f"{name} names a vertex twice in one row")
            elif name in ("pinned", "grasped"):
                if array.dtype != np.bool_:
                    raise ValueError(f"{name} is {array.dtype}, but must be bool")
            elif name != "adhesion_limit" and not np.isfinite(array).all():
                raise ValueError(f"{name} holds numbers that are not finite")
        for name in ("rest_length", "edge_compliance", "hinge_compliance", "seam_compliance", "adhesion_limit"):
            if not (getattr(self, name) > 0.0).all():
                raise ValueError(f"{name} must be above 0 everywhere")
        if (self.adhesion < 0.0).any():
            raise ValueError("adhesion must be at least 0 everywhere")
        if (self.pinned & self.grasped).any():
            raise ValueError(f"vertex {int(np.flatnonzero(self.pinned & self.grasped)[0])} is both pinned and grasped")
        if self.floor is not None:
            if self.floor.shape != (4,) or not np.isclose(np.linalg.norm(self.floor[:3]), 1.0, atol=1e-6):
                raise ValueError("floor must be (4,): a unit normal and an offset")
            below = self.rest @ self.floor[:3] + self.floor[3]
            if below.min() < -1e-9:
                raise ValueError(f"the rest state lies {-below.min() * 1e3:.2f} mm below the floor")

    @property
    def free(self) -> Flags:
        """Vertices (V,) that move by themselves."""
        return ~(self.pinned | self.grasped)


def build_model(surface: Surface, grasp: ArrayLike, config: ModelConfig | None = None) -> TissueModel:
    """The tissue of `surface`, split along the goal, with the jaws closed at `grasp` (3,) [m].

    Vertices of the surface keep their index and become the near copies; the far copies come after them, one for each seam.
    Triangles keep their order.
    """
    config = config or ModelConfig()
    grasp = np.asarray(grasp, dtype=np.float64)
    if grasp.shape != (3,) or not np.isfinite(grasp).all():
        raise InputError("the grasp must be three finite numbers [m]")
    rest, triangles, split = _split(surface)
    copies = np.arange(len(surface.vertices), len(rest), dtype=np.int32)
    grasped = _grasp_patch(surface, len(rest), grasp, config.grasp_radius)
    pinned = np.append(surface.border, surface.border[split]) & ~grasped
    free = _free_region(surface, rest, grasp, config.free_margin)
    area = vertex_areas(rest, triangles)
    return model_from_mesh(
        rest,
        triangles,
        config,
        pinned=pinned,
        grasped=grasped,
        seams=np.stack([split, copies], axis=1),
        seam_station=surface.station[split] / surface.goal_length,
        adhesion=area * np.where(free, config.free_adhesion, config.adhesion),
        adhesion_limit=np.where(free, config.adhesion_limit, np.inf),
        floor=_floor(rest, triangles, config.floor_clearance),
    )


def model_from_mesh(
    rest: ArrayLike,
    triangles: ArrayLike,
    config: ModelConfig | None = None,
    *,
    pinned: ArrayLike | None = None,
    grasped: ArrayLike | None = None,
    seams: ArrayLike | None = None,
    seam_station: ArrayLike | None = None,
    adhesion: ArrayLike | None = None,
    adhesion_limit: ArrayLike | None = None,
    weight: ArrayLike | None = None,
    floor: ArrayLike | None = None,
) -> TissueModel:
    """Springs and hinges for the mesh `rest` (V, 3) [m], `triangles` (F, 3); what is not given is absent."""
    config = config or ModelConfig()
    rest = np.array(rest, dtype=np.float64)
    triangles = np.array(triangles, dtype=np.int32)
    if rest.ndim != 2 or rest.shape[1] != 3 or not np.isfinite(rest).all():
        raise ValueError(f"the mesh's vertices must be (V, 3) and finite; got shape {rest.shape}")
    if triangles.ndim != 2 or triangles.shape[1] != 3 or len(triangles) == 0:
        raise ValueError(f"the mesh's triangles must be (F, 3) with at least one; got shape {triangles.shape}")
    if triangles.min() < 0 or triangles.max() >= len(rest):
        raise ValueError(f"triangles names a vertex outside 0..{len(rest) - 1}")
    areas = triangle_areas(rest, triangles)
    if (areas <= 1e-12 * areas.max()).any():
        raise ValueError(f"triangle {int(np.argmin(areas))} has no area")

    edges, sides = _edges(triangles)
    share = np.bincount(sides.ravel(), weights=np.repeat(areas / 3.0, 3), minlength=len(edges))
    length = np.linalg.norm(rest[edges[:, 0]] - rest[edges[:, 1]], axis=1)
    stiffness = SPRING_FACTOR * config.stretch * share / length**2
    hinges, weights, spread = _hinges(rest, triangles, areas, edges, sides)
    if config.bending == 0.0:
        hinges, weights, spread = hinges[:0], weights[:0], spread[:0]
    links = np.zeros((0, 2), dtype=np.int32) if seams is None else np.array(seams, dtype=np.int32).reshape(-1, 2)
    count = len(rest)

    def per_vertex(value: ArrayLike | None, default: float | bool, dtype: type) -> NDArray:
        return np.full(count, default, dtype=dtype) if value is None else np.array(value, dtype=dtype)

    return TissueModel(
        rest=rest,
        triangles=triangles,
        edges=edges,
        rest_length=length,
        edge_compliance=1.0 / stiffness,
        hinges=hinges,
        hinge_weights=weights,
        hinge_rest=np.einsum("hk,hkc->hc", weights, rest[hinges]),
        hinge_compliance=spread / max(config.bending, np.finfo(float).tiny),
        seams=links,
        seam_compliance=np.full(len(links), 1.0 / (config.seam_ratio * float(np.median(stiffness)))),
        seam_station=np.zeros(len(links)) if seam_station is None else np.array(seam_station, dtype=np.float64),
        pinned=per_vertex(pinned, False, np.bool_),
        grasped=per_vertex(grasped, False, np.bool_),
        adhesion=per_vertex(adhesion, 0.0, np.float64),
        adhesion_limit=per_vertex(adhesion_limit, np.inf, np.float64),
        weight=np.zeros((count, 3)) if weight is None else np.array(weight, dtype=np.float64),
        floor=None if floor is None else np.array(floor, dtype=np.float64),
    )


def triangle_areas(positions: Array, triangles: Indices) -> Array:
    """Area (F,) [m^2] of each triangle."""
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0)


def vertex_areas(positions: Array, triangles: Indices) -> Array:
    """Area (V,) [m^2] that belongs to each vertex: a third of its triangles'."""
    areas = triangle_areas(positions, triangles)
    return np.asarray(
        np.bincount(triangles.ravel(), weights=np.repeat(areas / 3.0, 3), minlength=len(positions)), dtype=np.float64
    )


def _edges(triangles: Indices) -> tuple[Indices, NDArray[np.int64]]:
    """Every edge (E, 2) once, and for side k of each triangle (from corner k to corner k + 1) which edge it is, (F, 3)."""
    sides = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2).reshape(-1, 2)
    edges, index = np.unique(np.sort(sides, axis=1), axis=0, return_inverse=True)
    return edges.astype(np.int32), index.reshape(-1, 3)


def _hinges(
    rest: Array, triangles: Indices, areas: Array, edges: Indices, sides: NDArray[np.int64]
) -> tuple[Indices, Array, Array]:
    """Hinges (H, 4) over edges with two triangles, their weights (H, 4), and the two triangles' area (H,) [m^2].

    The weights are the integrals of the gradient of the edge's Crouzeix-Raviart function times those of the vertices' hat functions, so
    sum_k w_k x_k is the curvature that the edge sees, times a third of the area. Edges across the bend see most of it, edges along it
    less: over a lattice of squares or of equilateral triangles, |.|^2 / area sums to the integral of kappa^2 of a cylinder, where the
    usual 3 / area gives three times that.
    """
    order = np.argsort(sides.ravel(), kind="stable")
    owner, counts = order // 3, np.bincount(sides.ravel(), minlength=len(edges))
    if counts.max() > 2:
        i, j = edges[int(np.argmax(counts))]
        raise ValueError(f"more than two triangles meet at the edge {i}-{j}: the mesh is no sheet")
    start = np.concatenate([[0], np.cumsum(counts)[:-1]])
    shared = np.flatnonzero(counts == 2)
    one, two = owner[start[shared]], owner[start[shared] + 1]
    ends = edges[shared]
    corners = np.stack([triangles[t].sum(axis=1) - ends.sum(axis=1) for t in (one, two)], axis=1)
    hinges = np.concatenate([ends, corners], axis=1).astype(np.int32)
    x0, x1, x2, x3 = (rest[hinges[:, k]] for k in range(4))
    c01, c02 = _cotangent(x0, x1, x2), _cotangent(x0, x1, x3)  # at x0
    c03, c04 = _cotangent(x1, x0, x2), _cotangent(x1, x0, x3)  # at x1
    weights = np.stack([c03 + c04, c01 + c02, -c01 - c03, -c02 - c04], axis=1)
    return hinges, weights, areas[one] + areas[two]


def _cotangent(at: Array, one: Array, two: Array) -> Array:
    """Cotangent (H,) of the angle at `at` between the directions to `one` and `two`."""
    a, b = one - at, two - at
    return np.asarray((a * b).sum(axis=1) / np.linalg.norm(np.cross(a, b), axis=1))


def _split(surface: Surface) -> tuple[Array, Indices, NDArray[np.int64]]:
    """Vertices with a far copy of each vertex inside the goal appended, triangles of the far side on the copies, and who was split."""
    inside = (surface.lateral == 0.0) & (surface.station > 0.0) & (surface.station < surface.goal_length)
    split = np.flatnonzero(inside)
    split = split[np.argsort(surface.station[split], kind="stable")]
    if len(split) == 0:
        raise InputError("no vertex of the surface lies inside the goal: the lattice is too coarse for it")
    corner = surface.lateral[surface.triangles]
    touching = inside[surface.triangles].any(axis=1)
    if (touching & (corner.max(axis=1) > 0.0) & (corner.min(axis=1) < 0.0)).any():
        raise InputError("a triangle of the surface crosses the goal, so the surface cannot be split along it")
    copy = np.arange(len(surface.vertices))
    copy[split] = len(surface.vertices) + np.arange(len(split))
    far = corner.min(axis=1) < 0.0
    triangles = np.where(far[:, None], copy[surface.triangles], surface.triangles).astype(np.int32)
    return np.concatenate([surface.vertices, surface.vertices[split]]), triangles, split


def _grasp_patch(surface: Surface, count: int, grasp: Array, radius: float) -> Flags:
    """Vertices (V,) in the jaws: within `radius` of the grasp and not beyond the goal; the nearest one at least."""
    distance = np.linalg.norm(surface.vertices - grasp, axis=1)
    distance[surface.lateral < 0.0] = np.inf  # the jaws hold the near side alone, however close to the goal they closed
    nearest = int(np.argmin(distance))
    if not distance[nearest] <= 3.0 * radius:
        raise InputError(
            f"the grasp is {distance[nearest] * 1e3:.1f} mm off the near side of the surface; at most {3e3 * radius:.1f} mm is a grasp"
        )
    grasped = np.zeros(count, dtype=bool)
    grasped[: len(distance)] = distance <= radius
    grasped[nearest] = True
    return grasped


def _free_region(surface: Surface, rest: Array, grasp: Array, margin: float) -> Flags:
    """Vertices (V,) within `margin` of the goal or of the triangle that goal and grasp span: what the cut has loosened and a pull lifts."""
    on_goal = (surface.lateral == 0.0) & (surface.station >= 0.0) & (surface.station <= surface.goal_length)
    line = np.flatnonzero(on_goal)
    goal = surface.vertices[line[np.argsort(surface.station[line], kind="stable")]]
    near = np.full(len(rest), np.inf)
    for point in goal:
        near = np.minimum(near, _distance_to_segment(rest, grasp, point))
    for one, two in itertools.pairwise(goal):
        near = np.minimum(near, _distance_to_segment(rest, one, two))
    return near <= margin


def _distance_to_segment(points: Array, start: Array, end: Array) -> Array:
    """Distance (N,) of points (N, 3) to the segment from `start` (3,) to `end` (3,)."""
    along = end - start
    share = np.clip((points - start) @ along / max(float(along @ along), 1e-18), 0.0, 1.0)
    return np.asarray(np.linalg.norm(points - start - share[:, None] * along, axis=1))


def _floor(rest: Array, triangles: Indices, clearance: float) -> Array:
    """The plane (4,) through the bed: as the surface lies on average, its normal towards the camera, below all of the surface.

    The plane that fits best passes through the middle of a curved or noisy surface: half of it would start below the floor and be
    pushed up before anything is pulled. Moved down along its normal to just under the lowest vertex, the rest state is feasible.
    """
    normal = np.linalg.svd(rest - rest.mean(axis=0), full_matrices=False)[2][2]
    a, b, c = (rest[triangles[:, k]] for k in range(3))
    if np.cross(b - a, c - a).sum(axis=0) @ normal < 0.0:
        normal = -normal
    return np.append(normal, clearance - float((rest @ normal).min()))
