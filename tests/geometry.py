"""Plain float64 geometry that the collision tests compare with, and short cuts to a simulation's contacts."""

import itertools
import math

import numpy as np

import dc_kernels as dc
from dc_kernels.model.fields import KEY_FEATURE_BITS, KEY_SHAPE_BITS


def simulate(builder, dtype="float64", **options):
    model, state, joints = builder.finalize(dtype)
    return dc.Simulation(model, state, joints, **options)


def contacts_of(sim, world=0):
    """The world's contacts by field, and the contact points ``point`` in world coordinates."""
    first = int(sim.contacts.numpy("contact_start")[world])
    last = first + int(sim.contacts.numpy("contact_count")[world])
    names = ("key", "body_a", "body_b", "normal", "arm_a", "arm_b", "gap", "friction", "impulse", "color", "age")
    table = {name: sim.contacts.numpy(name)[first:last].copy() for name in names}
    table["point"] = sim.state.numpy("position")[table["body_a"]] + table["arm_a"]
    return table


def pairs_of(sim, world=0, names=("shape_a", "shape_b"), count="count"):
    """The world's candidate pairs (n, 2), as shape indices of the model."""
    first = int(sim.pairs.numpy("start")[world])
    last = first + int(sim.pairs.numpy(count)[world])
    return np.stack([sim.pairs.numpy(name)[first:last] for name in names], axis=1)


def kept_pairs_of(sim, world=0):
    """The world's pairs whose boxes with margin overlap, (n, 2)."""
    return pairs_of(sim, world, ("near_a", "near_b"), "near_count")


def shapes_of_key(key):
    """Shape A and shape B (within the world) and the feature of contact keys."""
    mask = (1 << KEY_SHAPE_BITS) - 1
    return key >> (KEY_SHAPE_BITS + KEY_FEATURE_BITS), (key >> KEY_FEATURE_BITS) & mask, key & (2**KEY_FEATURE_BITS - 1)


def core(sim, shape):
    """Vertices of a shape's hull in world coordinates (those of a segment without its neighbours), and its radius."""
    model, state = sim.model, sim.state
    body = model.numpy("shape_body")[shape]
    first, last = model.numpy("vertex_start")[shape : shape + 2]
    if model.numpy("shape_type")[shape] == dc.ShapeType.SEGMENT:
        last = first + 2
    local = model.numpy("vertices")[first:last].astype(float)
    if model.numpy("shape_type")[shape] == dc.ShapeType.DISC:
        local = model.numpy("shape_center")[shape : shape + 1].astype(float)
    angle = float(state.numpy("angle")[body])
    turned = local @ rotation(angle).T
    return turned + state.numpy("position")[body].astype(float), float(model.numpy("shape_radius")[shape])


def tight_boxes(sim):
    """Bounding boxes of all shapes, (n, 4): low x, low y, high x, high y."""
    boxes = []
    for shape in range(sim.model.shape_count):
        points, radius = core(sim, shape)
        boxes.append((*(points.min(axis=0) - radius), *(points.max(axis=0) + radius)))
    return np.array(boxes).reshape(-1, 4)


def rotation(angle):
    c, s = math.cos(angle), math.sin(angle)
    return np.array(((c, -s), (s, c)))


def points_to_edges(points, starts, ends):
    """Least distance of any point to any edge."""
    along = ends - starts
    length2 = np.maximum((along * along).sum(axis=1), 1e-300)
    to = points[:, None] - starts
    t = np.clip((to * along).sum(axis=2) / length2, 0.0, 1.0)
    away = to - t[..., None] * along
    return float(np.hypot(away[..., 0], away[..., 1]).min())


def edges(points):
    """The edges of a hull: one for a point (to itself) or two points, n for a polygon."""
    n = len(points)
    return [(points[i], points[(i + 1) % n]) for i in range(n if n > 2 else 1)]


def separation(p, q):
    """Largest over the edge normals of both polygons of the distance along it; negative where they overlap."""
    best = -math.inf
    for one, other in ((p, q), (q, p)):
        edge = np.roll(one, -1, axis=0) - one
        normal = np.stack((edge[:, 1], -edge[:, 0]), axis=1) / np.hypot(edge[:, 0], edge[:, 1])[:, None]
        best = max(best, float(((other @ normal.T).min(axis=0) - (one * normal).sum(axis=1)).max()))
    return best


def cross2(a, b):
    return a[0] * b[1] - a[1] * b[0]


def segments_cross(a, b, c, d):
    return cross2(b - a, c - a) * cross2(b - a, d - a) < 0 and cross2(d - c, a - c) * cross2(d - c, b - c) < 0


def inside(p, polygon):
    return len(polygon) > 2 and all(cross2(b - a, p - a) > 0 for a, b in edges(polygon))


def hull_distance(p, q):
    """Distance between two hulls of points, 0 where they overlap: every vertex against every edge."""
    if len(p) > 2 and len(q) > 2:
        meet = separation(p, q) <= 0.0
    else:
        meet = any(inside(x, q) for x in p) or any(inside(x, p) for x in q)
        meet = meet or any(segments_cross(*e, *f) for e, f in itertools.product(edges(p), edges(q)))
    if meet:
        return 0.0
    return min(
        points_to_edges(p, q, np.roll(q, -1, axis=0)),
        points_to_edges(q, p, np.roll(p, -1, axis=0)),
    )
