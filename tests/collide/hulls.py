"""Pairs of shapes and their contact points."""

import math

import numpy as np

import dc_kernels as dc
from tests.geometry import (
    contacts_of,
    hull_distance,
    rotation,
    separation,
    simulate,
)

STATIC = dc.BodyType.STATIC
DT = 1e-3


def new_world(builder=None, **options):
    builder = builder or dc.ModelBuilder()
    builder.add_world(**{"gravity": (0, 0), "length_scale": 1.0, **options})
    return builder


def collide(builder, dtype="float64"):
    sim = simulate(builder, dtype)
    sim.collide(DT)
    return sim


def two(add_a, add_b, a=((0, 0), 0.0), b=((0, 0), 0.0), dtype="float64", **body_a):
    """Contacts of two bodies; ``add`` takes builder and body, ``a`` and ``b`` are position and angle."""
    builder = new_world()
    add_a(builder, builder.add_body(*a, **body_a))
    add_b(builder, builder.add_body(*b))
    return contacts_of(collide(builder, dtype))


def disc(radius, center=(0, 0)):
    return lambda builder, body: builder.add_disc(body, radius, center)


def box(width, height, radius=0.0):
    return lambda builder, body: builder.add_box(body, width, height, radius=radius)


def capsule(half, radius):
    return lambda builder, body: builder.add_capsule(body, (-half, 0), (half, 0), radius)


def random_hull(rng, low=2, high=9, rounded=0.4):
    """Vertices about their centroid or so, and a radius."""
    n = int(rng.integers(low, high))
    radius = rng.uniform(0.05, 0.5) if n == 2 or rng.random() < rounded else 0.0
    if n == 2:
        half = rng.uniform(0.2, 2.0)
        return np.array([(-half, 0), (half, 0)]), radius
    while True:
        angles = np.sort(rng.uniform(0, 2 * math.pi, n))
        if np.diff(angles, append=angles[0] + 2 * math.pi).min() > 0.2:
            break
    points = np.stack([np.cos(angles), np.sin(angles) * rng.uniform(0.3, 1)], axis=1)
    return (points - points.mean(axis=0)) * rng.uniform(0.3, 2), radius


def add_hull(builder, body, points, radius):
    if len(points) == 1:
        return builder.add_disc(body, radius, points[0])
    if len(points) == 2:
        return builder.add_capsule(body, *points, radius)
    return builder.add_polygon(body, points, radius)


def approach(p, q, target, direction, measure):
    """How far to move q from p along a direction until ``measure`` is the target, to a micrometre (bisection)."""
    low, high = 0.0, 20.0
    for _ in range(25):
        middle = (low + high) / 2
        if measure(p, q + middle * direction) > target:
            high = middle
        else:
            low = middle
    return high * direction


def colliding(meetings):
    """A simulation of meetings, each in a world of its own, whose contacts have been found."""
    builder = dc.ModelBuilder()
    for meeting in meetings:
        new_world(builder)
        for (points, radius), pose in meeting:
            add_hull(builder, builder.add_body(*pose), points, radius)
    return collide(builder)


def random_meeting(rng, gap=None, depth=None, more=0.0):
    """Two random hulls in body frames and their poses, a gap apart or with their cores overlapping by ``depth``."""
    measure, low = (hull_distance, 2) if depth is None else (separation, 3)
    while True:
        (p, rp), (q, rq) = random_hull(rng, low), random_hull(rng, low)
        target = gap + rp + rq if depth is None else -depth
        a, b = rng.uniform(-4, 4, 2)
        direction = rotation(rng.uniform(-4, 4)) @ (1.0, 0.0)
        aside = rng.uniform(-1, 1) * np.array((-direction[1], direction[0]))
        here, there = p @ rotation(a).T, q @ rotation(b).T + aside
        if measure(here, there) < target:
            break
    place = rng.uniform(-3, 3, 2)
    move = approach(here, there, target, direction, measure)
    return ((p, rp + more), (place, a)), ((q, rq + more), (place + move + aside, b))
