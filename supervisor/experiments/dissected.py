"""Tissue that was dissected before an experiment begins, the goal an expert draws on it, and which material is seen where.

Only experiments and tests may ask for the material: it is the truth of the mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from hardware.interface import GRASPER, Array
from hardware.stub.bench import StubBench
from hardware.stub.renderer import Label
from hardware.stub.scene import Scene
from skills.scene.goal import Goal
from skills.tracking.model_based import raycast

BESIDE = 0.8e-3  # [m] from the goal's line to the tissue on either side that says where the line is now
SETTLED = 0.5  # [s] after which the cut tissue lies still


def dissected_bench(scene: Scene, cuts: Sequence[tuple[float, float, float]], grasp: tuple[float, float], seed: int) -> StubBench:
    """A bench whose tissue is cut already, to be grasped at `grasp` [m] in rest coordinates.

    Each of `cuts` is a stretch of the goal, from share a to b of its length, with the part (0..1] of the thickness that is severed.
    The expert draws the goal along the cut that is seen; over the bed's bump that is a curve in the image.
    """
    line = tuple((float(x), float(y)) for x, y in stretch(scene.line, 0.0, 1.0))
    bench = StubBench(replace(scene, goal=replace(scene.goal, line=line, grasp=grasp)), seed)
    for a, b, damage in cuts:
        bench.phantom.cut([(stretch(scene.line, a, b), damage)])
    bench.advance(SETTLED)
    return bench


def goal_on_the_cut(bench: StubBench) -> Goal:
    """What an expert would draw now, on tissue that has moved: along the cut, midway between the tissue on its two sides."""
    scene, phantom, camera = bench.scene, bench.phantom, bench.endoscope.camera
    line = scene.line
    chord = line[-1] - line[0]
    normal = np.array([-chord[1], chord[0]]) / np.linalg.norm(chord)
    tangent = np.array([normal[1], -normal[0]])
    # Height above the line as a curve over its own chord: the sides of a curved goal are not those of a straight one.
    off = phantom.mesh.rest @ normal - np.interp(phantom.mesh.rest @ tangent, line @ tangent, line @ normal)
    sides = []
    for sign in (1.0, -1.0):
        here = np.flatnonzero(sign * off > 0.25 * BESIDE)
        distance, nearest = cKDTree(phantom.mesh.rest[here]).query(line + sign * BESIDE * normal, k=3)
        weights = 1.0 / np.maximum(distance, 1e-6)
        weights = weights / weights.sum(axis=1, keepdims=True)
        sides.append((weights[:, :, None] * phantom.positions[here[nearest]]).sum(axis=1))
    middle = (sides[0] + sides[1]) / 2.0 + np.array([0.0, 0.0, scene.tissue.thickness / 2])
    grasp = bench.arms[GRASPER].true_pose().position
    return Goal(camera.project(bench.to_camera(middle)), camera.project(grasp[None])[0], (camera.width, camera.height))


def stretch(line: Array, a: float, b: float) -> Array:
    """The part of the polyline `line` (M, 2) from share `a` to `b` of its length."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    at = np.unique(np.concatenate([np.linspace(a, b, 12), (arc / arc[-1])[(arc / arc[-1] > a) & (arc / arc[-1] < b)]])) * arc[-1]
    return np.column_stack([np.interp(at, arc, line[:, k]) for k in (0, 1)])


def rest_coordinates(bench: StubBench, pixels: Array) -> Array:
    """Rest coordinates (N, 2) [m] of the tissue at `pixels` (N, 2) now: what is seen there, or what a tool hides; beside a gap its lip.

    A keypoint under a tool is a point of the tissue all the same, and on its own side of the goal.
    """
    surface, camera = bench.surface(), bench.endoscope.camera
    positions, triangles = surface.positions.astype(np.float64), surface.triangles
    rendering = bench.endoscope.rendering()
    nearest = np.clip(np.rint(pixels).astype(np.int64), 0, [camera.width - 1, camera.height - 1])
    # Without the tools: rays onto the tissue's upper face, half a thickness above the mesh.
    beneath = raycast(pixels, positions + surface.thickness / 2 * _normals(positions, triangles), triangles, camera)
    rest = np.full((len(pixels), 2), np.nan)
    hidden = (rendering.label[nearest[:, 1], nearest[:, 0]] == Label.TOOL) & beneath.on_mesh
    corners = triangles[beneath.triangle[hidden]]
    rest[hidden] = (beneath.barycentric[hidden][:, :, None] * surface.rest[corners]).sum(axis=1)
    v, u = np.nonzero(rendering.triangle >= 0)
    _, closest = cKDTree(np.column_stack([u, v])).query(pixels[~hidden])
    at = np.column_stack([u, v])[closest]
    corners = triangles[rendering.triangle[at[:, 1], at[:, 0]]]
    points = camera.unproject(at.astype(float), rendering.depth[at[:, 1], at[:, 0]].astype(np.float64))
    weights = _barycentric(points, positions[corners])
    rest[~hidden] = (weights[:, :, None] * surface.rest[corners]).sum(axis=1)
    return rest


def _normals(positions: Array, triangles: NDArray[np.int32]) -> Array:
    """Unit normals (V, 3) of the sheet towards the camera."""
    a, b, c = (positions[triangles[:, k]] for k in range(3))
    face = np.cross(b - a, c - a)
    normals = np.zeros_like(positions)
    for k in range(3):
        np.add.at(normals, triangles[:, k], face)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    return np.asarray(np.where((normals * positions).sum(axis=1, keepdims=True) > 0, -normals, normals))


def _barycentric(points: Array, corners: Array) -> Array:
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    u, v, w = b - a, c - a, points - a
    uu, vv, uv, uw, vw = ((p * q).sum(1) for p, q in ((u, u), (v, v), (u, v), (u, w), (v, w)))
    determinant = np.maximum(uu * vv - uv * uv, 1e-30)
    s, t = (vv * uw - uv * vw) / determinant, (uu * vw - uv * uw) / determinant
    weights = np.clip(np.column_stack([1.0 - s - t, s, t]), 0.0, 1.0)
    return np.asarray(weights / weights.sum(axis=1, keepdims=True))
