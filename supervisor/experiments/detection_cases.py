"""What a seed of the detection experiment draws: the tissue, how it was cut, the expert's grasp and pull, and one disturbance.

Materials, cuts and disturbances go in turn, so that any 36 seeds in a row hold each combination once; all else is drawn.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from hardware.interface import Array
from hardware.stub.bench import StubBench
from hardware.stub.scene import Scene, load_scene
from supervisor.experiments.dissected import dissected_bench, stretch
from supervisor.experiments.disturbances import (
    Blob,
    Dimmer,
    Disturbance,
    Effect,
    Highlights,
    MotionBlur,
    Occlusion,
    Roll,
    RolledScene,
)

MATERIALS = ("silicone", "beef", "chicken")
CURVED_EVERY = 5  # seeds; their goal is the arc of the scene `curved`
ATTACHED = (1e-3, 6e-3)  # [m], each of one or two stretches that no blade reached
HALF_CUT = (2e-3, 6e-3)  # [m], each of one or two stretches that it severed only in part
DAMAGE = (0.3, 0.9)  # there, share of the thickness
OVERLAP = 0.0125  # share of the goal, half a millimetre, by which these reach into the full cut beside them
APART = 2e-3  # [m] of full cut between stretches
GRASP_AWAY = (4e-3, 9e-3)  # [m] of the grasp from the goal
GRASP_ALONG = 4e-3  # [m] of the grasp along the goal to either side of its middle
LIFT = (0.5e-3, 2.0e-3)  # [m] of the tissue before the pull, at t_d
STEPS = (12, 20)  # of the pull, half a millimetre each
ROLL = (10.0, 40.0)  # [degrees] to either side
DIMMED = 0.3  # share of the light


@dataclass(frozen=True)
class Case:
    """One case. Stretches are shares 0..1 of the goal's length, `half_cut` with the damage; lengths [m]; `grasp` in rest coordinates."""

    seed: int
    scene: str
    curved: bool
    attached: tuple[tuple[float, float], ...]
    half_cut: tuple[tuple[float, float, float], ...]
    grasp: tuple[float, float]
    away: float
    along: float
    lift: float
    steps: int
    disturbance: Disturbance
    effect: Effect

    @property
    def cut(self) -> str:
        """`fully` or `partly`."""
        return "partly" if self.attached or self.half_cut else "fully"

    @property
    def cuts(self) -> list[tuple[float, float, float]]:
        """Stretches that a blade reached, with the part of the thickness it severed; the full ones first."""
        spared = sorted([*self.attached, *((a, b) for a, b, _ in self.half_cut)])
        starts, ends = [0.0, *(b for _, b in spared)], [*(a for a, _ in spared), 1.0]
        full = [(a, b, 1.0) for a, b in zip(starts, ends, strict=True) if b - a > 1e-3]
        # The full ones first: a later one that ends at a seam would sever that too. The others reach into them, so that the mesh, whose
        # cuts end at its vertices, keeps no strand between.
        return [*full, *((max(a - OVERLAP, 0.0), min(b + OVERLAP, 1.0), damage) for a, b, damage in self.half_cut)]


def draw(seed: int) -> Case:
    """Draw the case of `seed`."""
    rng = np.random.default_rng([seed, 19])
    name, curved = MATERIALS[seed % len(MATERIALS)], seed % CURVED_EVERY == CURVED_EVERY - 1
    line = _scene(name, curved).line
    length = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
    partly = seed // len(MATERIALS) % 2 == 1
    attached, half_cut = _stretches(length, rng) if partly else ((), ())
    away, along = float(rng.uniform(*GRASP_AWAY)), float(rng.uniform(-GRASP_ALONG, GRASP_ALONG))
    kinds = list(Disturbance)
    # One further on after each round, so that a disturbance does not stay with its material.
    disturbance = kinds[(seed + seed // len(kinds)) % len(kinds)]
    steps = int(rng.integers(STEPS[0], STEPS[1] + 1))
    return Case(
        seed=seed,
        scene=name,
        curved=curved,
        attached=attached,
        half_cut=half_cut,
        grasp=_beside(line, length, away, along),
        away=away,
        along=along,
        lift=float(rng.uniform(*LIFT)),
        steps=steps,
        disturbance=disturbance,
        effect=_effect(disturbance, seed, steps, rng),
    )


def scene_of(case: Case) -> Scene:
    """The case's scene: its material, its goal, its camera."""
    scene = _scene(case.scene, case.curved)
    if not isinstance(case.effect, Roll):
        return scene
    parts = {field.name: getattr(scene, field.name) for field in fields(scene)}
    return RolledScene(**parts, roll=float(np.radians(case.effect.degrees)))


def bench_of(case: Case) -> StubBench:
    """The case's bench, its tissue cut."""
    return dissected_bench(scene_of(case), case.cuts, case.grasp, case.seed)


# ------------------------------------------------------------ inside


def _scene(material: str, curved: bool) -> Scene:
    """The material's scene; a curved goal is that of the scene `curved`, on any material."""
    scene = load_scene(material)
    return replace(scene, goal=replace(scene.goal, line=load_scene("curved").goal.line)) if curved else scene


def _stretches(
    length: float, rng: np.random.Generator
) -> tuple[tuple[tuple[float, float], ...], tuple[tuple[float, float, float], ...]]:
    """One or two stretches left attached and one or two cut in part, in any order along the goal of `length` [m]."""
    attached, half = int(rng.integers(1, 3)), int(rng.integers(1, 3))
    lengths = np.concatenate([rng.uniform(*ATTACHED, attached), rng.uniform(*HALF_CUT, half)])
    damage = np.concatenate([np.zeros(attached), rng.uniform(*DAMAGE, half)])
    order = rng.permutation(len(lengths))
    lengths, damage = lengths[order], damage[order]
    # What is left of the goal goes to both ends and between, evenly over all ways to share it out.
    free = length - lengths.sum() - APART * (len(lengths) - 1)
    gaps = free * rng.dirichlet(np.ones(len(lengths) + 1))
    starts = np.cumsum(gaps[:-1]) + np.concatenate([[0.0], np.cumsum(lengths[:-1] + APART)])
    placed = [(float(a / length), float((a + b) / length), float(d)) for a, b, d in zip(starts, lengths, damage, strict=True)]
    return tuple((a, b) for a, b, d in placed if not d), tuple((a, b, d) for a, b, d in placed if d)


def _beside(line: Array, length: float, away: float, along: float) -> tuple[float, float]:
    """The point `away` [m] from the goal, on the far side from the camera, `along` [m] from its middle."""
    here, ahead = (stretch(line, 0.0, 0.5 + (along + d) / length)[-1] for d in (-0.5e-3, 0.5e-3))
    tangent = (ahead - here) / np.linalg.norm(ahead - here)
    point = (here + ahead) / 2 + away * np.array([-tangent[1], tangent[0]])
    return float(point[0]), float(point[1])


def _effect(disturbance: Disturbance, seed: int, steps: int, rng: np.random.Generator) -> Effect:
    """How the disturbance comes about in this case; the goal lies across the middle of the image."""
    match disturbance:
        case Disturbance.OCCLUSION:
            # They are on their way for about six steps.
            begin = int(rng.integers(1, steps // 3 + 1))
            leaves = rng.random() < 0.5
            until = int(rng.integers(begin + 8, steps + 1)) if leaves else None
            return Occlusion(float(rng.uniform(0.15, 0.85)), float(rng.uniform(11e-3, 16e-3)), begin, until)
        case Disturbance.HIGHLIGHTS:
            return Highlights(tuple(_blob(rng) for _ in range(int(rng.integers(2, 6)))), float(rng.uniform(0.5, 2.0)))
        case Disturbance.DIMMER:
            return Dimmer(int(rng.integers(1, steps)), DIMMED)
        case Disturbance.BLUR:
            return MotionBlur(seed, float(rng.uniform(0.3, 0.6)), (2.0, 7.0))
        case Disturbance.ROTATION:
            return Roll(float(rng.choice([-1.0, 1.0]) * rng.uniform(*ROLL)))
        case Disturbance.NONE:
            return None


def _blob(rng: np.random.Generator) -> Blob:
    """A highlight somewhere about the goal, a few millimetres wide; its depth is not the tissue's."""
    return Blob(
        centre=(float(rng.uniform(160, 480)), float(rng.uniform(180, 300))),
        swing=(float(rng.uniform(10, 50)), float(rng.uniform(5, 30))),
        period=float(rng.uniform(3.0, 8.0)),
        phase=float(rng.uniform(0.0, 2 * np.pi)),
        radius=(float(rng.uniform(4, 11)), float(rng.uniform(3, 8))),
        shift=float(rng.uniform(28, 40)),
    )
