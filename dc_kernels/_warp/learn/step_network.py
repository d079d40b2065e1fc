"""A StepNet in lanes: image, trunk and head of a world before the solve, in native code for the CPU."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.common import kernel_module
from dc_kernels._warp.groups import group_types, struct_type
from dc_kernels._warp.native import native_code
from dc_kernels.learn.groups import ASKING, STEP_NETWORK
from dc_kernels.learn.layers import CHUNK, LANES, MOST_SCALES
from dc_kernels.learn.step_channels import (
    ANSWER,
    BINS,
    CHANNELS,
    CONTACT_CHANNELS,
    FLOATING,
    LEAST_GIVE,
    MOTION,
    BodyWork,
    ContactWork,
)
from dc_kernels.model.enums import BodyType

LAYERS = ("prelude.h", "grid/axis.h", "learn/layers.h", "learn/maps.h")
HEADERS = (*LAYERS, "learn/step_image.h", "learn/trunk.h", "learn/step_head.h")
FIRST = {"MASS": "mass", "WAY": "way_x", "FORCE": "force_x", "CONTACTS": "contacts/0", "WALL": "wall"}
"""Channels of the image that the headers begin at, by the names that they call them by."""


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``answer_worlds``: a thread each world."""
    t = group_types(dtype)
    Network, Asking = struct_type("step_network", dtype, STEP_NETWORK), struct_type("asking", dtype, ASKING)
    first = {name: CHANNELS.index(column) for name, column in FIRST.items()}
    work = {f"BODY_{one.name}": int(one) for one in BodyWork} | {f"CONTACT_{one.name}": int(one) for one in ContactWork}
    sizes = {"LANES": LANES, "SCALES": MOST_SCALES, "CHUNK": CHUNK, "CHANNELS": len(CHANNELS), "BINS": BINS}
    sizes |= {"BIN": len(CONTACT_CHANNELS), "MOTION": MOTION, "ANSWER": ANSWER, "DYNAMIC": int(BodyType.DYNAMIC)}
    constants = {"FLOATING": FLOATING, "LEAST_GIVE": LEAST_GIVE}

    @wp.func_native(native_code(*HEADERS, dtype=dtype, **first, **work, **sizes, **constants))
    def answer_world(
        w: wp.int32,
        slot: wp.int32,
        network: Network,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        contacts: t.Contacts,
        asking: Asking,
    ): ...

    @wp.kernel(module=kernel_module("step_network", dtype), enable_backward=False)
    def answer_worlds(
        world_offset: int,
        network: Network,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        # in, out:
        contacts: t.Contacts,
        asking: Asking,
    ):
        """Make velocities (``asking.velocity``) and impulses of the worlds that are asked for."""
        w = wp.tid() + world_offset
        if asking.asked[w] != 0:
            answer_world(w, asking.shard[world_offset], network, model, state, motion, contacts, asking)

    return {"answer_worlds": answer_worlds}
