"""Sensors: which shapes overlap one, and what a step has changed of that; one thread a world."""

from functools import cache
from typing import Any

import warp as wp

from dc_kernels._warp.collide.joined import move_pair
from dc_kernels._warp.common import cross, kernel_module, rotate
from dc_kernels._warp.events.lists import copy_pairs, list_missing
from dc_kernels._warp.groups import contiguous_groups, group_types
from dc_kernels.model.enums import Flag, ShapeRole, ShapeType

ASLEEP = wp.constant(int(Flag.ASLEEP))
SEGMENT = wp.constant(int(ShapeType.SEGMENT))
SENSOR = wp.constant(int(ShapeRole.SENSOR))


@cache
def kernels(dtype: str) -> dict[str, Any]:
    """``sense_overlaps`` and ``note_overlaps``."""
    t = group_types(dtype)
    real, vec2 = t.real, t.vec2
    module = kernel_module("overlaps", dtype)
    contiguous = contiguous_groups(dtype)
    keep = move_pair(dtype)

    @wp.func(module=module)
    def corners_of(s: int, model: t.Model):
        """Corners of the core of a shape: a disc has one, a capsule and a segment two."""
        if model.shape_type[s] == SEGMENT:
            return 2
        return model.vertex_start[s + 1] - model.vertex_start[s]

    @wp.func(module=module)
    def corner_of(s: int, n: int, k: int, x: vec2, c: real, sine: real, model: t.Model):
        """Corner k of the core of a shape, counted around it, whose body is at x, turned by an angle."""
        i = k
        if i >= n:
            i -= n
        return x + rotate(c, sine, model.vertices[model.vertex_start[s] + i])

    @wp.func(module=module)
    def square_to(p: vec2, a: vec2, b: vec2):
        """Squared distance of a point to the line from a to b."""
        edge = b - a
        square = wp.dot(edge, edge)
        along = real(0.0)
        if square > real(0.0):
            along = wp.clamp(wp.dot(p - a, edge) / square, real(0.0), real(1.0))
        return wp.length_sq(p - a - edge * along)

    @wp.func(module=module)
    def overlaps_shape(a: int, b: int, model: t.Model, state: t.State):
        """Whether two shapes overlap or touch: their cores meet, or come as near as their radii together.

        Cores meet where none of the normals of their sides parts them, if these span the plane; else, and where one
        does, the least distance is that of a corner of one and a side of the other.
        """
        ba = model.shape_body[a]
        bb = model.shape_body[b]
        # relative to A, so that a world far from its origin is as exact
        xa = vec2(real(0.0), real(0.0))
        xb = state.position[bb] - state.position[ba]
        ca = wp.cos(state.angle[ba])
        sa = wp.sin(state.angle[ba])
        cb = wp.cos(state.angle[bb])
        sb = wp.sin(state.angle[bb])
        n = corners_of(a, model)
        m = corners_of(b, model)
        spans = n > 2 or m > 2
        meet = bool(True)
        reach = model.shape_radius[a] + model.shape_radius[b]
        near = reach * reach
        touch = bool(False)
        for side in range(2):
            s = a
            o = b
            xs = xa
            xo = xb
            cs = ca
            ss = sa
            co = cb
            so = sb
            ns = n
            no = m
            if side == 1:
                s = b
                o = a
                xs = xb
                xo = xa
                cs = cb
                ss = sb
                co = ca
                so = sa
                ns = m
                no = n
            for k in range(ns):
                p = corner_of(s, ns, k, xs, cs, ss, model)
                q = corner_of(s, ns, k + 1, xs, cs, ss, model)
                edge = q - p
                outside = ns > 1
                for j in range(no):
                    r = corner_of(o, no, j, xo, co, so, model)
                    if cross(edge, r - p) >= real(0.0):
                        outside = False
                    if square_to(r, p, q) <= near:
                        touch = True
                    if ns == 2 and no == 2 and cross(edge, corner_of(o, no, j + 1, xo, co, so, model) - r) != real(0.0):
                        spans = True
                if outside:
                    meet = False
        return touch or (spans and meet)

    @wp.kernel(module=module, enable_backward=False)
    def sense_overlaps(launch: t.Launch, model: t.Model, state: t.State, pairs: t.Pairs, overlaps: t.Overlaps):
        """Take a world's pairs of sensors out of the candidates, and list those of them that overlap, in order."""
        w = wp.tid() + launch.world_offset
        contiguous(model)
        contiguous(state)
        contiguous(pairs)
        contiguous(overlaps)
        if state.flags[w] != 0:
            return
        first = pairs.start[w]
        last = first
        n = first
        for p in range(first, first + pairs.count[w]):
            a = pairs.shape_a[p]
            b = pairs.shape_b[p]
            if model.shape_role[a] == SENSOR or model.shape_role[b] == SENSOR:
                if overlaps_shape(a, b, model, state):
                    overlaps.a[n] = a
                    overlaps.b[n] = b
                    n += 1
            else:
                keep(pairs, p, last)
                last += 1
        pairs.count[w] = last - first
        overlaps.count[w] = n - first

    @wp.kernel(module=module, enable_backward=False)
    def note_overlaps(launch: t.Launch, state: t.State, pairs: t.Pairs, overlaps: t.Overlaps):
        """List what has begun and ended since the step before; nothing does in a world that has stopped or sleeps."""
        w = wp.tid() + launch.world_offset
        contiguous(state)
        contiguous(pairs)
        contiguous(overlaps)
        if state.flags[w] != 0 and (state.flags[w] != ASLEEP or overlaps.part[w] == 0):
            overlaps.begun_count[w] = 0
            overlaps.ended_count[w] = 0
            return
        start = pairs.start[w]
        now = overlaps.count[w]
        before = overlaps.before_count[w]
        overlaps.begun_count[w] = list_missing(
            start,
            now,
            overlaps.a,
            overlaps.b,
            before,
            overlaps.before_a,
            overlaps.before_b,
            overlaps.begun_a,
            overlaps.begun_b,
        )
        overlaps.ended_count[w] = list_missing(
            start,
            before,
            overlaps.before_a,
            overlaps.before_b,
            now,
            overlaps.a,
            overlaps.b,
            overlaps.ended_a,
            overlaps.ended_b,
        )
        overlaps.part[w] = (overlaps.part[w] + 1) % overlaps.parts[w]
        if overlaps.part[w] == 0:
            overlaps.before_count[w] = now
            copy_pairs(start, now, overlaps.a, overlaps.b, overlaps.before_a, overlaps.before_b)

    return {"sense_overlaps": sense_overlaps, "note_overlaps": note_overlaps}
