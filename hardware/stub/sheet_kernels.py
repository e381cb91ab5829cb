# mypy: ignore-errors
"""The Warp kernel of the sheet's physics: one serial launch for each physics step, on the CPU."""

import warp as wp

wp.config.log_level = wp.LOG_WARNING
wp.set_module_options({"enable_backward": False})


@wp.func
def base_height(x: float, y: float, bump: wp.vec4) -> float:
    """Height [m] of the bed: a smooth bump (centre x, centre y, radius, height)."""
    dx = x - bump[0]
    dy = y - bump[1]
    r2 = (dx * dx + dy * dy) / (bump[2] * bump[2])
    h = 0.0
    if r2 < 1.0:
        h = bump[3] * (1.0 - r2) * (1.0 - r2)
    return h


@wp.kernel
def advance_sheet(
    x: wp.array(dtype=wp.vec3),
    velocity: wp.array(dtype=wp.vec3),
    previous: wp.array(dtype=wp.vec3),
    inverse_mass: float,
    gravity: wp.array(dtype=wp.vec3),
    edges: wp.array2d(dtype=wp.int32),
    rest_length: wp.array(dtype=float),
    edge_compliance: wp.array(dtype=float),
    hinges: wp.array2d(dtype=wp.int32),
    hinge_weights: wp.array(dtype=wp.vec4),
    hinge_compliance: wp.array(dtype=float),
    anchor: wp.array(dtype=wp.vec3),
    adhesion: wp.array(dtype=float),
    adhesion_limit: wp.array(dtype=float),
    seams: wp.array2d(dtype=wp.int32),
    seam_stiffness: wp.array(dtype=float),
    grip_vertex: wp.array(dtype=wp.int32),
    grip_from: wp.array(dtype=wp.vec3),
    grip_to: wp.array(dtype=wp.vec3),
    grip_stiffness: float,
    bump: wp.vec4,
    clearance: float,
    friction: float,
    dt: float,
    damping: float,
    substeps: int,
):
    """Run `substeps` substeps of `dt` [s]: predict, one Gauss-Seidel sweep over all constraints, contact, velocities."""
    vertices = x.shape[0]
    w = inverse_mass
    dt2 = dt * dt
    for s in range(substeps):
        for i in range(vertices):
            p = x[i]
            v = velocity[i] + dt * gravity[i]
            previous[i] = p
            x[i] = p + dt * v
        fraction = float(s + 1) / float(substeps)
        for g in range(grip_vertex.shape[0]):
            i = grip_vertex[g]
            target = grip_from[g] + fraction * (grip_to[g] - grip_from[g])
            alpha = 1.0 / (grip_stiffness * dt2)
            x[i] = x[i] + (target - x[i]) * (w / (w + alpha))
        for e in range(edges.shape[0]):
            a = edges[e, 0]
            b = edges[e, 1]
            d = x[a] - x[b]
            length = wp.length(d)
            if length > 1.0e-9:
                step = (rest_length[e] - length) / (2.0 * w + edge_compliance[e] / dt2)
                c = d * (w * step / length)
                x[a] = x[a] + c
                x[b] = x[b] - c
        for h in range(hinges.shape[0]):
            i0 = hinges[h, 0]
            i1 = hinges[h, 1]
            i2 = hinges[h, 2]
            i3 = hinges[h, 3]
            k = hinge_weights[h]
            c3 = k[0] * x[i0] + k[1] * x[i1] + k[2] * x[i2] + k[3] * x[i3]
            step3 = c3 * (-w / (w * wp.dot(k, k) + hinge_compliance[h] / dt2))
            x[i0] = x[i0] + k[0] * step3
            x[i1] = x[i1] + k[1] * step3
            x[i2] = x[i2] + k[2] * step3
            x[i3] = x[i3] + k[3] * step3
        for m in range(seams.shape[0]):
            if seam_stiffness[m] > 0.0:
                a = seams[m, 0]
                b = seams[m, 1]
                c = (x[a] - x[b]) * (w / (2.0 * w + 1.0 / (seam_stiffness[m] * dt2)))
                x[a] = x[a] - c
                x[b] = x[b] + c
        for i in range(vertices):
            k1 = adhesion[i]
            if k1 > 0.0:
                d = anchor[i] - x[i]
                if wp.length(d) > adhesion_limit[i]:
                    adhesion[i] = 0.0
                else:
                    x[i] = x[i] + d * (w / (w + 1.0 / (k1 * dt2)))
            p = x[i]
            floor = base_height(p[0], p[1], bump) + clearance
            if p[2] < floor:
                # Contact is a projection; sliding on the bed is damped.
                q = previous[i]
                x[i] = wp.vec3(p[0] + friction * (q[0] - p[0]), p[1] + friction * (q[1] - p[1]), floor)
            velocity[i] = (x[i] - previous[i]) * (damping / dt)
