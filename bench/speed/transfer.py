"""Splat and gather: ns per particle on large images, us for a thesis world, and how much faster than other ways.

Large: uniformly random particles in random order, 4 channels in float32, poly6 with h = 2 spacings and per-particle
weights that sum to 1, four nodes a particle unless a row says otherwise; each call clears what the one before wrote.
A world: a settled thesis world, its six channels and two back at its contacts, launches included.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from bench import timing

SUMMARY = "splat and gather: ns per particle, us per thesis world, times faster than the theses' way and torch"
KEYS = (
    "splat_ns",
    "gather_ns",
    "world_splat_us",
    "world_gather_us",
    "over_theses",
    "over_index_add",
    "over_grid_sample",
)
THREADS = 2  # the rows that say so; all else runs on one

SIZES = (100_000, 1_000_000)
CHANNELS = 4
SPACING = 0.25
ROUNDS, ROUNDS_QUICK = 15, 5
OTHERS = ("spiky", "gaussian", "cubic", "wendland", "bilinear", "bspline")
WORLDS = 64


class Cloud:
    """Random particles with their transfer, image and values."""

    def __init__(
        self,
        count: int,
        nodes_each: float = 4.0,
        *,
        placed: bool = False,
        part: float = 1.0,
        kernel: Any = "poly6",
        threads: int = 1,
    ) -> None:
        """``placed``: numbered by place, in blocks of 8 x 8 nodes; ``part``: of each side that they lie in."""
        from dc_kernels.grid.grid import Grid
        from dc_kernels.grid.splat import allocate_image
        from dc_kernels.grid.stencil import BILINEAR, Stencil
        from dc_kernels.grid.transfer import Transfer

        side = round((nodes_each * count) ** 0.5)
        self.grid = Grid(rows=side, columns=side, spacing=SPACING)
        draw = np.random.default_rng(0)
        self.points = draw.uniform(0, part * SPACING * (side - 1), (count, 2)).astype(np.float32)
        if placed:
            block = (self.points // (8 * SPACING)).astype(int)
            self.points = np.ascontiguousarray(self.points[np.lexsort((block[:, 0], block[:, 1]))])
        self.values = draw.normal(size=(count, CHANNELS)).astype(np.float32)
        self.image = allocate_image(1, CHANNELS, self.grid)
        transfer = Transfer(self.grid, Stencil(kernel), threads=threads)
        self.splat = transfer.at(self.points).splat(self.values, self.image)
        self.back = np.zeros_like(self.values)
        self.gather = Transfer(self.grid, BILINEAR).at(self.points).gather(self.image, self.back)


def index_add(cloud: Cloud) -> Callable[[], Any]:
    """The same splat in torch: 4 x 4 nodes a particle, one ``index_add_``."""
    import torch

    points, values = torch.from_numpy(cloud.points), torch.from_numpy(cloud.values)
    rows, columns = cloud.grid.shape
    steps = torch.arange(4)
    image = torch.zeros(rows * columns, CHANNELS)

    def splat() -> Any:
        place = points / SPACING
        first = torch.ceil(place - 2).long()
        nodes = first[:, :, None] + steps  # (n, 2, 4)
        away = (nodes - place[:, :, None]).square_()
        weight = (1 - 0.25 * (away[:, 0, None, :] + away[:, 1, :, None])).clamp_(min=0).pow_(3)
        inside = ((nodes >= 0) & (nodes < torch.tensor([columns, rows])[:, None])).float()
        weight *= inside[:, 0, None, :] * inside[:, 1, :, None]
        weight /= weight.sum((1, 2), keepdim=True)
        nodes = torch.minimum(nodes.clamp_(min=0), torch.tensor([columns - 1, rows - 1])[:, None])
        index = nodes[:, 1, :, None] * columns + nodes[:, 0, None, :]
        image.zero_()
        image.index_add_(0, index.reshape(-1), (weight[..., None] * values[:, None, None]).reshape(-1, CHANNELS))
        return image.T.reshape(1, CHANNELS, rows, columns).contiguous()

    return splat


def grid_sample(cloud: Cloud) -> Callable[[], Any]:
    """The same bilinear gather in torch; its scaled coordinates are made beforehand."""
    import torch

    image = torch.from_numpy(cloud.image)
    span = torch.tensor([cloud.grid.columns - 1, cloud.grid.rows - 1]) * SPACING
    place = (torch.from_numpy(cloud.points) / span * 2 - 1).reshape(1, 1, -1, 2)

    def sample() -> Any:
        return torch.nn.functional.grid_sample(image, place, align_corners=True, padding_mode="border")

    return sample


def large(rounds: int) -> dict[str, Any]:
    """The rows of many particles on one image."""
    values: dict[str, Any] = {}
    clouds = {count: Cloud(count) for count in SIZES}
    placed = {count: Cloud(count, placed=True) for count in SIZES}
    functions: dict[str, Callable[[], Any]] = {}
    for count, cloud in clouds.items():
        functions[f"splat_{count}"] = cloud.splat
        functions[f"gather_random_{count}"] = cloud.gather
        functions[f"index_add_{count}"] = index_add(cloud)
        functions[f"grid_sample_{count}"] = grid_sample(cloud)
        functions[f"grid_sample_placed_{count}"] = grid_sample(placed[count])
        functions[f"splat_placed_{count}"] = placed[count].splat
        functions[f"gather_placed_{count}"] = placed[count].gather
    small = SIZES[0]
    functions[f"splat_dense_{small}"] = Cloud(small, 1.0).splat
    functions[f"splat_sparse_{small}"] = Cloud(small, 13.0).splat
    functions[f"splat_corner_{SIZES[1]}"] = Cloud(SIZES[1], 64.0, part=0.25).splat
    blank = Cloud(1, 64.0 * SIZES[1]).image
    functions[f"clear_{SIZES[1]}"] = lambda: blank.fill(0)
    functions[f"splat_two_threads_{SIZES[1]}"] = Cloud(SIZES[1], threads=2).splat
    for kernel in OTHERS:
        functions[f"splat_{kernel}_{small}"] = Cloud(small, kernel=kernel).splat
    times = timing.interleave(functions, rounds)
    for name, spent in timing.medians(times).items():
        values[f"{name}_ns"] = 1e9 * spent / int(name.rsplit("_", 1)[1])
    values["splat_ns"] = max(values[f"splat_{count}_ns"] for count in SIZES)
    # the bits are those of one thread, and what the others give is the same
    values["index_add_difference"] = float(
        np.abs(functions[f"index_add_{small}"]().numpy() - clouds[small].image).max()
    )
    clouds[small].gather()
    sampled = functions[f"grid_sample_{small}"]().numpy()[0, :, 0].T
    values["grid_sample_difference"] = float(np.abs(sampled - clouds[small].back).max())
    # not of the keys: 1e6 points in random order on a 64 MB image, where whoever gathers waits for 8e6 cache misses
    rows = (f"gather_random_{small}", *(f"gather_placed_{n}" for n in SIZES))
    values["gather_ns"] = max(values[f"{name}_ns"] for name in rows)
    for n in SIZES:
        values[f"over_grid_sample_{n}"] = ratio(times, f"grid_sample_{n}", f"gather_random_{n}")
        values[f"over_grid_sample_placed_{n}"] = ratio(times, f"grid_sample_placed_{n}", f"gather_placed_{n}")
    # 1e6 points keep the memory busy by either way, in either order
    values["over_grid_sample"] = min(values[f"over_grid_sample{order}_{small}"] for order in ("", "_placed"))
    values["over_index_add"] = min(ratio(times, f"index_add_{n}", f"splat_{n}") for n in SIZES)
    return values


def ratio(times: dict[str, list[float]], slow: str, fast: str) -> float:
    """Median over the rounds of how many times faster."""
    return float(np.median(np.divide(times[slow], times[fast])))


def world(rounds: int) -> dict[str, Any]:
    """The rows of thesis worlds."""
    from bench import cases
    from bench.learning.theses import SeedTransfer, ThesesTransfer
    from dc_kernels.grid.grid import Grid
    from dc_kernels.grid.image_spec import ImageSpec
    from dc_kernels.grid.images import Images
    from pipeline import scenes

    sim = cases.simulation(scenes.Thesis())
    sim.run(cases.STEPS, cases.DT)
    sim.collide(cases.DT)
    grid = Grid.thesis()
    spec = ImageSpec(grid)
    images = Images(sim, spec)
    labels = images.impulse_image()
    bodies_only = Images(sim, ImageSpec(grid, contact_channels=()))
    contacts_only = Images(sim, ImageSpec(grid, body_channels=()))
    two = Images(sim, ImageSpec(grid, body_channels=("mass", "omega"), contact_channels=()))
    batch = cases.simulation(scenes.Thesis(), WORLDS)
    batch.run(cases.STEPS, cases.DT)
    batch.collide(cases.DT)
    batch_images, batch_threads = Images(batch, spec), Images(batch, spec, threads=2)
    falling = cases.simulation(scenes.Thesis(), WORLDS)
    falling.collide(cases.DT)  # nothing touches yet
    falling_images = Images(falling, spec)

    theirs = {way.__name__: way(grid, 2 * grid.spacing) for way in (SeedTransfer, ThesesTransfer)}
    moving = sim.model.numpy("body_type") != 0
    state = [sim.state.numpy(name)[moving] for name in ("position", "velocity", "angular_velocity")]
    count = int(sim.contacts.numpy("contact_count")[0])
    body, arm = (sim.contacts.numpy(name)[:count] for name in ("body_a", "arm_a"))
    points = sim.state.numpy("position")[body] + arm
    normals, impulses = (sim.contacts.numpy(name)[:count] for name in ("normal", "impulse"))
    features = np.column_stack([sim.model.numpy("mass")[moving], state[1], state[2]])

    def their_splat(way: str) -> None:
        theirs[way].splat(state[0], features)
        theirs[way].splat(points, normals)

    their_image = theirs["SeedTransfer"].splat(points, impulses)
    functions: dict[str, Callable[[], Any]] = {
        "world_splat": images.splat,
        "world_gather": lambda: images.gather(labels),
        "world_bodies": bodies_only.splat,
        "world_contacts": contacts_only.splat,
        "world_two": two.splat,
        "theses_splat": lambda: their_splat("SeedTransfer"),
        "theses_gather": lambda: theirs["SeedTransfer"].gather(their_image, points),
        "theses_numpy_splat": lambda: their_splat("ThesesTransfer"),
        "theses_numpy_gather": lambda: theirs["ThesesTransfer"].gather(their_image, points),
        "batch_splat": batch_images.splat,
        "batch_threads": batch_threads.splat,
        "falling_splat": falling_images.splat,
    }
    # a call of a few us is timed many at once
    repeats = {name: 1 if "theses" in name else 200 for name in functions}

    def clock(call: Callable[[], Any]) -> float:
        name = next(n for n, function in functions.items() if function is call)
        return timing.seconds(lambda: [call() for _ in range(repeats[name])]) / repeats[name]

    times = timing.interleave(functions, rounds, clock=clock)
    values = {f"{name}_us": 1e6 * spent for name, spent in timing.medians(times).items()}
    for name in ("batch_splat", "batch_threads", "falling_splat"):
        values[f"{name}_us"] /= WORLDS
    ours = np.add(times["world_splat"], times["world_gather"])
    for way in ("theses", "theses_numpy"):
        spent = np.add(times[f"{way}_splat"], times[f"{way}_gather"])
        values[f"over_{way}"] = float(np.median(spent / ours))
    values["contacts"] = count
    # what is left out changes nothing of what is there
    whole, parts = images.numpy(), (bodies_only.numpy(), contacts_only.numpy())
    values["channels_difference"] = float(
        max(
            np.abs(whole - np.concatenate(parts, axis=1)).max(),
            np.abs(whole[:, [0, 3]] - two.numpy()).max(),
            np.abs(batch_images.numpy() - batch_threads.numpy()).max(),
        )
    )
    values["theses_difference"] = float(np.abs(their_image - labels.numpy()[0]).max() / np.abs(their_image).max())
    return values


def measure(quick: bool) -> dict[str, Any]:
    """All rows."""
    import torch

    torch.set_num_threads(1)
    rounds = ROUNDS_QUICK if quick else ROUNDS
    timing.progress("thesis worlds")
    values = world(rounds)
    timing.progress("many particles")
    values.update(large(rounds))
    return values


def report(values: dict[str, Any]) -> str:
    """Tables for people."""
    rows: list[tuple[Any, ...]] = []
    labels = {
        "splat": "splat, random order",
        "splat_placed": "splat, by place",
        "gather_random": "bilinear gather, random order",
        "gather_placed": "bilinear gather, by place",
        "index_add": "torch index_add_, random order",
        "grid_sample": "torch grid_sample, random order",
        "grid_sample_placed": "torch grid_sample, by place",
        "splat_dense": "splat, 1 node a particle",
        "splat_sparse": "splat, 13 nodes a particle",
        "splat_corner": "splat, 4 nodes a particle, all in a sixteenth of the image",
        "clear": "  clearing that image, which is not done",
        "splat_two_threads": "splat, random order, 2 threads",
        **{f"splat_{kernel}": f"splat, {kernel}" for kernel in OTHERS},
    }
    for name, label in labels.items():
        rows.append((label, *(values.get(f"{name}_{count}_ns") for count in SIZES)))
    world_rows = [
        ("6 channels to 61 x 61", values["world_splat_us"]),
        ("  bodies only (4)", values["world_bodies_us"]),
        ("  contacts only (2)", values["world_contacts_us"]),
        ("  mass and angular velocity only (2)", values["world_two_us"]),
        (f"2 channels back at {values['contacts']} contacts", values["world_gather_us"]),
        ("theses' way (Wu): splat", values["theses_splat_us"]),
        ("theses' way (Wu): gather", values["theses_gather_us"]),
        ("theses' way at its best, numpy: splat", values["theses_numpy_splat_us"]),
        ("theses' way at its best, numpy: gather", values["theses_numpy_gather_us"]),
        ("times faster than that", values["over_theses_numpy"]),
        (f"6 channels, a world of {WORLDS} settled", values["batch_splat_us"]),
        (f"6 channels, a world of {WORLDS} settled, 2 threads", values["batch_threads_us"]),
        (f"6 channels, a world of {WORLDS} without contacts", values["falling_splat_us"]),
        ("difference of what is left from what it is with all", values["channels_difference"]),
    ]
    one = timing.table(("a thesis world", "us"), world_rows)
    ratios = [
        (f"times faster than grid_sample, {order}", *(values[f"over_grid_sample{key}_{n}"] for n in SIZES))
        for order, key in (("random order", ""), ("by place", "_placed"))
    ]
    rows += ratios
    many = timing.table(("4 channels, ns per particle", *(f"{count:.0e}" for count in SIZES)), rows)
    keys = timing.table(("key", "value"), [(key, values[key]) for key in KEYS])
    return "\n\n".join((many, one, keys))
