"""The simulated bench: tissue, two arms and a stereo endoscope under one clock. Implements `hardware.interface.Bench`."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from hardware.codes import InputError
from hardware.interface import CUTTER, GRASPER, Array, Pose
from hardware.stub.arms import ArmConfig, StubArm
from hardware.stub.endoscope import StubEndoscope
from hardware.stub.ligaments import ligaments
from hardware.stub.phantom import Phantom
from hardware.stub.scene import Scene
from hardware.stub.sheet_solver import bed_height
from hardware.stub.snip import BladeSweep, bed_depth, severed
from hardware.stub.surface import Ligaments, SheetSurface, ToolShape

STEP = 1.0 / 120.0  # [s]
STEPS_PER_TEAR_CHECK = 4
CLOSED_ON_TISSUE = np.deg2rad(12.0)  # a grasper's jaw below this holds what lies between
OPENED = np.deg2rad(18.0)  # and above this has let it go
LEAST_CLOSING = np.deg2rad(3.0)  # a smaller closing of the scissors severs nothing


class StubBench:
    """One scene with one seed. Everything random in it comes from that seed. Not thread-safe."""

    def __init__(self, scene: Scene, seed: int) -> None:
        self.scene = scene
        self.seed = seed
        draws = np.random.default_rng([seed, 1])
        config = scene.arms
        hold_force = max(0.5, config.grip_force + config.grip_variation * float(draws.standard_normal()))
        self._rotation, self._translation = scene.camera_from_table()
        self.phantom = Phantom(scene, seed, hold_force, STEP)
        self._half_cut: tuple[tuple[float, ...], Ligaments] = ((0,), Ligaments.none())
        self._steps = 0
        self._pressed = False
        self._observers: list[Callable[[], None]] = []
        self._arms = {
            name: StubArm(
                name,
                ArmConfig(
                    latency=config.latency,
                    bias=tuple((config.bias * draws.standard_normal(3)).tolist()),
                    backlash=config.backlash,
                    force_noise=config.force_noise,
                ),
                np.random.default_rng([seed, 2, number]),
                home,
                self.now,
            )
            for number, (name, home) in enumerate(self._homes().items())
        }
        self.endoscope = StubEndoscope(scene, seed, self)
        self._last_jaw = {name: arm.true_jaw() for name, arm in self._arms.items()}
        self._opened = self._last_jaw[CUTTER]

    # ------------------------------------------------------------ interface.Bench

    @property
    def arms(self) -> Mapping[str, StubArm]:
        """PSM1 with the grasper, PSM2 with the scissors."""
        return self._arms

    def now(self) -> float:
        """Bench time [s]."""
        return self._steps * STEP

    def advance(self, duration: float) -> None:
        """Let the physics run for `duration` [s], rounded to whole steps of 1/120 s."""
        for _ in range(max(1, round(duration / STEP))):
            self._step()

    def observe(self, callback: Callable[[], None]) -> None:
        """Call `callback` after every physics step."""
        self._observers.append(callback)

    def emergency_stop(self) -> bool:
        """Whether the emergency stop is pressed."""
        return self._pressed

    def close(self) -> None:
        """Hold both arms."""
        for arm in self._arms.values():
            arm.hold()

    # ------------------------------------------------------------ commanded faults

    def press_emergency_stop(self, pressed: bool = True) -> None:
        """Press or release the emergency stop; pressed, it takes the motors' power away."""
        self._pressed = pressed
        for arm in self._arms.values():
            arm.inject("power_off" if pressed else "clear")

    def inject(self, target: str, fault: str) -> None:
        """Command a fault of an arm (by name) or of the `endoscope`."""
        if target == "endoscope":
            self.endoscope.inject(fault)
        elif target in self._arms:
            self._arms[target].inject(fault)
        else:
            raise InputError(
                f"there is no {target!r} on the bench; faults can be injected into {', '.join([*self._arms, 'endoscope'])}"
            )

    # ------------------------------------------------------------ what the camera sees

    def surface(self) -> SheetSurface:
        """The tissue now, left camera frame."""
        positions = self.phantom.positions @ self._rotation.T + self._translation
        mesh = self.phantom.mesh
        return SheetSurface(
            positions.astype(np.float32),
            mesh.rest.astype(np.float32),
            mesh.triangles,
            mesh.revision,
            self.scene.tissue.thickness,
            self._ligaments(),
        )

    def tools(self) -> list[ToolShape]:
        """Both instruments where they truly are, left camera frame."""
        kinds = {GRASPER: "grasper", CUTTER: "scissors"}
        return [ToolShape(kinds[name], arm.true_pose(), arm.true_jaw()) for name, arm in self._arms.items()]

    def drawn_goal(self) -> tuple[Array, Array]:
        """What an expert would draw on the first image: the scene's goal line (M, 2) and grasp (2,) as pixels."""
        rest = np.vstack([self.scene.line, self.scene.goal.grasp])
        height = bed_height(rest, self.scene.bump) + self.scene.tissue.thickness / 2
        pixels = self.endoscope.camera.project(self.to_camera(np.column_stack([rest, height])))
        return pixels[:-1], pixels[-1]

    def to_camera(self, points: Array) -> Array:
        """Points (N, 3) [m] from the table frame to the left camera frame."""
        return np.asarray(np.asarray(points) @ self._rotation.T + self._translation)

    def to_table(self, points: Array) -> Array:
        """Points (N, 3) [m] from the left camera frame to the table frame."""
        return np.asarray((np.asarray(points) - self._translation) @ self._rotation)

    # ------------------------------------------------------------ inside

    def _step(self) -> None:
        pull = self._rotation @ self.phantom.grip_force()
        for name, arm in self._arms.items():
            arm.step(STEP, pull if name == GRASPER else np.zeros(3))
        self._steps += 1
        grasper = self._table_pose(self._arms[GRASPER].true_pose())
        self._follow_grasper(grasper)
        self._follow_scissors()
        self.phantom.advance(grasper)
        if self._steps % STEPS_PER_TEAR_CHECK == 0:
            self.phantom.tear()
        for callback in self._observers:
            callback()

    def _ligaments(self) -> Ligaments:
        """What holds half-cut lips together; worked out anew after a cut or a tear alone."""
        mesh = self.phantom.mesh
        state = (mesh.revision, *(seam.damage for seam in mesh.seams))
        if self._half_cut[0] != state:
            self._half_cut = (state, ligaments(mesh))
        return self._half_cut[1]

    def _follow_grasper(self, tip: Pose) -> None:
        jaw, last = self._arms[GRASPER].true_jaw(), self._last_jaw[GRASPER]
        if last > CLOSED_ON_TISSUE >= jaw and self.phantom.grip is None:
            self.phantom.grasp(tip)
        elif jaw > OPENED and jaw > last and self.phantom.grip is not None:
            self.phantom.release()
        self._last_jaw[GRASPER] = jaw

    def _follow_scissors(self) -> None:
        """Once the blades stop closing, what they swept is severed."""
        arm = self._arms[CUTTER]
        jaw, last = arm.true_jaw(), self._last_jaw[CUTTER]
        closing = jaw < last - 1e-9
        if not closing and self._opened - jaw > LEAST_CLOSING:
            sweep = BladeSweep(self._table_pose(arm.true_pose()), self._opened, jaw)
            self.phantom.bed_contact = max(self.phantom.bed_contact, bed_depth(self.phantom, sweep))
            self.phantom.cut(severed(self.phantom, sweep))
        if not closing:
            self._opened = jaw
        self._last_jaw[CUTTER] = jaw

    def _table_pose(self, pose: Pose) -> Pose:
        return Pose.from_matrix(self._rotation.T @ pose.rotation(), self.to_table(pose.position[None])[0])

    def _camera_pose(self, position: Array, forward: Array, opening: Array) -> Pose:
        turn = self._rotation
        return Pose.looking(self.to_camera(position[None])[0], turn @ forward, turn @ opening)

    def _homes(self) -> dict[str, Pose]:
        """Where the instruments wait: the grasper beyond the tissue, the scissors to the right, both clear of the goal."""
        half = np.array([self.scene.tissue.width, self.scene.tissue.height]) / 2
        sideways = np.array([1.0, 0.0, 0.0])
        grasper = np.array([0.0, 0.7 * half[1], 0.030])
        scissors = np.array([0.6 * half[0], 0.1 * half[1], 0.030])
        return {
            GRASPER: self._camera_pose(grasper, np.array([0.0, -0.5, -0.85]), sideways),
            CUTTER: self._camera_pose(scissors, np.array([-0.4, 0.0, -0.9]), sideways),
        }
