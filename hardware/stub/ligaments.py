"""What a cut that went only part of the way through has left between its lips, for the camera: one ligament per seam.

A seam holds its half of a cut edge, and so long is its ligament. Towards the tip of a cut it goes on to the tip, where whole tissue holds
the other half. The lips are looked up on the mesh as it is now, because later cuts may have divided them.
"""

from collections.abc import Callable

import numpy as np

from hardware.stub.cutting import Seam, SheetMesh
from hardware.stub.rendermesh import boundary_edges
from hardware.stub.surface import Ligaments

Point = tuple[float, float]


def ligaments(mesh: SheetMesh) -> Ligaments:
    """The ligaments of all seams of `mesh` that still hold something, in the order of the seams."""
    held = [seam for seam in mesh.seams if seam.damage < 1.0]
    if not held:
        return Ligaments.none()
    depth_at = {frozenset((seam.a, seam.b)): seam.damage for seam in held}
    halves: dict[int, int] = {}
    for seam in mesh.seams:
        halves[id(seam.edge)] = halves.get(id(seam.edge), 0) + 1
    lip = _lips(mesh)
    ends, reach, depth = [], [], []
    for seam in held:
        here, there = _directed(mesh, seam)
        (left, far_left), (far_right, right) = lip(here, there), lip(there, here)
        far = frozenset((far_left, far_right))
        # The other half belongs to a seam of its own, or to whole tissue at the tip, or to a later cut that went on from there.
        whole = halves[id(seam.edge)] == 1 and (len(far) == 1 or far in depth_at)
        ends.append((left, right, far_left, far_right))
        reach.append(1.0 if whole else 0.5)
        depth.append((seam.damage, depth_at.get(far, seam.damage)))
    return Ligaments(np.array(ends, np.int32), np.array(reach, np.float32), np.array(depth, np.float32))


def _directed(mesh: SheetMesh, seam: Seam) -> tuple[Point, Point]:
    """The ends of the seam's cut edge in rest coordinates, its own first."""
    a, b = seam.edge.a, seam.edge.b
    return (a, b) if tuple(mesh.rest[seam.a].tolist()) == a else (b, a)


def _lips(mesh: SheetMesh) -> Callable[[Point, Point], tuple[int, int]]:
    """Gives the vertices at `a` and at `b` of the lip that runs from rest point `a` to `b` with its tissue on the left.

    Both sides of a cut have the same rest coordinates to the last bit: a lip's vertices are never moved. A lip that was divided since
    begins and ends with edges in the direction of the whole.
    """
    edges = boundary_edges(mesh.triangles)
    run = mesh.rest[edges[:, 1]] - mesh.rest[edges[:, 0]]
    run /= np.linalg.norm(run, axis=1, keepdims=True)
    leaving: dict[Point, list[tuple[Point, int]]] = {}
    arriving: dict[Point, list[tuple[Point, int]]] = {}
    for (u, v), from_, to, way in zip(
        edges.tolist(), mesh.rest[edges[:, 0]].tolist(), mesh.rest[edges[:, 1]].tolist(), run.tolist(), strict=True
    ):
        leaving.setdefault(tuple(from_), []).append((tuple(way), u))
        arriving.setdefault(tuple(to), []).append((tuple(way), v))

    def lip(a: Point, b: Point) -> tuple[int, int]:
        def along(edge: tuple[Point, int]) -> float:
            return edge[0][0] * (b[0] - a[0]) + edge[0][1] * (b[1] - a[1])

        return max(leaving[a], key=along)[1], max(arriving[b], key=along)[1]

    return lip
