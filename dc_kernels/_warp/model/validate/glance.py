"""Glances at arrays from outside, on the CPU: each sets ``wrong`` where a value might break its rule.

The rules are those that ``dc_kernels/model/validate`` holds the arrays to with NumPy, which has the last word and finds
what is wrong: a glance may call right values wrong, such as a side too short to have a direction, never wrong ones
right. So comparisons are written such that NaN fails them. One thread goes through all.
"""

from functools import cache
from typing import Any

import numpy as np
import warp as wp

from dc_kernels._warp.common import kernel_module, scalar_types
from dc_kernels._warp.native import native_code
from dc_kernels.model.enums import BodyType, Element, ShapeType
from dc_kernels.model.fields import COLORS, KEY_FEATURE_BITS, KEY_SHAPE_BITS
from dc_kernels.model.rules import INVERSE_TOLERANCE
from dc_kernels.model.shapes import MAX_VERTICES, NEAR, ROUNDINGS, SEGMENT_VERTICES, TOLERANCE


def code(dtype: str, name: str) -> str:
    """The native code of a header in ``native/model`` for a scalar type."""
    macros = {kind.name: int(kind) for kind in (*BodyType, *ShapeType, *Element)}
    bits = {"SHAPE_BITS": KEY_SHAPE_BITS, "FEATURE_BITS": KEY_FEATURE_BITS, "SERIAL": COLORS - 1}
    off = {"INVERSE_TOLERANCE": INVERSE_TOLERANCE, "NEAR": NEAR}
    near = {"FLAT": TOLERANCE / 2, "ROUNDING": ROUNDINGS * float(np.finfo(dtype).eps)}
    counts = {"MAX_VERTICES": MAX_VERTICES, "SEGMENT_VERTICES": SEGMENT_VERTICES}
    return native_code(f"model/{name}.h", dtype=dtype, **macros, **bits, **off, **near, **counts)


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``look_at_`` fields, contacts, bodies and shapes; each of one thread."""
    types = scalar_types(dtype)
    module = kernel_module("validate", dtype)
    reals, points = wp.array(dtype=types.real), wp.array(dtype=types.vec2)
    integers, longs, masks = (wp.array(dtype=kind) for kind in (wp.int32, wp.int64, wp.uint64))
    doubles = wp.array(dtype=wp.float64)

    @wp.func_native(code(dtype, "fields"))
    def look(kind: integers, address: masks, count: longs, low: doubles, high: doubles, wrong: integers): ...

    @wp.kernel(module=module, enable_backward=False)
    def look_at_fields(
        kind: integers,  # an Element
        address: masks,
        count: longs,
        low: doubles,
        high: doubles,
        # Out, of each field:
        wrong: integers,
    ):
        """Numbers of the scalar type or int32 from low to high, and vectors whose squared length lies there."""
        look(kind, address, count, low, high, wrong)

    @wp.func_native(code(dtype, "contacts"))
    def contacts_wrong(
        contact_start: longs,
        key: longs,
        body_a: integers,
        body_b: integers,
        color: integers,
        body_start: integers,
        shape_start: integers,
        shape_body: integers,
        body_type: integers,
        taken: masks,
    ) -> wp.int32: ...

    @wp.kernel(module=module, enable_backward=False)
    def look_at_contacts(
        contact_start: longs,
        key: longs,
        # no values where they are not given:
        body_a: integers,
        body_b: integers,
        color: integers,
        body_start: integers,
        shape_start: integers,
        shape_body: integers,
        body_type: integers,
        # Scratch: colours at each body of a world.
        taken: masks,
        # Out:
        wrong: integers,
    ):
        """Keys that rise within each world, of its shapes and of the bodies given; colours once at a dynamic body.

        Colours, offsets and owners of shapes must be in range.
        """
        wrong[0] = contacts_wrong(
            contact_start, key, body_a, body_b, color, body_start, shape_start, shape_body, body_type, taken
        )

    @wp.func_native(code(dtype, "bodies"))
    def bodies_wrong(
        body_type: integers,
        mass: reals,
        inertia: reals,
        inv_mass: reals,
        inv_inertia: reals,
        body_start: integers,
        shape_start: integers,
        shape_body: integers,
    ) -> wp.int32: ...

    @wp.kernel(module=module, enable_backward=False)
    def look_at_bodies(
        body_type: integers,
        mass: reals,
        inertia: reals,
        inv_mass: reals,
        inv_inertia: reals,
        body_start: integers,
        shape_start: integers,
        shape_body: integers,
        wrong: integers,
    ):
        """Masses, inertias and inverses that fit types and each other; shapes of their world.

        Offsets must be in range.
        """
        wrong[0] = bodies_wrong(body_type, mass, inertia, inv_mass, inv_inertia, body_start, shape_start, shape_body)

    @wp.func_native(code(dtype, "shapes"))
    def shapes_wrong(
        shape_type: integers,
        shape_radius: reals,
        shape_center: points,
        shape_extent: reals,
        vertex_start: integers,
        vertices: points,
        vertex_normals: points,
    ) -> wp.int32: ...

    @wp.kernel(module=module, enable_backward=False)
    def look_at_shapes(
        shape_type: integers,
        shape_radius: reals,
        shape_center: points,
        shape_extent: reals,
        vertex_start: integers,
        vertices: points,
        vertex_normals: points,
        wrong: integers,
    ):
        """Shapes with the number of vertices, the centre, extent, radius, normals and corners of their type.

        Offsets must be in range.
        """
        wrong[0] = shapes_wrong(
            shape_type, shape_radius, shape_center, shape_extent, vertex_start, vertices, vertex_normals
        )

    return {
        "look_at_fields": look_at_fields,
        "look_at_contacts": look_at_contacts,
        "look_at_bodies": look_at_bodies,
        "look_at_shapes": look_at_shapes,
    }
