"""Speed of the stub's endoscope renderer beside Warp's mesh ray casting of the same frames.

Both draw the same moving scene, with the same mesh update and the same shading; only the way to the nearest triangle of each
pixel differs. Rounds are interleaved, so that a busy machine slows both alike. Run: `python -m benchmarks.render --json r.json`.
"""

import argparse
import json
import os
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import no_type_check

import numpy as np
import warp as wp
from numpy.typing import NDArray

from hardware.interface import CameraModel, Pose
from hardware.stub.renderer import DeviceMesh, Eye, Look, Renderer, Rendering
from hardware.stub.renderkernels import View
from hardware.stub.surface import BaseSurface, SheetSurface, ToolShape

wp.set_module_options({"enable_backward": False, "optimization_level": 3})

CAMERA = CameraModel(640, 480, 620.0, 319.5, 239.5, 0.0043)
LEVELS = 3  # two pixels differ when a channel differs by more than this
Floats = NDArray[np.float64]


@wp.kernel
@no_type_check
def cast_rays(mesh: wp.uint64, view: View, keys: wp.array(dtype=wp.uint64)):
    """The key of the nearest triangle along each pixel's ray, as the rasteriser would leave it."""
    pixel = wp.tid()
    column = pixel % view.width
    row = pixel // view.width
    ray = wp.normalize(wp.vec3((float(column) - view.cu) / view.focal, (float(row) - view.cv) / view.focal, 1.0))
    hit = wp.mesh_query_ray(mesh, wp.vec3(view.offset, 0.0, 0.0), ray, 10.0)
    if hit.result:
        inverse = 1.0 / (hit.t * ray[2])
        keys[pixel] = (wp.uint64(wp.cast(inverse, wp.uint32)) << wp.uint64(32)) | wp.uint64(hit.face + 1)


class RayCaster(Renderer):
    """The peer: `Renderer`, but with `wp.mesh_query_ray` in a bounding volume hierarchy, refitted at each frame."""

    _hierarchy: wp.Mesh | None = None
    _built_for: DeviceMesh | None = None

    def _placed(self, sheet: SheetSurface, tools: list[ToolShape]) -> DeviceMesh:  # type: ignore[override]
        scene = super()._placed(sheet, tools)
        if self._built_for is not scene:
            indices: wp.array = wp.array(scene.mesh.corners.reshape(-1), dtype=wp.int32, device="cpu")
            self._hierarchy, self._built_for = wp.Mesh(scene.vertices, indices), scene
        elif self._hierarchy is not None:
            self._hierarchy.refit()
        return scene

    def _find_visible(self, scene: DeviceMesh, eye: Eye) -> None:
        assert self._hierarchy is not None
        wp.launch(cast_rays, len(eye.keys), [self._hierarchy.id, eye.view], [eye.keys], device="cpu")


def to_camera(points: Floats) -> Floats:
    """Table coordinates (x right, y away, z up) to the left camera, 80 mm off and tilted by 30 degrees."""
    c, s = np.cos(np.radians(30)), np.sin(np.radians(30))
    right, forward = np.array([1.0, 0, 0]), np.array([0, s, -c])
    return np.asarray(np.stack([points @ right, points @ np.cross(forward, right), points @ forward + 0.08], axis=-1))


def grid(columns: int, rows: int, width: float, height: float) -> tuple[Floats, NDArray[np.int32]]:
    """Points (N, 2) of an even grid and its triangles."""
    x, y = np.meshgrid(np.linspace(-width / 2, width / 2, columns), np.linspace(-height / 2, height / 2, rows))
    i = np.arange(columns * rows).reshape(rows, columns)
    a, b, c, d = (part.reshape(-1) for part in (i[:-1, :-1], i[:-1, 1:], i[1:, :-1], i[1:, 1:]))
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)])
    return np.stack([x.reshape(-1), y.reshape(-1)], axis=1), triangles.astype(np.int32)


def bump(xy: Floats) -> Floats:
    """Height [m] of the bed: 6 mm high, 40 mm across."""
    r2 = (xy**2).sum(axis=1) / 0.02**2
    return np.where(r2 < 1, 0.006 * (1 - r2) ** 2, 0.0)


def bed() -> BaseSurface:
    """The rigid bed."""
    xy, triangles = grid(60, 60, 0.16, 0.16)
    points = to_camera(np.column_stack([xy, bump(xy) - 0.0012]))
    return BaseSurface(points.astype(np.float32), triangles, xy.astype(np.float32))


def scene(pull: float) -> tuple[SheetSurface, list[ToolShape]]:
    """An 80 x 60 mm sheet with a 40 mm cut but for two bridges, its far lip lifted by `pull` [m], and both instruments."""
    rest, triangles = grid(65, 49, 0.08, 0.06)
    count = len(rest)
    on_cut = (np.abs(rest[:, 1]) < 1e-6) & (np.abs(rest[:, 0]) < 0.0199) & (np.abs(np.abs(rest[:, 0]) - 0.009) > 9e-4)
    copies = np.flatnonzero(on_cut)
    copy_of = np.arange(count)
    copy_of[copies] = count + np.arange(len(copies))
    far = rest[triangles, 1].mean(axis=1) > 0
    triangles[far] = copy_of[triangles[far]]
    far_vertex = np.concatenate([rest[:, 1] > 1e-6, np.ones(len(copies), bool)])
    rest = np.concatenate([rest, rest[copies]])
    lift = pull * np.exp(-((rest[:, 0] ** 2 + (rest[:, 1] - 0.009) ** 2) / 0.012**2))
    lift *= np.where(far_vertex, 1.0, 0.15 * np.exp(-np.abs(rest[:, 1]) / 0.006))
    points = np.column_stack([rest[:, 0], rest[:, 1] + 0.6 * lift, bump(rest) + 2e-4 + 0.8 * lift])
    sheet = SheetSurface(to_camera(points).astype(np.float32), rest.astype(np.float32), triangles, 0, 0.0015)

    def pose(tip: list[float], forward: list[float], opening: list[float]) -> Pose:
        directions = to_camera(np.array([forward, opening, [0.0, 0.0, 0.0]]))
        return Pose.looking(to_camera(np.array(tip)), directions[0] - directions[2], directions[1] - directions[2])

    grasp = [0.0, 0.009 + 0.6 * pull, 0.005 + 0.8 * pull]
    return sheet, [
        ToolShape("grasper", pose(grasp, [-0.12, -0.35, -1.0], [1.0, 0.0, 0.0]), 0.12),
        ToolShape("scissors", pose([0.018, -0.002, 0.006], [-0.55, 0.25, -0.7], [1.0, 0.0, 0.7]), 0.5),
    ]


def differing(ours: Rendering, peer: Rendering) -> float:
    """Share of pixels of which a channel differs by more than `LEVELS`."""
    return float((np.abs(ours.image.astype(int) - peer.image).max(axis=2) > LEVELS).mean())


def timed(call: Callable[[], object], into: list[float]) -> None:
    """Run `call` and note its duration [s]."""
    start = time.perf_counter()
    call()
    into.append(time.perf_counter() - start)


def spread(seconds: list[float]) -> dict[str, float]:
    """Median, least and greatest duration [ms]."""
    return {name: round(1e3 * f(seconds), 2) for name, f in (("median", statistics.median), ("min", min), ("max", max))}


def measure(seconds: float) -> dict[str, object]:
    """Interleaved rounds for about `seconds` after both sides have compiled and warmed up."""
    look = Look(seed=1)
    ours, peer = Renderer(look, CAMERA, bed()), RayCaster(look, CAMERA, bed())
    shares = []
    for i, pull in enumerate((0.0, 0.008, 0.016)):
        sheet, tools = scene(pull)
        for a, b in zip(ours.render_pair(sheet, tools, i), peer.render_pair(sheet, tools, i), strict=True):
            shares.append(differing(a, b))
    eye: list[float] = []
    pair: list[float] = []
    ray_eye: list[float] = []
    ray_pair: list[float] = []
    end = time.perf_counter() + seconds
    sequence = 0
    while time.perf_counter() < end or sequence < 3:
        sheet, tools = scene(0.016 * (0.5 - 0.5 * np.cos(0.3 * sequence)))
        sequence += 1
        timed(lambda s=sheet, t=tools, n=sequence: ours.render(s, t, n), eye)  # type: ignore[misc]
        timed(lambda s=sheet, t=tools, n=sequence: ours.render_pair(s, t, n), pair)  # type: ignore[misc]
        timed(lambda s=sheet, t=tools, n=sequence: peer.render(s, t, n), ray_eye)  # type: ignore[misc]
        timed(lambda s=sheet, t=tools, n=sequence: peer.render_pair(s, t, n), ray_pair)  # type: ignore[misc]
    return {
        "stereo_pairs_per_s": round(1.0 / statistics.median(pair), 2),
        "ratio_raycast": round(statistics.median(ray_pair) / statistics.median(pair), 2),
        "ratio_raycast_one_eye": round(statistics.median(ray_eye) / statistics.median(eye), 2),
        "pixels_differing": max(shares),
        "pixels_differing_by_more_than_levels": LEVELS,
        "ms_per_eye": spread(eye),
        "ms_per_pair": spread(pair),
        "raycast_ms_per_eye": spread(ray_eye),
        "raycast_ms_per_pair": spread(ray_pair),
        "rounds": sequence,
        "image": [CAMERA.width, CAMERA.height],
        "cores": len(os.sched_getaffinity(0)),
    }


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--json", type=Path, help="write the figures to this file")
    parser.add_argument("--seconds", type=float, default=20.0, help="how long to measure (default 20)")
    options = parser.parse_args()
    figures = measure(options.seconds)
    text = json.dumps(figures, indent=2)
    if options.json is not None:
        options.json.write_text(text + "\n")
    print(text)


if __name__ == "__main__":
    main()
