# mypy: ignore-errors
# (the body of a kernel is Warp's language in Python's clothes; Warp's own compiler checks its types)
"""The Warp kernel of the visibility losses: one thread per horizon step and block of samples, all its samples at once.

It is written once and compiled for both layouts of a trajectory. On a processor a block holds 8 samples side by side, so that one
vector instruction serves all of them; on a GPU a block is one sample, and neighbouring threads read neighbouring samples. All that
knows the layout is in the three small accessors of `visibility_kernel`.
"""

from functools import cache
from typing import Any

import numpy as np
import warp as wp

BLOCK = 8
Points8 = wp.types.matrix(shape=(3, BLOCK), dtype=wp.float32)

ZERO_AREA = wp.constant(1e-20)  # [m^4] square of twice the area below which a triangle has no normal: rounding alone gives 1e-21
LEAST_DEPTH = wp.constant(1e-6)  # [m] divides instead of smaller depths; such pixels are invisible, and stay finite


@wp.struct
class Lattice:
    """The tracked pixels, column by column along the goal, far to near in each; only those that are used."""

    corners: wp.array(dtype=wp.vec3i)  # (N,) vertices of each pixel's triangle
    barycentric: wp.array(dtype=wp.vec3)  # (N,)
    # Pixels with a deformation gradient (D,): differences from .x to .y (across) and from .z to .w (along); n'Fn and n'Fm are
    # these differences' parts along n, weighted by `stretch` and `shear`.
    ends: wp.array(dtype=wp.vec4i)
    normal: wp.array(dtype=wp.vec2)
    stretch: wp.array(dtype=wp.vec2)
    shear: wp.array(dtype=wp.vec2)
    # Columns (C,): pixels .x to .y lie on the far side, .y to .z on the near one; far lip between vertices .x and .y, near lip
    # between .z and .w (-1: no lip), `share` of the way; what the gap measures when closed, and the width that counts.
    span: wp.array(dtype=wp.vec3i)
    direction: wp.array(dtype=wp.vec2)
    origin: wp.array(dtype=wp.vec2)
    lips: wp.array(dtype=wp.vec4i)
    share: wp.array(dtype=wp.float32)
    closed: wp.array(dtype=wp.float32)
    width: wp.array(dtype=wp.float32)


@wp.struct
class Lens:
    """The camera's focal length and principal point, and the image's size. All [px]."""

    focal: float
    cu: float
    cv: float
    width: float
    height: float


@wp.struct
class Loss:
    """Weights of the deformation expanding loss; `folds_cost` other than 0 takes n'Fn |n'Fn| where the paper has (n'Fn)^2."""

    w_n: float
    w_s: float
    folds_cost: int


def lanes_of(trajectory: wp.array) -> int:
    """How many samples a block of `trajectory` holds: 8 for (h, K / 8, V) of 3x8 matrices, 1 for (h, V, K) of vec3.

    Raises:
        ValueError: it is neither.
    """
    if trajectory.ndim == 3 and wp.types.types_equal(trajectory.dtype, Points8):
        return BLOCK
    if trajectory.ndim == 3 and wp.types.types_equal(trajectory.dtype, wp.vec3):
        return 1
    raise ValueError("a trajectory is a Warp array (h, K / 8, V) of 3x8 float32 matrices or (h, V, K) of vec3")


def blocks_of(trajectory: wp.array) -> tuple[int, int]:
    """How many blocks and how many vertices `trajectory` has."""
    _, second, third = trajectory.shape
    return (second, third) if lanes_of(trajectory) == BLOCK else (third, second)


def pack(positions: np.ndarray, lanes: int, device: str = "cpu") -> wp.array:
    """Lay `positions` (h, K, V, 3) [m] out as a trajectory with `lanes` (8 or 1) samples per block; the last one fills it up."""
    x = np.asarray(positions, np.float32)
    if lanes == 1:
        return wp.array(np.ascontiguousarray(x.transpose(0, 2, 1, 3)), dtype=wp.vec3, device=device)
    steps, count, vertices, _ = x.shape
    x = np.pad(x, ((0, 0), (0, -count % BLOCK), (0, 0), (0, 0)), mode="edge")
    x = x.reshape(steps, -1, BLOCK, vertices, 3).transpose(0, 1, 3, 4, 2)
    return wp.array(np.ascontiguousarray(x), dtype=Points8, device=device)


def scratch(trajectory: wp.array, pixels: int) -> wp.array:
    """Make room for where `pixels` tracked pixels are in every step and sample of `trajectory`."""
    lanes, (blocks, _) = lanes_of(trajectory), blocks_of(trajectory)
    shape = (trajectory.shape[0], blocks, pixels) if lanes == BLOCK else (trajectory.shape[0], pixels, blocks)
    return wp.empty(shape, dtype=wp.types.matrix(shape=(2, lanes), dtype=wp.float32), device=trajectory.device)


def terms_array(trajectory: wp.array) -> wp.array:
    """Make the array that the kernel writes: (h, blocks) of camera, deform, opening and visible, each for the block's samples."""
    shape = (trajectory.shape[0], blocks_of(trajectory)[0])
    return wp.empty(shape, dtype=wp.types.matrix(shape=(4, lanes_of(trajectory)), dtype=wp.float32), device=trajectory.device)


@cache
def visibility_kernel(lanes: int) -> Any:
    """Make the kernel for blocks of `lanes` samples."""
    Lanes = wp.types.vector(length=lanes, dtype=wp.float32)
    Points = wp.types.matrix(shape=(3, lanes), dtype=wp.float32)
    Pixels = wp.types.matrix(shape=(2, lanes), dtype=wp.float32)
    Out = wp.types.matrix(shape=(4, lanes), dtype=wp.float32)
    COUNT = wp.constant(lanes)

    if lanes == BLOCK:
        Trajectory = wp.array(dtype=Points, ndim=3)
        Scratch = wp.array(dtype=Pixels, ndim=3)

        @wp.func
        def vertex(x: Trajectory, t: int, block: int, v: int) -> Points:
            return x[t, block, v]

        @wp.func
        def pixel(p: Scratch, t: int, block: int, i: int) -> Pixels:
            return p[t, block, i]

        @wp.func
        def keep(p: Scratch, t: int, block: int, i: int, value: Pixels):
            p[t, block, i] = value

    else:
        Trajectory = wp.array(dtype=wp.vec3, ndim=3)
        Scratch = wp.array(dtype=Pixels, ndim=3)

        @wp.func
        def vertex(x: Trajectory, t: int, block: int, v: int) -> Points:
            p = x[t, v, block]
            column = Points()
            for axis in range(3):
                column[axis, 0] = p[axis]
            return column

        @wp.func
        def pixel(p: Scratch, t: int, block: int, i: int) -> Pixels:
            return p[t, i, block]

        @wp.func
        def keep(p: Scratch, t: int, block: int, i: int, value: Pixels):
            p[t, i, block] = value

    @wp.func
    def project(x: Points, lens: Lens) -> Pixels:
        scale = Lanes()
        for j in range(COUNT):
            scale[j] = lens.focal / wp.max(x[2, j], LEAST_DEPTH)
        u, v = wp.cw_mul(x[0], scale), wp.cw_mul(x[1], scale)
        for j in range(COUNT):
            u[j] += lens.cu
            v[j] += lens.cv
        return wp.matrix_from_rows(u, v)

    @wp.func
    def across(p: Pixels, origin: wp.vec2, direction: wp.vec2) -> Lanes:
        """How far `p` lies from `origin` along `direction`."""
        s = Lanes()
        for j in range(COUNT):
            s[j] = (p[0, j] - origin[0]) * direction[0] + (p[1, j] - origin[1]) * direction[1]
        return s

    @wp.func
    def along(a: Pixels, b: Pixels, n: wp.vec2) -> Lanes:
        """What the step from `a` to `b` measures along `n`."""
        return n[0] * (b[0] - a[0]) + n[1] * (b[1] - a[1])

    @wp.func
    def deform_at(p: Scratch, t: int, block: int, lattice: Lattice, k: int, loss: Loss) -> Lanes:
        """One pixel's deformation expanding loss, -w_n (n'Fn)^2 + w_s (n'Fm)^2."""
        e, n = lattice.ends[k], lattice.normal[k]
        d_across = along(pixel(p, t, block, e[0]), pixel(p, t, block, e[1]), n)
        d_along = along(pixel(p, t, block, e[2]), pixel(p, t, block, e[3]), n)
        stretch = lattice.stretch[k][0] * d_across + lattice.stretch[k][1] * d_along
        shear = lattice.shear[k][0] * d_across + lattice.shear[k][1] * d_along
        size = stretch
        if loss.folds_cost != 0:
            size = wp.max(stretch, -stretch)
        return loss.w_s * wp.cw_mul(shear, shear) - loss.w_n * wp.cw_mul(stretch, size)

    @wp.func
    def opening_at(x: Trajectory, p: Scratch, t: int, block: int, lattice: Lattice, lens: Lens, c: int) -> Lanes:
        """One column's opened area: the gap between the far side's nearest reach and the near side's farthest, by its width."""
        span, lips = lattice.span[c], lattice.lips[c]
        origin, direction = lattice.origin[c], lattice.direction[c]
        far, near = Lanes(), Lanes()
        if lips[0] >= 0:
            s = lattice.share[c]
            a = (1.0 - s) * vertex(x, t, block, lips[0]) + s * vertex(x, t, block, lips[1])
            b = (1.0 - s) * vertex(x, t, block, lips[2]) + s * vertex(x, t, block, lips[3])
            far = across(project(a, lens), origin, direction)
            near = across(project(b, lens), origin, direction)
        else:
            far = across(pixel(p, t, block, span[0]), origin, direction)
            near = across(pixel(p, t, block, span[1]), origin, direction)
        for i in range(span[0], span[1]):
            far = wp.max(far, across(pixel(p, t, block, i), origin, direction))
        for i in range(span[1], span[2]):
            near = wp.min(near, across(pixel(p, t, block, i), origin, direction))
        gap = near - far
        for j in range(COUNT):
            gap[j] = wp.max(gap[j] - lattice.closed[c], 0.0)
        return lattice.width[c] * gap

    @wp.kernel(
        module="unique",
        enable_backward=False,
        module_options={"cpu_compiler_flags": wp.config.cpu_compiler_flags or "-march=native"},
    )
    def visibility(
        trajectory: Trajectory,
        pixels: Scratch,
        lattice: Lattice,
        lens: Lens,
        loss: Loss,
        first: int,
        out: wp.array(dtype=Out, ndim=2),
    ):
        t, block = wp.tid()
        block += first

        facing, outside = Lanes(), Lanes()
        for i in range(lattice.corners.shape[0]):
            corner, weight = lattice.corners[i], lattice.barycentric[i]
            a = vertex(trajectory, t, block, corner[0])
            ab = vertex(trajectory, t, block, corner[1]) - a
            ac = vertex(trajectory, t, block, corner[2]) - a
            point = a + weight[1] * ab + weight[2] * ac
            p = project(point, lens)
            keep(pixels, t, block, i, p)
            normal_x = wp.cw_mul(ab[1], ac[2]) - wp.cw_mul(ab[2], ac[1])
            normal_y = wp.cw_mul(ab[2], ac[0]) - wp.cw_mul(ab[0], ac[2])
            normal_z = wp.cw_mul(ab[0], ac[1]) - wp.cw_mul(ab[1], ac[0])
            square = wp.cw_mul(normal_x, normal_x) + wp.cw_mul(normal_y, normal_y) + wp.cw_mul(normal_z, normal_z)
            for j in range(COUNT):
                # w_c is the z axis, so n'w_c is the third component of the unit normal.
                facing[j] += wp.where(square[j] > ZERO_AREA, normal_z[j] / wp.sqrt(wp.max(square[j], ZERO_AREA)), 0.0)
                # Written so that a pixel that is not a number is outside too.
                u, v = p[0, j], p[1, j]
                inside = u >= 0.0 and u < lens.width and v >= 0.0 and v < lens.height and point[2, j] > 0.0
                outside[j] += wp.where(inside, 0.0, 1.0)

        deform = Lanes()
        for k in range(lattice.ends.shape[0]):
            deform += deform_at(pixels, t, block, lattice, k, loss)

        opening = Lanes()
        for c in range(lattice.span.shape[0]):
            opening += opening_at(trajectory, pixels, t, block, lattice, lens, c)

        facing = facing / float(lattice.corners.shape[0])
        deform = deform / float(wp.max(lattice.ends.shape[0], 1))
        visible = Lanes()
        for j in range(COUNT):
            visible[j] = wp.where(outside[j] == 0.0, 1.0, 0.0)
        out[t, block] = wp.matrix_from_rows(facing, deform, opening, visible)

    return visibility
