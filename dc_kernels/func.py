"""Functions of contact for your own kernels: manifolds of two shapes, Coulomb's cone, relative speeds.

    import warp as wp
    import dc_kernels as dc

    shapes = dc.func.shapes("float32")

    @wp.kernel
    def gaps(center: wp.array(dtype=wp.vec2), radius: wp.array(dtype=float), gap: wp.array(dtype=float)):
        i = wp.tid()
        m = shapes.disc_disc(center[i], radius[i], center[i + 1], radius[i + 1])
        gap[i] = m.gap0

The narrowphase and the solver use these functions. They run on any device of Warp; those of shapes have no adjoints.
Generic functions take float32 and float64:

- ``cross(a, b)``, ``rotate(c, s, v)`` and ``rotate_back(c, s, v)`` by a cosine and a sine, ``tangent(n)``: the normal
  rotated by -90 degrees.
- ``relative_speed(d, va, vb, ra, rb)``: speed of body B against A at a contact along a direction d [m/s], from their
  velocities (x, y, spin) and the arms of the contact crossed with d [m] (Wu 2018, equations 2.21 and 2.22).
- ``project_cone(z, mu)``: the nearest point to an impulse z = (normal, tangential) in Coulomb's cone.
- ``natural_map_squared(x, z, mu)``: squared distance of an impulse x from the projection of a step z from it.
"""

from __future__ import annotations

from types import SimpleNamespace

from dc_kernels.model.dtypes import float_dtype, float_name
from dc_kernels.runtime.backends import kernel_file
from dc_kernels.runtime.building import building

__all__ = [
    "cross",
    "natural_map_squared",
    "project_cone",
    "relative_speed",
    "rotate",
    "rotate_back",
    "shapes",
    "tangent",
]


with building():
    _common, _laws = kernel_file("warp", "common"), kernel_file("warp", "solve.laws")
    _manifold = kernel_file("warp", "collide.manifold")

cross, rotate, rotate_back, tangent = _common.cross, _common.rotate, _common.rotate_back, _common.tangent
natural_map_squared, project_cone = _laws.natural_map_squared, _laws.project_cone
relative_speed = _laws.relative_speed


def shapes(dtype: str = "float32") -> SimpleNamespace:
    """Return the functions and structs for shapes of a scalar type; a shape is the hull of its vertices plus a radius.

    A ``Manifold`` has ``count`` points, up to two: ``normal`` from the first shape to the second, and of each point
    ``point0``/``point1`` midway between the surfaces [m], ``gap0``/``gap1``, negative where they overlap [m], and
    ``feature0``/``feature1``, which identify the points from step to step.

    - ``disc_disc(pa, ra, pb, rb)``: two discs, by their centres and radii.
    - ``hull_of(shape, kind, radius, vertex_start)``: the ``Hull`` of a shape by its index in arrays like those of a
      model; kind is a ``ShapeType``, POLYGON or SEGMENT. Or set ``first``, ``count``, ``segment`` and ``radius`` of a
      ``Hull()``.
    - ``hull_disc(hull, p, r, vertices, vertex_normals)``: a hull and a disc at p in the hull's frame; normal from the
      hull to the disc. The normals are those of the edges from each vertex to the next, counter-clockwise.
    - ``frame_of(c, s, x)``: the ``Frame`` that rotates by an angle of cosine c and sine s, then translates by x.
    - ``hull_hull(a, b, frame, reach, slack, overlap, vertices, vertex_normals)``: two hulls in the frame of A, to which
      ``frame`` takes that of B. No points if they are farther apart than ``reach`` [m]; two separating axes within
      ``slack`` [m] count as equal; ``beside`` of the manifold tells whether another axis separates them too, up to an
      ``overlap`` [m]. By separating axes and clipping, as in Box2D v3.

    Args:
        dtype: "float32" or "float64".

    Returns:
        A namespace with these names; take the functions from it within a kernel, or give them names before.

    Raises:
        ValueError: the dtype is another.
    """
    name = float_name(float_dtype(dtype))
    with building():
        return _manifold.manifold_functions(name, False)
