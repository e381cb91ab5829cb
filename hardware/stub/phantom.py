"""The tissue: one sheet over a bumped bed, held by adhesions, pulled by a gripper that slips, and cut where blades pass.

Table frame throughout: origin on the bed below the sheet's middle, x right, y away from the camera, z up. Metres, newtons, seconds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates

from hardware.interface import Array, Pose
from hardware.stub.cutting import Seam, SheetMesh
from hardware.stub.scene import Scene
from hardware.stub.sheet_solver import SheetSolver, SolverModel, SolverState, bed_height
from hardware.stub.sheetmesh import MeshSpacing, distance_to_line, triangulate
from hardware.stub.topology import Topology, build_topology

SUBSTEPS = 2
DAMPING = 0.94  # of the velocity, per substep
MASS_RATIO = 3.0  # m/dt^2 over the stretch stiffness; see sheet_solver
GRIP_RADIUS = 3.5e-3  # [m]
GRIP_REACH = 2.5e-3  # [m], how far above or below the jaws tissue may lie to be caught
GRIP_STIFFNESS = 400.0  # [N/m] per vertex
SLIP_RELEASE = 3e-3  # [m] of sliding after which a vertex has left the jaws
TEAR_GAUGE = 0.8  # of the fine spacing: the shortest length over which stretch is read
REST_SPEED = 2e-4  # [m/s]: slower than this everywhere, and the sheet sleeps until something pulls it


@dataclass
class Grip:
    """Tissue between the jaws: `vertices`, their places in the tool frame at the grasp (`origin`) and now (`offset`), (G, 3) [m]."""

    vertices: NDArray[np.int32]
    origin: Array
    offset: Array
    target: Array
    hold_force: float


class Phantom:
    """The simulated tissue of one session. Not thread-safe."""

    def __init__(self, scene: Scene, seed: int, hold_force: float, step: float) -> None:
        tissue = scene.tissue
        spacing = MeshSpacing(tissue.fine_spacing, tissue.coarse_spacing, tissue.fine_band)
        rest, triangles = triangulate(tissue.width, tissue.height, scene.line, spacing)
        self.scene = scene
        self.mesh = SheetMesh(rest, triangles)
        self.grip: Grip | None = None
        self.tears = 0
        self.bed_contact = 0.0
        self._hold_force = hold_force
        self._step = step
        self._toughness = _random_field(scene, seed)
        x = self._rest_positions(rest)
        area_adhesion = _adhesion_density(scene, rest)
        self._adhesion_intact = np.ones(len(rest), dtype=bool)
        self._resting = 0
        topology = build_topology(rest, triangles)
        adhesion = area_adhesion * topology.vertex_area
        self._build(topology, SolverState(_f32(x), np.zeros_like(_f32(x)), _f32(adhesion)))

    # ---------------------------------------------------------------- state

    @property
    def positions(self) -> Array:
        """(V, 3) [m]."""
        return self._solver.state.x.astype(np.float64)

    @property
    def velocities(self) -> Array:
        """(V, 3) [m/s]."""
        return self._solver.state.velocity.astype(np.float64)

    @property
    def topology(self) -> Topology:
        """Edges and hinges of the mesh as it is now."""
        return self._topology

    @property
    def asleep(self) -> bool:
        """Whether the sheet is at rest and is not being advanced."""
        return self._resting > 30

    def toughness(self, rest: Array) -> Array:
        """Force (N,) [N] at which a blade tip goes through at rest coordinates `rest` (N, 2)."""
        tissue = self.scene.tissue
        field = self._toughness
        scale = np.array([(field.shape[1] - 1) / tissue.width, (field.shape[0] - 1) / tissue.height])
        at = (np.asarray(rest) + np.array([tissue.width, tissue.height]) / 2) * scale
        return np.asarray(map_coordinates(field, [at[:, 1], at[:, 0]], order=1, mode="nearest"))

    def edge_strain(self) -> Array:
        """(E,) relative lengthening of every edge."""
        x, edges = self.positions, self._topology.edges
        return np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1) / self._solver.model.rest_length - 1.0

    def kinetic_energy(self) -> float:
        """[J], with the numerical masses."""
        return float(0.5 * self._solver.model.mass * (self.velocities**2).sum())

    def intact_adhesions(self) -> NDArray[np.bool_]:
        """(V,) where an adhesion still ties the sheet to the bed."""
        return np.asarray(self._solver.state.adhesion > 0.0)

    def line_tension(self, rest: Array, radius: float = 4e-3) -> Array:
        """Membrane tension (N,) [N/m]: stretch stiffness times the mean positive strain within `radius` [m] of rest points (N, 2)."""
        edges = self._topology.edges
        middle = self.mesh.rest[edges].mean(axis=1)
        strain = np.maximum(self.edge_strain(), 0.0)
        near = ((middle[None] - np.asarray(rest)[:, None]) ** 2).sum(-1) < radius**2
        mean = (near * strain).sum(axis=1) / np.maximum(near.sum(axis=1), 1)
        return np.asarray(mean * self.scene.tissue.youngs_modulus * self.scene.tissue.thickness)

    # ---------------------------------------------------------------- grasp

    def grasp(self, tip: Pose) -> bool:
        """Close the jaws at `tip`: catches the tissue within the jaws' reach; False when nothing is there."""
        x = self.positions
        local = (x - tip.position) @ tip.rotation()
        lateral = np.linalg.norm(x[:, :2] - tip.position[:2], axis=1)
        caught = np.flatnonzero((lateral < GRIP_RADIUS) & (np.abs(x[:, 2] - tip.position[2]) < GRIP_REACH))
        if len(caught) < 3:
            return False
        offset = local[caught]
        self.grip = Grip(caught.astype(np.int32), offset.copy(), offset.copy(), x[caught], self._hold_force / len(caught))
        self._resting = 0
        return True

    def release(self) -> None:
        """Open the jaws."""
        self.grip = None
        self._resting = 0

    def grip_force(self) -> Array:
        """Force (3,) [N] of the tissue on the gripper."""
        if self.grip is None:
            return np.zeros(3)
        stretch = self.positions[self.grip.vertices] - self.grip.target
        return np.asarray(GRIP_STIFFNESS * stretch.sum(axis=0))

    # ---------------------------------------------------------------- time

    def advance(self, tip: Pose | None) -> None:
        """One physics step; `tip` is the gripper's true pose at its end."""
        empty = np.zeros((0, 3))
        vertices = np.zeros(0, np.int32)
        start: Array = empty
        end: Array = empty
        if self.grip is not None and tip is not None:
            vertices, start = self.grip.vertices, self.grip.target
            end = tip.position + self.grip.offset @ tip.rotation().T
            if np.abs(end - start).max() > 1e-6:
                self._resting = 0
        if self.asleep:
            return
        self._solver.advance(vertices, _f32(start), _f32(end), self._step / SUBSTEPS, SUBSTEPS, DAMPING)
        if self.grip is not None and tip is not None:
            self.grip.target = end
            self._slip(self.grip, tip)
        fastest = float(np.abs(self._solver.state.velocity).max())
        self._resting = self._resting + 1 if fastest < REST_SPEED else 0

    def tear(self) -> int:
        """Tear what is stretched beyond the limit: all such seams, else the one worst edge; how many tears were made."""
        if self.asleep:
            return 0
        if torn := self._tear_seams():
            return torn
        # Cuts leave edges much shorter than the mesh's; their strain is numerical. Stretch is read over a gauge length, as in a test.
        gauge = np.maximum(self._solver.model.rest_length, TEAR_GAUGE * self.scene.tissue.fine_spacing)
        edges, x = self._topology.edges, self.positions
        stretch = np.linalg.norm(x[edges[:, 0]] - x[edges[:, 1]], axis=1) / gauge
        if self.grip is not None:
            gripped = np.zeros(len(self.mesh.rest), dtype=bool)
            gripped[self.grip.vertices] = True
            stretch[gripped[edges].any(axis=1)] = 0.0
        worst = int(np.argmax(stretch))
        if stretch[worst] < self.scene.tissue.tear_stretch:
            return 0
        middle, reach = crack_across(self.mesh.rest[self._topology.edges[worst]], float(gauge[worst]))
        ends = [self._crack_end(middle, end) for end in reach]
        before = len(self.mesh.cut_edges)
        self.cut([(np.stack([ends[0], middle, ends[1]]), 1.0)], torn=True)
        # Where the crack runs along lips that are open already nothing tears, however often it is tried.
        torn = int(len(self.mesh.cut_edges) > before)
        self.tears += torn
        return torn

    # ---------------------------------------------------------------- cutting

    def cut(self, stretches: list[tuple[Array, float]], torn: bool = False) -> None:
        """Cut the sheet along polylines (M, 2) in rest coordinates, each with the fraction (0..1] of its thickness that is severed."""
        if not stretches:
            return
        state = self._solver.state
        carried = np.column_stack([state.x, state.velocity]).astype(np.float64)
        for line, damage in stretches:
            carried = self.mesh.cut(line, damage, carried, torn)
        source = self.mesh.take_sources(len(state.x))
        self._adhesion_intact = (self._adhesion_intact & (state.adhesion > 0.0))[source]
        # Blades that pass through also sever what ties the lips to the bed there.
        self._adhesion_intact[self.mesh.lip_vertices()] = False
        topology = build_topology(self.mesh.rest, self.mesh.triangles)
        adhesion = _adhesion_density(self.scene, self.mesh.rest) * topology.vertex_area * self._adhesion_intact
        self._build(topology, SolverState(_f32(carried[:, :3]), _f32(carried[:, 3:]), _f32(adhesion)))
        self._resting = 0

    # ---------------------------------------------------------------- inside

    def _tear_seams(self) -> int:
        """What is left of a partly severed edge is a ligament about one thickness long: it fails when its lips are pulled apart farther."""
        model, x = self._solver.model, self._solver.state.x
        if not len(model.seams):
            return 0
        apart = np.linalg.norm(x[model.seams[:, 0]] - x[model.seams[:, 1]], axis=1)
        limit = (self.scene.tissue.tear_stretch - 1.0) * self.scene.tissue.thickness
        failed = np.flatnonzero((apart > limit) & (model.seam_stiffness > 0.0))
        for i in failed.tolist():
            self.mesh.tear_seam(i)
            model.seam_stiffness[i] = 0.0
        self.tears += len(failed)
        return len(failed)

    def _crack_end(self, start: Array, end: Array) -> Array:
        """Where a crack from `start` towards `end` stops: at a border or lip nearby, which attracts it, else at `end`."""
        topology = self._topology
        border = np.unique(topology.edges[(topology.edge_triangles < 0).any(axis=1)])
        near = self.mesh.rest[border]
        reach = np.linalg.norm(end - start)
        ahead = (near - start) @ (end - start) > 0.3 * reach**2
        distance = np.where(ahead, np.linalg.norm(near - end, axis=1), np.inf)
        best = int(np.argmin(distance))
        return np.asarray(near[best] if distance[best] < reach else end)

    def _rest_positions(self, rest: Array) -> Array:
        return np.column_stack([rest, bed_height(rest, self.scene.bump) + self.scene.tissue.thickness / 2])

    def _build(self, topology: Topology, state: SolverState) -> None:
        tissue = self.scene.tissue
        mesh = self.mesh
        rest3 = self._rest_positions(mesh.rest)
        Eh = tissue.youngs_modulus * tissue.thickness
        edges = topology.edges
        length = np.linalg.norm(rest3[edges[:, 0]] - rest3[edges[:, 1]], axis=1)
        # Lattice stiffness that reproduces the membrane's: k = 3 E h A_e / L^2, 0.87 E h on an even lattice.
        stiffness = 3.0 * Eh * np.maximum(topology.edge_share, 1e-9) / length**2
        dt = self._step / SUBSTEPS
        mass = MASS_RATIO * 0.87 * Eh * dt**2
        weight = tissue.density * tissue.thickness * topology.vertex_area
        gravity = weight[:, None] * self.scene.gravity() / mass
        seams = mesh.seams
        limit = np.where(_undermined(self.scene, mesh.rest), self.scene.bed.adhesion_limit, 1.0)
        model = SolverModel(
            edges=edges,
            rest_length=_f32(length),
            edge_compliance=_f32(1.0 / stiffness),
            hinges=topology.hinges,
            hinge_weights=_f32(topology.hinge_weights),
            hinge_compliance=_f32(1.0 / (tissue.bending * topology.hinge_scale)),
            anchor=_f32(rest3),
            adhesion_limit=_f32(limit),
            seams=np.array([(s.a, s.b) for s in seams], np.int32).reshape(-1, 2),
            seam_stiffness=_f32(np.array([_seam_stiffness(s, Eh, tissue.thickness) for s in seams])),
            gravity=_f32(gravity),
            mass=mass,
            grip_stiffness=GRIP_STIFFNESS,
            bump=self.scene.bump,
            clearance=tissue.thickness / 2,
        )
        self._topology = topology
        self._solver = SheetSolver(model, state)

    def _slip(self, grip: Grip, tip: Pose) -> None:
        """Vertices loaded beyond friction slide through the jaws; those that slid too far have left them."""
        stretch = self._solver.state.x[grip.vertices] - grip.target
        force = GRIP_STIFFNESS * np.linalg.norm(stretch, axis=1)
        over = force > grip.hold_force
        if not over.any():
            return
        slide = (1.0 - grip.hold_force / force[over])[:, None] * stretch[over]
        grip.offset[over] += 0.5 * slide @ tip.rotation()
        keep = np.linalg.norm(grip.offset - grip.origin, axis=1) < SLIP_RELEASE
        if not keep.all():
            grip.vertices, grip.origin, grip.offset, grip.target = (
                grip.vertices[keep],
                grip.origin[keep],
                grip.offset[keep],
                grip.target[keep],
            )
        if len(grip.vertices) < 3:
            self.grip = None


def crack_across(edge: Array, gauge: float) -> tuple[Array, Array]:
    """Middle (2,) of the overstretched `edge` (2, 2) in rest coordinates [m], and the two points (2, 2) that its crack goes for.

    The crack is as long as the `gauge` over which the stretch was read: one only as long as a very short edge would leave still
    shorter ones, and those would tear without end.
    """
    along = edge[1] - edge[0]
    middle, normal = edge.mean(axis=0), np.array([-along[1], along[0]]) / np.linalg.norm(along)
    return middle, middle + 1.1 * gauge * normal * np.array([[-1.0], [1.0]])


def _f32(values: Array) -> NDArray[np.float32]:
    return np.ascontiguousarray(values, dtype=np.float32)


def _seam_stiffness(seam: Seam, Eh: float, thickness: float) -> float:
    """A seam carries what is left of the thickness over its width: k = (1 - d) E h w / t, as a link one thickness long."""
    return (1.0 - seam.damage) * Eh * seam.width / thickness


def _undermined(scene: Scene, rest: Array) -> NDArray[np.bool_]:
    """Where the plane under the sheet was prepared: around the goal and up to the grasp."""
    reach = scene.bed.undermined_margin
    near = distance_to_line(rest, scene.line) < reach
    grasp = np.array(scene.goal.grasp)
    return np.asarray(near | (np.linalg.norm(rest - grasp, axis=1) < reach))


def _adhesion_density(scene: Scene, rest: Array) -> Array:
    """Adhesion stiffness (V,) [N/m per m^2] at rest coordinates."""
    return np.where(_undermined(scene, rest), scene.bed.undermined_adhesion, scene.bed.adhesion)


def _random_field(scene: Scene, seed: int) -> Array:
    """Puncture force over the sheet [N]: smooth noise of the scene's mean, variation and length scale, fixed by the seed."""
    tissue = scene.tissue
    cell = 0.5e-3
    shape = (int(tissue.height / cell) + 1, int(tissue.width / cell) + 1)
    noise = gaussian_filter(
        np.random.default_rng([seed, 71]).standard_normal(shape), tissue.puncture_scale / cell / 2, mode="wrap"
    )
    noise /= noise.std()
    return np.asarray(tissue.puncture_force * np.maximum(1.0 + tissue.puncture_variation * noise, 0.05))
