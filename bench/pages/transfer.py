"""Sections of the way to the grid and back: its cost, and what a round trip loses."""

from __future__ import annotations

from bench.learning.roundtrip import BINS, SAMPLE, TABLE, place
from bench.pages.markdown import Record, figure, paragraphs, table


def transfer(record: Record) -> str:
    """Show nanoseconds per particle beside torch, and microseconds of a thesis world beside the theses' way."""
    labels = {
        "splat": "**splat**, random order",
        "splat_placed": "**splat**, by place",
        "index_add": "torch `index_add_`, random order",
        "gather_random": "**bilinear gather**, random order",
        "gather_placed": "**bilinear gather**, by place",
        "grid_sample": "torch `grid_sample`, random order",
        "grid_sample_placed": "torch `grid_sample`, by place",
        "splat_two_threads": "splat, random order, 2 threads",
        "splat_dense": "splat, 1 node a particle",
        "splat_sparse": "splat, 13 nodes a particle",
        "splat_spiky": "splat, spiky",
        "splat_gaussian": "splat, gaussian",
        "splat_cubic": "splat, cubic",
        "splat_wendland": "splat, wendland",
        "splat_bilinear": "splat, bilinear",
        "splat_bspline": "splat, bspline",
    }
    rows = [
        (text, *(record.get(f"{key}_{count}_ns") for count in (100_000, 1_000_000))) for key, text in labels.items()
    ]
    world = [
        ("six channels to 61 x 61 nodes", record["world_splat_us"]),
        (f"two channels back at {record['contacts']} contacts", record["world_gather_us"]),
        ("bodies alone (four channels)", record["world_bodies_us"]),
        ("contacts alone (two channels)", record["world_contacts_us"]),
        ("six channels, a world without contacts", record["falling_splat_us"]),
        ("Wu (2018): splat", record["theses_splat_us"]),
        ("Wu (2018): gather", record["theses_gather_us"]),
        ("SciPy and NumPy at their best: splat", record["theses_numpy_splat_us"]),
        ("SciPy and NumPy at their best: gather", record["theses_numpy_gather_us"]),
    ]
    return paragraphs(
        "Particles to the grid and back: float32, 4 channels, poly6 with h = 2 spacings, the weights of a particle "
        "sum to 1, 4 nodes a particle, one thread unless said.",
        table(("ns per particle", "1e5", "1e6"), rows),
        f"`index_add_` takes {record['over_index_add']:.1f} times as long as a splat, `grid_sample` "
        f"{record['over_grid_sample']:.1f} times as long as a gather of 1e5.",
        "A network's channels of one settled thesis world (100 discs), launches included:",
        table(("a thesis world", "us"), world),
        f"There and back that is {figure(record['over_theses'])} times faster than the way of Wu's thesis (k-d tree of "
        f"the particles, Python loop over the nodes), and {figure(record['over_theses_numpy'])} times faster than the "
        "best that SciPy and NumPy can do. What nobody asks for is not computed, and untouched parts of an image are "
        "neither cleared nor written.",
    )


def roundtrip(record: Record) -> str:
    """Show the entries of Engedal's table 1 (2018) beside ours."""
    rows = []
    for (spacing, h), printed in TABLE.items():
        cells = (f"{record[f'{name}_{place(spacing, h)}']:.4f}" for name in ("mass", "impulse"))
        rows.append(
            (f"{spacing:g} / {h:g}", *(f"{ours} ({theirs:.4f})" for ours, theirs in zip(cells, printed, strict=True)))
        )
    entries = 2 * len(TABLE)
    name, spacing, h = max(
        ((name, *pair) for name in ("mass", "impulse") for pair in TABLE),
        key=lambda entry: abs(record.get(f"{entry[0]}_{place(*entry[1:])}_deviation", 0.0)),
    )
    worst, theirs = f"{name}_{place(spacing, h)}", TABLE[spacing, h][("mass", "impulse").index(name)]
    scatters = abs(record[worst] - theirs) / record[f"{worst}_scatter"]
    return paragraphs(
        f"Particle to grid to particle, poly6, reverse SPH: mean absolute difference of {figure(record['worlds'])} "
        "worlds after 200 steps (masses: 50 discs in 10 m). In brackets the figures that Engedal (2018) printed "
        f"for {SAMPLE}.",
        table(("spacing / h [m]", "body mass [kg]", "normal impulse of contacts [N s]"), rows),
        f"{record['within_tenth']} of {entries} entries lie within 10 %; the largest deviation is "
        f"{record['worst_deviation']:.0%}, {scatters:.1f} times the scatter of a mean of {SAMPLE} worlds (no entry "
        f"deviates by more than {record['worst_scatters']:.1f} times it). Entries printed as 0.0000 are at most "
        f"{record['worst_zero']:.0e} here. At 0.25 / 0.5 m the theses' transfer loses "
        f"{record['theirs_0.25_0.5']:.3f} N s of a mean impulse of {record['impulse']:.2f}; with the contacts sorted "
        f"into {BINS} bins by the direction of their normals (`bins={BINS}`) it loses {record['bins_0.25_0.5']:.0e}.",
    )
