"""Pairs of hulls that have hardly moved against each other are met by the edges and corners that met before.

Of a full test (``native/collide/hull_hull.h``) most is a search: for the edge of each hull that is farthest from the
other, for the corners that are nearest along its normal, for the edge that faces it. ``keep`` writes down what it
finds, beside the pose (R0, x0) of B in the frame of A, and by how much each comes before the next best.
``meet_again`` computes everything else anew, LANES pairs side by side, with the full test's arithmetic, so that the
bits of a contact do not tell which of both made it. It asks for the full test where a search may find another thing:

- Let r = |R - R0| and t = |x - x0|. In the frame of A a corner q of B moves by at most r |q| + t, in that of B a corner
  p of A by |R^T (p - x) - R0^T (p - x0)|, at most r (|p| + |x0|) + t. So no distance of a corner from an edge's line
  changes by more than D = r arm + t, arm = max(size B, size A + |x0|), and a lead of more than 2 D remains one.
- Which edge faces another one goes by the cosine of two normals, which changes by at most r.
- ``margin`` is half of the least lead of distances, ``turn`` half of that of cosines, less what rounding may do: each
  distance is off by at most 10 u (size A + size B + |x0|), u half a unit in the last place, two of them then and two
  now; half of that and more is ``ROUNDING``, 32 u. With arm >= margin / turn, D <= margin implies both.
- What depends on signs is computed and not bounded: which hull has the reference edge, whether the pair is out of
  reach, where ends are clipped, whether two faces are of one axis. So no setting is in what is kept.
- A pair that moves is tested in full where its motion may decide where it meets (``closing.py``), as another axis may
  part it beside the normal: ``kept_bound`` has the best of the edges that come second, which grows by D at most. Such a
  pair keeps nothing, as it will most likely be tested in full in the next step, too.
- So is what meets by two corners, and every pair with a segment of a chain.

Of a polygon and a centred disc nothing is kept: ``meet_discs`` looks at all edges, LANES pairs side by side, where the
pair does not move.

What is kept follows its pair from one list of near pairs to the next (``carry``). It copies geometry, and no result:
where it is lost, as by a snapshot, the next step tests in full, with the same bits. What changes shapes
(``Simulation.change_model``, ``add``, ``remove``) forgets it. Nothing is kept of a pair that moves by more than the
margin in a step, nor of arrays that are not a simulation's own (``dc.Narrowphase``), nor on a GPU.

Measured: 37 ns a pair of a pyramid. 95 % of the pairs of hulls in a settled pile of all shapes are met so, 65 % in a
tumbler; its 2 000 pairs in 8 000 that are too far apart for a full test never are. There near pairs are found anew in
each step, and ``carry`` takes 4 ns for each, 7 % of the narrowphase; pair by pair it was 6, as it waited for its
comparisons. Lanes for discs take 15 % off the narrowphase of the pile. A group with one lane in use
costs two full tests. Worlds of ten boxes gain a tenth: what they read comes from far caches.
"""

from functools import cache
from types import SimpleNamespace

import warp as wp

from dc_kernels._warp.collide.closing import HORIZON
from dc_kernels._warp.collide.manifold import EPSILON, PARALLEL, manifold_functions
from dc_kernels._warp.groups import group_types
from dc_kernels._warp.native import native_code
from dc_kernels.model.enums import ShapeType
from dc_kernels.model.fields import KEY_FEATURE_BITS, KEY_SHAPE_BITS, SCRATCH
from dc_kernels.solve.rows import LANES

CHUNK = 64  # pairs looked at before their contacts are stored
FIELDS = 14  # numbers of a manifold
FEW = 3  # pairs of a disc and a hull that are not worth lanes
ROUNDING = {"float32": 32 * 2.0**-24, "float64": 32 * 2.0**-53}  # see above


@cache
def recycling(dtype: str) -> SimpleNamespace:
    """``carry`` keeps with its pairs, ``meet_again`` and ``take_met`` make contacts of it, ``keep`` writes it down."""
    t = group_types(dtype)
    real, vec2 = t.real, t.vec2
    shapes = manifold_functions(dtype, False)
    Hull, Frame = shapes.Hull, shapes.Frame
    Lengths = wp.types.vector(3, real)
    macros = {"LANES": LANES, "EPSILON": EPSILON[dtype], "PARALLEL": PARALLEL}
    macros |= {"CHUNK": CHUNK, "FIELDS": FIELDS, "SCRATCH": SCRATCH, "POLYGON": int(ShapeType.POLYGON)}
    around = ("prelude.h", "predicted.h", "solve/bodies.h", "side.h", "recycle/sides.h", "recycle/scratch.h")

    @wp.func_native(native_code("recycle/carry.h", dtype=dtype, LANES=LANES))
    def carry(w: wp.int32, pairs: t.Pairs): ...

    @wp.func_native(native_code(*around, "recycle/meet_again.h", dtype=dtype, **macros))
    def meet_again(
        w: wp.int32,
        ends: wp.vec2i,
        lengths: Lengths,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        pairs: t.Pairs,
        scratch: wp.uint64,
    ) -> wp.int32: ...

    @wp.func_native(
        native_code(
            *around, "recycle/meet_discs.h", dtype=dtype, DISC=int(ShapeType.DISC), HORIZON=HORIZON, FEW=FEW, **macros
        )
    )
    def meet_discs(
        w: wp.int32,
        ends: wp.vec2i,
        lengths: Lengths,
        model: t.Model,
        state: t.State,
        motion: t.Motion,
        pairs: t.Pairs,
        scratch: wp.uint64,
    ): ...

    @wp.func_native(
        native_code(
            "recycle/scratch.h",
            "recycle/take_met.h",
            dtype=dtype,
            SHIFT_A=KEY_SHAPE_BITS + KEY_FEATURE_BITS,
            SHIFT_B=KEY_FEATURE_BITS,
            **macros,
        )
    )
    def take_met(
        w: wp.int32,
        span: wp.vec3i,
        found: wp.int32,
        config: t.Config,
        model: t.Model,
        pairs: t.Pairs,
        contacts: t.Contacts,
        scratch: wp.uint64,
    ) -> wp.vec2i: ...

    @wp.func_native(
        native_code("prelude.h", "collide/hull.h", "recycle/keep.h", dtype=dtype, ROUNDING=ROUNDING[dtype], **macros)
    )
    def keep(
        w: wp.int32,
        pair: wp.int32,
        a: Hull,
        b: Hull,
        frame: Frame,
        sizes: vec2,
        moves: vec2,
        vertices: wp.array(dtype=vec2),
        normals: wp.array(dtype=vec2),
        pairs: t.Pairs,
    ): ...

    @wp.func_native(native_code("recycle/scratch.h", "recycle/keeps.h", dtype=dtype, **macros))
    def keeps(i: wp.int32, scratch: wp.uint64) -> wp.int32: ...

    return SimpleNamespace(
        Lengths=Lengths,
        carry=carry,
        meet_again=meet_again,
        meet_discs=meet_discs,
        take_met=take_met,
        keeps=keeps,
        keep=keep,
    )
