# mypy: ignore-errors
# (the body of a kernel is Warp's language in Python's clothes; Warp's own compiler checks its types)
"""The solver on a processor: one thread rolls out a block of 8 samples, so that a constraint is projected for 8 samples at once.

A block's arrays interleave its samples ([K / 8, V] of 8-wide vectors): every operation below is one vector instruction for all 8, and
what a block touches stays in its core's cache. No operation mixes lanes, so a sample's result does not depend on its neighbours.
"""

import warp as wp

from skills.expose.xpbd_sheet import Sheet

# Warp's own flags also limit how far the compiler looks for vectors, which costs a sixth here. No gradient is ever taken.
wp.set_module_options({"enable_backward": False, "cpu_compiler_flags": "-march=native"})

LANES = 8
lanes = wp.types.vector(length=8, dtype=wp.float32)  # one number of 8 samples
points = wp.types.matrix(shape=(3, 8), dtype=wp.float32)  # one point of 8 samples: a row for each coordinate


@wp.struct
class Blocks:
    """What each block of 8 samples has of its own; first index: the block."""

    x: wp.array2d(dtype=points)
    controls: wp.array2d(dtype=points)  # (B, h)
    adhesion: wp.array2d(dtype=lanes)  # (B, A)
    seam: wp.array2d(dtype=lanes)  # (B, S) [N/m]
    edge_force: wp.array2d(dtype=lanes)
    hinge_force: wp.array2d(dtype=points)
    seam_force: wp.array2d(dtype=points)
    bed_force: wp.array2d(dtype=points)
    trajectory: wp.array3d(dtype=points)  # (h, B, V)
    tension: wp.array2d(dtype=lanes)  # (h, B)
    strain: wp.array2d(dtype=lanes)  # (h, B)


@wp.func
def root(v: lanes) -> lanes:
    """Square root of each lane."""
    return lanes(
        wp.sqrt(v[0]), wp.sqrt(v[1]), wp.sqrt(v[2]), wp.sqrt(v[3]), wp.sqrt(v[4]), wp.sqrt(v[5]), wp.sqrt(v[6]), wp.sqrt(v[7])
    )


@wp.func
def dot(a: points, b: points) -> lanes:
    """Scalar product of each lane."""
    return wp.cw_mul(a[0], b[0]) + wp.cw_mul(a[1], b[1]) + wp.cw_mul(a[2], b[2])


@wp.func
def times(a: points, f: lanes) -> points:
    """Each lane's point times its own factor."""
    return wp.matrix_from_rows(wp.cw_mul(a[0], f), wp.cw_mul(a[1], f), wp.cw_mul(a[2], f))


@wp.func
def same(p: wp.vec3) -> points:
    """One point in all lanes."""
    return wp.matrix_from_rows(lanes(p[0]), lanes(p[1]), lanes(p[2]))


@wp.func
def sweep(sheet: Sheet, blocks: Blocks, b: int):
    """One Gauss-Seidel sweep over all constraints of one block."""
    for e in range(sheet.edges.shape[0]):
        i = sheet.edges[e][0]
        j = sheet.edges[e][1]
        apart = blocks.x[b, i] - blocks.x[b, j]
        length = root(dot(apart, apart))
        change = (lanes(sheet.rest_length[e]) - length - blocks.edge_force[b, e] * sheet.edge_compliance[e]) * sheet.edge_gain[e]
        blocks.edge_force[b, e] = blocks.edge_force[b, e] + change
        push = times(apart, wp.cw_div(change, length + lanes(1e-12)))
        blocks.x[b, i] = blocks.x[b, i] + push * sheet.inverse_inertia[i]
        blocks.x[b, j] = blocks.x[b, j] - push * sheet.inverse_inertia[j]
    for e in range(sheet.hinges.shape[0]):
        k = sheet.hinges[e]
        w = sheet.hinge_weights[e]
        bent = blocks.x[b, k[0]] * w[0] + blocks.x[b, k[1]] * w[1] + blocks.x[b, k[2]] * w[2] + blocks.x[b, k[3]] * w[3]
        force = blocks.hinge_force[b, e]
        push = (same(sheet.hinge_rest[e]) - bent - force * sheet.hinge_compliance[e]) * sheet.hinge_gain[e]
        blocks.hinge_force[b, e] = force + push
        for c in range(4):
            blocks.x[b, k[c]] = blocks.x[b, k[c]] + push * (sheet.inverse_inertia[k[c]] * w[c])
    for e in range(sheet.seams.shape[0]):
        i = sheet.seams[e][0]
        j = sheet.seams[e][1]
        wi = sheet.inverse_inertia[i]
        wj = sheet.inverse_inertia[j]
        stiffness = blocks.seam[b, e]
        force = blocks.seam_force[b, e]
        pull = times(blocks.x[b, j] - blocks.x[b, i], stiffness) - force
        push = times(pull, wp.cw_div(lanes(1.0), stiffness * (wi + wj) + lanes(1.0)))
        blocks.seam_force[b, e] = force + push
        blocks.x[b, i] = blocks.x[b, i] + push * wi
        blocks.x[b, j] = blocks.x[b, j] - push * wj
    for e in range(sheet.anchored.shape[0]):
        i = sheet.anchored[e]
        wi = sheet.inverse_inertia[i]
        stiffness = blocks.adhesion[b, e]
        force = blocks.bed_force[b, e]
        pull = times(same(sheet.rest[i]) - blocks.x[b, i], stiffness) - force
        push = times(pull, wp.cw_div(lanes(1.0), stiffness * wi + lanes(1.0)))
        blocks.bed_force[b, e] = force + push
        blocks.x[b, i] = blocks.x[b, i] + push * wi
    if sheet.has_floor != 0:
        n = wp.vec3(sheet.floor[0], sheet.floor[1], sheet.floor[2])
        for v in range(sheet.inverse_inertia.shape[0]):
            if sheet.inverse_inertia[v] > 0.0:
                p = blocks.x[b, v]
                depth = p[0] * n[0] + p[1] * n[1] + p[2] * n[2] + lanes(sheet.floor[3])
                depth = wp.min(depth, lanes(0.0))
                blocks.x[b, v] = p - wp.matrix_from_rows(depth * n[0], depth * n[1], depth * n[2])


@wp.func
def tear(sheet: Sheet, blocks: Blocks, b: int):
    """Adhesions longer than their limit break, each in its own sample."""
    for e in range(sheet.anchored.shape[0]):
        i = sheet.anchored[e]
        away = blocks.x[b, i] - same(sheet.rest[i])
        square = dot(away, away)
        limit = sheet.limit[i] * sheet.limit[i]
        left = blocks.adhesion[b, e]
        for lane in range(8):
            if square[lane] > limit:
                left[lane] = 0.0
        blocks.adhesion[b, e] = left


@wp.func
def measure(sheet: Sheet, blocks: Blocks, b: int, step: int):
    """Force on the jaws and largest strain."""
    total = points(0.0)
    for e in range(sheet.pulling.shape[0]):
        apart = blocks.x[b, sheet.pulling[e][1]] - blocks.x[b, sheet.pulling[e][0]]
        length = root(dot(apart, apart))
        force = (length - lanes(sheet.pulling_length[e])) * sheet.pulling_stiffness[e]
        total = total + times(apart, wp.cw_div(force, length + lanes(1e-12)))
    for e in range(sheet.rim.shape[0]):
        k = sheet.rim[e]
        w = sheet.rim_weights[e]
        bent = blocks.x[b, k[0]] * w[0] + blocks.x[b, k[1]] * w[1] + blocks.x[b, k[2]] * w[2] + blocks.x[b, k[3]] * w[3]
        total = total - (bent - same(sheet.rim_rest[e])) * sheet.rim_stiffness[e]
    for g in range(sheet.gripped_seams.shape[0]):
        e = sheet.gripped_seams[g]
        apart = blocks.x[b, sheet.seams[e][1]] - blocks.x[b, sheet.seams[e][0]]
        total = total + times(apart, blocks.seam[b, e] * sheet.gripped_sign[g])
    blocks.tension[step, b] = root(dot(total, total))
    largest = lanes(0.0)
    for e in range(sheet.watched.shape[0]):
        apart = blocks.x[b, sheet.watched[e][1]] - blocks.x[b, sheet.watched[e][0]]
        largest = wp.max(largest, root(dot(apart, apart)) / sheet.watched_length[e] - lanes(1.0))
    blocks.strain[step, b] = largest


@wp.kernel
def rollout(sheet: Sheet, blocks: Blocks, first: int, substeps: int, iterations: int):
    """All horizon steps of one block of samples."""
    b = first + wp.tid()
    for step in range(blocks.trajectory.shape[0]):
        part = blocks.controls[b, step] * (1.0 / float(substeps))
        for _s in range(substeps):
            for v in range(sheet.inverse_inertia.shape[0]):
                if sheet.grasped[v] != 0:
                    blocks.x[b, v] = blocks.x[b, v] + part
                else:
                    blocks.x[b, v] = blocks.x[b, v] + same(sheet.shift[v])
            for e in range(sheet.edges.shape[0]):
                blocks.edge_force[b, e] = lanes(0.0)
            for e in range(sheet.hinges.shape[0]):
                blocks.hinge_force[b, e] = points(0.0)
            for e in range(sheet.seams.shape[0]):
                blocks.seam_force[b, e] = points(0.0)
            for e in range(sheet.anchored.shape[0]):
                blocks.bed_force[b, e] = points(0.0)
            for _i in range(iterations):
                sweep(sheet, blocks, b)
            tear(sheet, blocks, b)
        for v in range(sheet.inverse_inertia.shape[0]):
            blocks.trajectory[step, b, v] = blocks.x[b, v]
        measure(sheet, blocks, b, step)
