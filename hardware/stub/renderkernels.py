# mypy: ignore-errors
# (the body of a kernel is Warp's language in Python's clothes; Warp's own compiler checks its types)
"""The Warp kernels of the endoscope renderer: project, set up, rasterise, shade. They run on the processor, one eye per thread.

A frame is made in two passes. First every triangle is drawn into a z-buffer that holds one 64-bit key per pixel,
(bits of 1/z) << 32 | (triangle + 1): the greatest key is the nearest surface, and for positive floats the order of the bits
is the order of the numbers. Then each covered pixel is shaded once, from its triangle alone.
"""

import warp as wp

from hardware.stub.rendermesh import Label

wp.config.log_level = wp.LOG_WARNING
# Fused multiply-add saves a tenth of the shading; images stay the same on one machine, but two may differ in a last bit.
FLAGS = f"{wp.config.cpu_compiler_flags or '-march=native'} -ffp-contract=fast"
wp.set_module_options({"enable_backward": False, "optimization_level": 3, "cpu_compiler_flags": FLAGS})

NEAR = wp.constant(0.004)  # triangles with a corner nearer than this [m] are not drawn
EDGE = wp.constant(1.0e-3)  # an edge reaches this far [px] over, so that no pixel is lost between two triangles
LANE = wp.constant(wp.uint64(0xFFFF))
TOP = wp.constant(int(Label.TOP))
WALL = wp.constant(int(Label.WALL))
BASE = wp.constant(int(Label.BASE))
SEAM = wp.constant(int(Label.SEAM))


@wp.struct
class View:
    """One eye: focal length and principal point [px], image size, its offset along x [m], and where the light is [m]."""

    focal: float
    cu: float
    cv: float
    width: int
    height: int
    offset: float
    light: wp.vec3


@wp.struct
class Layer:
    """One texture in the atlas: where it starts, its row length, its wrapping masks, and how the surface shines."""

    start: int
    stride: int
    mask_u: int
    mask_v: int
    sheen: float
    glint: float
    lambert: (
        float  # diffuse light is lambert * cosine + wrap: in soft tissue it creeps around the terminator, on steel it does not
    )
    wrap: float


@wp.struct
class Setup:
    """A projected triangle: corner 0 [px], gradients of the screen barycentrics of corners 1 and 2 [1/px], attributes."""

    x: float
    y: float
    a1: float
    b1: float
    a2: float
    b2: float
    inverse_depth: wp.vec3
    n0: wp.vec3
    n1: wp.vec3
    n2: wp.vec3
    t0: wp.vec2
    t1: wp.vec2
    t2: wp.vec2
    drawn: int


@wp.kernel
def project(view: View, vertices: wp.array(dtype=wp.vec3), screen: wp.array(dtype=wp.vec3)):
    """Vertices (N,) [m] in the left camera frame to (u [px], v [px], z [m]) of this eye."""
    i = wp.tid()
    p = vertices[i]
    z = wp.max(p[2], 1.0e-6)
    screen[i] = wp.vec3(view.focal * (p[0] - view.offset) / z + view.cu, view.focal * p[1] / z + view.cv, p[2])


@wp.kernel
def set_up(
    vertices: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    screen: wp.array(dtype=wp.vec3),
    corners: wp.array(dtype=wp.vec3i),
    texels: wp.array2d(dtype=wp.vec2),
    labels: wp.array(dtype=wp.uint8),
    setups: wp.array(dtype=Setup),
):
    """Prepare each triangle for drawing; drop what is too near, degenerate, or the inside of a closed body."""
    i = wp.tid()
    c = corners[i]
    s0 = screen[c[0]]
    s1 = screen[c[1]]
    s2 = screen[c[2]]
    label = int(labels[i])
    e1x = s1[0] - s0[0]
    e1y = s1[1] - s0[1]
    e2x = s2[0] - s0[0]
    e2y = s2[1] - s0[1]
    area = e1x * e2y - e2x * e1y
    s = Setup()
    s.drawn = 1
    if wp.min(s0[2], wp.min(s1[2], s2[2])) < NEAR or wp.abs(area) < 1.0e-7:
        s.drawn = 0
    # Seen from its front a triangle turns clockwise in (u, v), v being down. Top and bed are open surfaces and keep both sides.
    if area > 0.0 and label != TOP and label != BASE:
        s.drawn = 0
    if s.drawn == 1:
        s.x = s0[0]
        s.y = s0[1]
        s.a1 = e2y / area
        s.b1 = -e2x / area
        s.a2 = -e1y / area
        s.b2 = e1x / area
        s.inverse_depth = wp.vec3(1.0 / s0[2], 1.0 / s1[2], 1.0 / s2[2])
        s.t0 = texels[i, 0]
        s.t1 = texels[i, 1]
        s.t2 = texels[i, 2]
        if label == WALL or label == SEAM:  # noqa: SIM109 (Warp has no tuples to search)
            p0 = vertices[c[0]]
            n = wp.normalize(wp.cross(vertices[c[1]] - p0, vertices[c[2]] - p0))
            s.n0 = n
            s.n1 = n
            s.n2 = n
        else:
            s.n0 = normals[c[0]]
            s.n1 = normals[c[1]]
            s.n2 = normals[c[2]]
    setups[i] = s


@wp.kernel
def rasterise(
    view: View,
    screen: wp.array(dtype=wp.vec3),
    corners: wp.array(dtype=wp.vec3i),
    setups: wp.array(dtype=Setup),
    last: int,
    keys: wp.array(dtype=wp.uint64),
):
    """Draw each triangle into the z-buffer, the last one first: tools and tissue lie after the bed they hide."""
    i = last - wp.tid()
    s = setups[i]
    if s.drawn == 0:
        return
    c = corners[i]
    s0 = screen[c[0]]
    s1 = screen[c[1]]
    s2 = screen[c[2]]
    left = wp.max(int(wp.ceil(wp.min(s0[0], wp.min(s1[0], s2[0])) - EDGE)), 0)
    right = wp.min(int(wp.floor(wp.max(s0[0], wp.max(s1[0], s2[0])) + EDGE)), view.width - 1)
    upper = wp.max(int(wp.ceil(wp.min(s0[1], wp.min(s1[1], s2[1])) - EDGE)), 0)
    lower = wp.min(int(wp.floor(wp.max(s0[1], wp.max(s1[1], s2[1])) + EDGE)), view.height - 1)
    a0 = -s.a1 - s.a2
    b0 = -s.b1 - s.b2
    e0 = -EDGE * (wp.abs(a0) + wp.abs(b0))
    e1 = -EDGE * (wp.abs(s.a1) + wp.abs(s.b1))
    e2 = -EDGE * (wp.abs(s.a2) + wp.abs(s.b2))
    for row in range(upper, lower + 1):
        dy = float(row) - s.y
        for column in range(left, right + 1):
            dx = float(column) - s.x
            l1 = s.a1 * dx + s.b1 * dy
            l2 = s.a2 * dx + s.b2 * dy
            l0 = 1.0 - l1 - l2
            if l0 >= e0 and l1 >= e1 and l2 >= e2:
                w = l0 * s.inverse_depth[0] + l1 * s.inverse_depth[1] + l2 * s.inverse_depth[2]
                key = (wp.uint64(wp.cast(w, wp.uint32)) << wp.uint64(32)) | wp.uint64(i + 1)
                pixel = row * view.width + column
                if key > keys[pixel]:
                    wp.atomic_max(keys, pixel, key)


@wp.func
def bilinear(atlas: wp.array(dtype=wp.uint64), layer: Layer, t: wp.vec2) -> wp.vec4:
    """Colour and gloss (r, g, b, a), 0 to 1, at texel coordinates `t`.

    A texel is 64 bits: four 8-bit channels in 16-bit lanes. The four weights are integers that sum to 256, so each product
    and sum stays within its lane, and one multiplication serves all channels.
    """
    fu = wp.floor(t[0])
    fv = wp.floor(t[1])
    u0 = int(fu) & layer.mask_u
    v0 = int(fv) & layer.mask_v
    u1 = (u0 + 1) & layer.mask_u
    v1 = (v0 + 1) & layer.mask_v
    wu = int((t[0] - fu) * 256.0)
    wv = int((t[1] - fv) * 256.0)
    w11 = (wu * wv) >> 8
    row0 = layer.start + v0 * layer.stride
    row1 = layer.start + v1 * layer.stride
    total = (
        atlas[row0 + u0] * wp.uint64(256 - wu - wv + w11)
        + atlas[row0 + u1] * wp.uint64(wu - w11)
        + atlas[row1 + u0] * wp.uint64(wv - w11)
        + atlas[row1 + u1] * wp.uint64(w11)
    )
    scale = 1.0 / 65280.0
    return wp.vec4(
        float(int(total & LANE)) * scale,
        float(int((total >> wp.uint64(16)) & LANE)) * scale,
        float(int((total >> wp.uint64(32)) & LANE)) * scale,
        float(int(total >> wp.uint64(48))) * scale,
    )


@wp.func
def tone(radiance: float) -> wp.uint8:
    """Camera curve: square root with a soft shoulder that reaches white only in the limit."""
    return wp.uint8(int(255.0 * wp.sqrt(radiance / (radiance + 0.7)) + 0.5))


@wp.kernel
def shade(
    view: View,
    keys: wp.array(dtype=wp.uint64),
    setups: wp.array(dtype=Setup),
    labels: wp.array(dtype=wp.uint8),
    layers: wp.array(dtype=Layer),
    atlas: wp.array(dtype=wp.uint64),
    surroundings: wp.array(dtype=float),
    illumination: wp.array(dtype=float),
    first_top: int,
    first_bottom: int,
    sheet_triangles: int,
    image: wp.array(dtype=wp.vec3ub),
    depth: wp.array(dtype=float),
    label_out: wp.array(dtype=wp.uint8),
    triangle_out: wp.array(dtype=wp.int32),
):
    """Colour, depth [m], label and sheet triangle of every pixel; one thread per row.

    `surroundings` (H * W,) [m] is the smoothed depth around each pixel: what lies below it sits in a cavity and gets less light.
    """
    row = wp.tid()
    scale = 1.0 / view.focal
    ray_y = (float(row) - view.cv) * scale
    for column in range(view.width):
        pixel = row * view.width + column
        key = keys[pixel]
        i = int(key & wp.uint64(0xFFFFFFFF)) - 1
        if i < 0:
            depth[pixel] = 0.0
            label_out[pixel] = wp.uint8(0)
            triangle_out[pixel] = -1
            image[pixel] = wp.vec3ub(wp.uint8(6), wp.uint8(5), wp.uint8(6))
        else:
            s = setups[i]
            label = int(labels[i])
            layer = layers[label]

            # Perspective-correct barycentrics, from the screen ones times 1/z.
            dx = float(column) - s.x
            dy = float(row) - s.y
            l1 = s.a1 * dx + s.b1 * dy
            l2 = s.a2 * dx + s.b2 * dy
            w0 = (1.0 - l1 - l2) * s.inverse_depth[0]
            w1 = l1 * s.inverse_depth[1]
            w2 = l2 * s.inverse_depth[2]
            z = 1.0 / (w0 + w1 + w2)
            n = s.n0 * w0 + s.n1 * w1 + s.n2 * w2
            texel = bilinear(atlas, layer, (s.t0 * w0 + s.t1 * w1 + s.t2 * w2) * z)

            # A small lamp beside the lens: Lambert with 1/r^2, and two specular lobes around the half vector (lamp and eye are so
            # close together that the sum of the two unnormalised directions serves).
            p = wp.vec3((float(column) - view.cu) * scale * z, ray_y * z, z)
            if wp.dot(n, p) > 0.0:
                n = -n
            n2 = wp.dot(n, n) + 1.0e-20
            to_light = view.light - p
            r2 = wp.dot(to_light, to_light)
            half = to_light - p
            h2 = wp.dot(half, half)
            cosine = wp.dot(n, to_light) / wp.sqrt(n2 * r2)
            along = wp.max(wp.dot(n, half), 0.0)
            nh2 = along * along / (n2 * h2)
            nh4 = nh2 * nh2
            nh8 = nh4 * nh4
            nh16 = nh8 * nh8
            nh64 = nh16 * nh16 * nh16 * nh16

            open_sky = 1.0 / (1.0 + 420.0 * wp.max(z - surroundings[pixel] - 2.0e-4, 0.0))
            light = illumination[pixel] / r2 * open_sky
            diffuse = light * wp.max(layer.lambert * cosine + layer.wrap, 0.03)
            shine = light * texel[3] * (layer.sheen * nh16 + layer.glint * nh64 * nh64)

            image[pixel] = wp.vec3ub(
                tone(texel[0] * texel[0] * diffuse + shine),
                tone(texel[1] * texel[1] * diffuse + shine * 0.97),
                tone(texel[2] * texel[2] * diffuse + shine * 0.94),
            )
            depth[pixel] = z
            label_out[pixel] = wp.uint8(label)
            sheet = wp.int32(-1)
            if i >= first_top and i < first_top + sheet_triangles:
                sheet = i - first_top
            elif i >= first_bottom and i < first_bottom + sheet_triangles:
                sheet = i - first_bottom
            triangle_out[pixel] = sheet
