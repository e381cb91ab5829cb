# mypy: ignore-errors
# (the annotations of a Warp struct are calls, which mypy does not take for types)
"""What all samples share, on the device: the constraints of the schedule in their order, float32."""

import warp as wp

from skills.expose.model import TissueModel
from skills.expose.xpbd_colours import Schedule


@wp.struct
class Sheet:
    """The fields of `Schedule` and of `TissueModel` that kernels read."""

    rest: wp.array(dtype=wp.vec3)
    grasped: wp.array(dtype=wp.int32)
    inverse_inertia: wp.array(dtype=wp.float32)
    shift: wp.array(dtype=wp.vec3)
    edges: wp.array(dtype=wp.vec2i)
    rest_length: wp.array(dtype=wp.float32)
    edge_compliance: wp.array(dtype=wp.float32)
    edge_gain: wp.array(dtype=wp.float32)
    hinges: wp.array(dtype=wp.vec4i)
    hinge_weights: wp.array(dtype=wp.vec4)
    hinge_rest: wp.array(dtype=wp.vec3)
    hinge_compliance: wp.array(dtype=wp.float32)
    hinge_gain: wp.array(dtype=wp.float32)
    seams: wp.array(dtype=wp.vec2i)
    anchored: wp.array(dtype=wp.int32)
    limit: wp.array(dtype=wp.float32)
    pulling: wp.array(dtype=wp.vec2i)
    pulling_length: wp.array(dtype=wp.float32)
    pulling_stiffness: wp.array(dtype=wp.float32)
    rim: wp.array(dtype=wp.vec4i)
    rim_weights: wp.array(dtype=wp.vec4)
    rim_rest: wp.array(dtype=wp.vec3)
    rim_stiffness: wp.array(dtype=wp.float32)
    gripped_seams: wp.array(dtype=wp.int32)
    gripped_sign: wp.array(dtype=wp.float32)
    watched: wp.array(dtype=wp.vec2i)
    watched_length: wp.array(dtype=wp.float32)
    floor: wp.vec4
    has_floor: wp.int32


def upload(model: TissueModel, plan: Schedule, device: str) -> Sheet:
    """The constants of `model` in the order of `plan`, on `device`."""
    sheet = Sheet()
    for values, dtypes in (
        (plan, {"inverse_inertia": wp.float32, "shift": wp.vec3}),
        (plan, {"edges": wp.vec2i, "rest_length": wp.float32, "edge_compliance": wp.float32, "edge_gain": wp.float32}),
        (plan, {"hinges": wp.vec4i, "hinge_weights": wp.vec4, "hinge_rest": wp.vec3}),
        (plan, {"hinge_compliance": wp.float32, "hinge_gain": wp.float32, "seams": wp.vec2i, "anchored": wp.int32}),
        (plan, {"pulling": wp.vec2i, "pulling_length": wp.float32, "pulling_stiffness": wp.float32}),
        (plan, {"rim": wp.vec4i, "rim_weights": wp.vec4, "rim_rest": wp.vec3, "rim_stiffness": wp.float32}),
        (plan, {"gripped_seams": wp.int32, "gripped_sign": wp.float32}),
        (plan, {"watched": wp.vec2i, "watched_length": wp.float32}),
        (model, {"rest": wp.vec3, "grasped": wp.int32}),
    ):
        for name, dtype in dtypes.items():
            setattr(sheet, name, wp.array(getattr(values, name), dtype=dtype, device=device))
    sheet.limit = wp.array(model.adhesion_limit, dtype=wp.float32, device=device)
    sheet.has_floor = int(model.floor is not None)
    sheet.floor = wp.vec4(*((0.0, 0.0, 0.0, 0.0) if model.floor is None else map(float, model.floor)))
    return sheet
