# mypy: ignore-errors
# (the body of a kernel is Warp's language in Python's clothes; Warp's own compiler checks its types)
"""The solver on a GPU: one launch for each colour, one thread for each constraint of it and each sample.

Arrays are [vertex or constraint, sample]: neighbouring threads are neighbouring samples and read neighbouring memory. In the first
iteration of a substep (`fresh`) the multipliers count as 0, which saves clearing them.
"""

import warp as wp

from skills.expose.xpbd_sheet import Sheet

wp.set_module_options({"enable_backward": False})


@wp.struct
class Samples:
    """What each sample has of its own; last index: the sample."""

    x: wp.array2d(dtype=wp.vec3)
    controls: wp.array2d(dtype=wp.vec3)  # (h, K)
    adhesion: wp.array2d(dtype=wp.float32)  # (A, K)
    seam: wp.array2d(dtype=wp.float32)  # (S, K) [N/m]
    edge_force: wp.array2d(dtype=wp.float32)
    hinge_force: wp.array2d(dtype=wp.vec3)
    seam_force: wp.array2d(dtype=wp.vec3)
    bed_force: wp.array2d(dtype=wp.vec3)
    trajectory: wp.array3d(dtype=wp.vec3)  # (h, V, K)
    tension: wp.array2d(dtype=wp.float32)  # (h, K)
    strain: wp.array2d(dtype=wp.float32)  # (h, K)


@wp.kernel
def predict(sheet: Sheet, own: Samples, step: int, part: float):
    """Move the jaws by a part of their step, and the free vertices by the external force."""
    v, s = wp.tid()
    if sheet.grasped[v] != 0:
        own.x[v, s] = own.x[v, s] + own.controls[step, s] * part
    else:
        own.x[v, s] = own.x[v, s] + sheet.shift[v]


@wp.kernel
def project_edges(sheet: Sheet, own: Samples, first: int, fresh: int):
    """Lengths of the edges of one colour."""
    c, s = wp.tid()
    e = first + c
    i = sheet.edges[e][0]
    j = sheet.edges[e][1]
    force = float(0.0)  # noqa: UP018 (a variable of Warp's, not a constant)
    if fresh == 0:
        force = own.edge_force[e, s]
    apart = own.x[i, s] - own.x[j, s]
    length = wp.sqrt(wp.dot(apart, apart))
    change = (sheet.rest_length[e] - length - force * sheet.edge_compliance[e]) * sheet.edge_gain[e]
    own.edge_force[e, s] = force + change
    push = apart * (change / (length + 1e-12))
    if sheet.inverse_inertia[i] > 0.0:
        own.x[i, s] = own.x[i, s] + push * sheet.inverse_inertia[i]
    if sheet.inverse_inertia[j] > 0.0:
        own.x[j, s] = own.x[j, s] - push * sheet.inverse_inertia[j]


@wp.kernel
def project_hinges(sheet: Sheet, own: Samples, first: int, fresh: int):
    """Bending of the hinges of one colour."""
    c, s = wp.tid()
    e = first + c
    k = sheet.hinges[e]
    w = sheet.hinge_weights[e]
    force = wp.vec3(0.0)
    if fresh == 0:
        force = own.hinge_force[e, s]
    bent = own.x[k[0], s] * w[0] + own.x[k[1], s] * w[1] + own.x[k[2], s] * w[2] + own.x[k[3], s] * w[3]
    push = (sheet.hinge_rest[e] - bent - force * sheet.hinge_compliance[e]) * sheet.hinge_gain[e]
    own.hinge_force[e, s] = force + push
    for n in range(4):
        if sheet.inverse_inertia[k[n]] > 0.0:
            own.x[k[n], s] = own.x[k[n], s] + push * (sheet.inverse_inertia[k[n]] * w[n])


@wp.kernel
def project_seams(sheet: Sheet, own: Samples, first: int, fresh: int):
    """Links between the two sides of the goal, of one colour."""
    c, s = wp.tid()
    e = first + c
    i = sheet.seams[e][0]
    j = sheet.seams[e][1]
    wi = sheet.inverse_inertia[i]
    wj = sheet.inverse_inertia[j]
    force = wp.vec3(0.0)
    if fresh == 0:
        force = own.seam_force[e, s]
    stiffness = own.seam[e, s]
    push = ((own.x[j, s] - own.x[i, s]) * stiffness - force) * (1.0 / (stiffness * (wi + wj) + 1.0))
    own.seam_force[e, s] = force + push
    if wi > 0.0:
        own.x[i, s] = own.x[i, s] + push * wi
    if wj > 0.0:
        own.x[j, s] = own.x[j, s] - push * wj


@wp.kernel
def project_adhesions(sheet: Sheet, own: Samples, fresh: int):
    """Springs to the bed: each has a vertex of its own, so they are one colour."""
    e, s = wp.tid()
    i = sheet.anchored[e]
    wi = sheet.inverse_inertia[i]
    force = wp.vec3(0.0)
    if fresh == 0:
        force = own.bed_force[e, s]
    stiffness = own.adhesion[e, s]
    push = ((sheet.rest[i] - own.x[i, s]) * stiffness - force) * (1.0 / (stiffness * wi + 1.0))
    own.bed_force[e, s] = force + push
    own.x[i, s] = own.x[i, s] + push * wi


@wp.kernel
def project_floor(sheet: Sheet, own: Samples):
    """No free vertex below the floor."""
    v, s = wp.tid()
    if sheet.inverse_inertia[v] > 0.0:
        n = wp.vec3(sheet.floor[0], sheet.floor[1], sheet.floor[2])
        depth = wp.dot(own.x[v, s], n) + sheet.floor[3]
        if depth < 0.0:
            own.x[v, s] = own.x[v, s] - n * depth


@wp.kernel
def tear(sheet: Sheet, own: Samples):
    """Adhesions longer than their limit break, each in its own sample."""
    e, s = wp.tid()
    i = sheet.anchored[e]
    away = own.x[i, s] - sheet.rest[i]
    if wp.dot(away, away) > sheet.limit[i] * sheet.limit[i]:
        own.adhesion[e, s] = 0.0


@wp.kernel
def record(sheet: Sheet, own: Samples, step: int):
    """Keep the positions of this step."""
    v, s = wp.tid()
    own.trajectory[step, v, s] = own.x[v, s]


@wp.kernel
def measure_tension(sheet: Sheet, own: Samples, step: int):
    """Force on the jaws: one thread sums a sample's springs in order, so that the sum is the same every time."""
    s = wp.tid()
    total = wp.vec3(0.0)
    for e in range(sheet.pulling.shape[0]):
        apart = own.x[sheet.pulling[e][1], s] - own.x[sheet.pulling[e][0], s]
        length = wp.sqrt(wp.dot(apart, apart))
        total = total + apart * ((length - sheet.pulling_length[e]) * sheet.pulling_stiffness[e] / (length + 1e-12))
    for e in range(sheet.rim.shape[0]):
        k = sheet.rim[e]
        w = sheet.rim_weights[e]
        bent = own.x[k[0], s] * w[0] + own.x[k[1], s] * w[1] + own.x[k[2], s] * w[2] + own.x[k[3], s] * w[3]
        total = total - (bent - sheet.rim_rest[e]) * sheet.rim_stiffness[e]
    for g in range(sheet.gripped_seams.shape[0]):
        e = sheet.gripped_seams[g]
        apart = own.x[sheet.seams[e][1], s] - own.x[sheet.seams[e][0], s]
        total = total + apart * (own.seam[e, s] * sheet.gripped_sign[g])
    own.tension[step, s] = wp.sqrt(wp.dot(total, total))
    own.strain[step, s] = 0.0


@wp.kernel
def measure_strain(sheet: Sheet, own: Samples, step: int):
    """Largest strain: a maximum is the same in whatever order the threads come."""
    e, s = wp.tid()
    apart = own.x[sheet.watched[e][1], s] - own.x[sheet.watched[e][0], s]
    wp.atomic_max(own.strain, step, s, wp.sqrt(wp.dot(apart, apart)) / sheet.watched_length[e] - 1.0)
