"""Sections of the benches that take times: worlds, sweeps, steps, neighbours, data sets, training, startup."""

from __future__ import annotations

from bench.cases import SCALING_WORLDS, SWEEP_PILES
from bench.pages.markdown import Record, figure, paragraphs, table
from bench.peers.peers import PEER_TEXT
from bench.speed.overhead import SIZES, creation_rows
from bench.speed.skips import ROWS as SKIPS
from bench.speed.threads import SETTINGS
from bench.speed.threads import SIZES as PILES


def worlds(record: Record) -> str:
    """Show worlds per second and overlaps beside the peers."""
    ours = record["worlds_per_s"]
    rows = [("**deep-contact**, to 1e-4 N s", ours, 1.0, record["ours_overlap_mm"], record["ours_overlap_max_mm"])]
    for name, text in PEER_TEXT.items():
        overlap = (record[f"{name}_overlap_mm"], record[f"{name}_overlap_max_mm"])
        rows.append((text, record[name], ours / record[name], *overlap))
    header = ("engine", "worlds/s", "ours over it", "mean overlap after the run [mm]", "largest [mm]")
    return paragraphs(
        "100 discs fall into a box, 250 steps of 0.01 s, 64 worlds, creation included. Each of our steps is solved to "
        "1e-4 N s from the cached impulses; another engine takes the iterations that its row says.",
        table(header, rows),
        f"Two threads take {record['threads_ratio']:.2f} times as many worlds per second as one. A step takes "
        f"{record['mean_sweeps']:.0f} sweeps in the mean; {record['share_capped']:.1%} of the steps end at the cap of "
        "1000 sweeps and report their residual.",
        "![worlds per second, and mean overlap, of five engines](../bench/results/worlds.png)",
    )


def sweep(record: Record) -> str:
    """Show the cost of a contact in a sweep."""
    rows = [
        (
            record[f"contacts_{target}"],
            record[f"discs_{target}"],
            record[f"ns_general_{target}"],
            record[f"ns_discs_{target}"],
        )
        for target in SWEEP_PILES
    ]
    return paragraphs(
        "One sweep of projected Gauss-Seidel over a settled pile, float32, one thread. The kernel of all shapes and "
        "the one for discs alone meet the same contacts.",
        table(("contacts", "discs", "any shape [ns per contact]", "discs only [ns per contact]"), rows),
    )


def scaling(record: Record) -> str:
    """Show time and memory of all of a step but its solve."""
    columns = ("collide_ns", "advance_ns", "ns_per_body", "bytes_per_body", "bytes_per_contact")
    rows = [
        (f"{number} x {figure(bodies)}", *(record[f"{column}_{bodies}"] for column in columns))
        for bodies, number in SCALING_WORLDS.items()
    ]
    header = ("worlds x discs", "collide [ns]", "advance [ns]", "sum [ns]", "bytes per body", "bytes per contact")
    return paragraphs(
        "Everything but the solve, on settled thesis piles, one thread: nanoseconds per body and step, and the memory "
        "reserved.",
        table(header, rows),
        f"A pile of 100 000 discs that are numbered at random instead of by place takes "
        f"{record['ns_per_body_shuffled']:.0f} ns: number bodies by place, as the scenes do.",
    )


def threads(record: Record) -> str:
    """Show what two threads gain within one world, and what two worlds do."""
    names = {"ms": "[ms a step]", "ratio": "one over two", "worth": "two worlds", "gained": "gained"}
    rows = [
        (
            bodies,
            record[f"threads_{bodies}"],
            *(record[f"{what}_{bodies}_{name}"] for name in SETTINGS for what in names),
        )
        for bodies in PILES
        if f"ratio_{bodies}_default" in record
    ]
    columns = (f"{setting}: {name}" for setting in ("default", "10 sweeps") for name in names.values())
    return paragraphs(
        "Whole steps of one world, settled piles side by side, on one thread and with `threads=2`; small worlds take "
        'one by themselves. "Two worlds": steps of two such worlds at once, on a thread each, over those of one: what '
        'two cores are worth; "gained": what part of that two threads within one world reach.',
        table(("discs", "threads used", *columns), rows),
        f"With every core kept busy by others, two threads take {record['oversubscribed_slowdown']:.2f} times as "
        f"long as one. A line of a cache took {record['round_trip_ns']:.0f} ns from one core to the other and back.",
    )


def neighbors(record: Record) -> str:
    """Show the nanoseconds per point of each method of search."""
    clouds = [key.removeprefix("pairs ") for key in record if key.startswith("pairs ")]
    methods = ("hash", "ckdtree", "tree", "all", "hashgrid", "lists")
    rows = [
        (
            " ".join(figure(int(word)) if word.isdigit() else word for word in cloud.split()),
            *(record.get(f"{method}_ns {cloud}") for method in methods),
            record.get(f"over_ckdtree {cloud}"),
        )
        for cloud in clouds
    ]
    header = ("points", "`hash`", "`kdtree` (SciPy)", "`tree`", "`all`", "`wp.HashGrid`", "`hash`, lists")
    return paragraphs(
        "Nanoseconds per point with about 6 neighbours each, float32, build and all pairs, one thread.",
        table((*header, "SciPy over `hash`"), rows),
    )


def generate(record: Record) -> str:
    """Show time and size of a data set."""
    rows = [
        (f"{record['worlds']} thesis worlds, {figure(record['states'])} states [s]", record["seconds"]),
        ("bytes of a state, file and index", record["bytes_per_step"]),
        ("contacts of a state", record["contacts"]),
        ("sweeps to the run's 1e-4 N s", record["mean_sweeps"]),
        ("further sweeps to the label's 1e-5 N s", record["mean_label_sweeps"]),
        ("states whose label reaches it [%]", 100.0 * record["label_reached"]),
    ]
    return paragraphs(
        f"Each state is solved to 1e-4 and on to 1e-5 N s, compressed and written; {record['machine']['threads']} "
        "threads.",
        table(("a data set", "value"), rows),
    )


def train(record: Record) -> str:
    """Show the minutes that training ContactNet takes."""
    how = "; the minutes are extrapolated from one round" if record["extrapolated"] else ""
    rows = [("minutes", record["minutes"]), ("steps", record["steps"])]
    if "step_s" in record:  # the quick form times it apart
        rows.append(("a step [s]", record["step_s"]))
    return paragraphs(
        f"Training of the ContactNet in the package from nothing, on one core{how}.", table(("", ""), rows)
    )


def startup(record: Record) -> str:
    """Show the time from the start of a process to the end of a first step."""
    rows = [
        (f"{name} kernel cache", record[f"{key}_s"], min(record[f"{key}_all_s"]), max(record[f"{key}_all_s"]))
        for name, key in (("full", "warm"), ("empty", "cold"))
    ]
    return paragraphs(
        "A new Python process up to the end of its first step. Warp compiles the kernels at first use and caches them.",
        table(("process start to first step [s]", "median", "lowest", "highest"), rows),
    )


def overhead(record: Record) -> str:
    """Show what a step of one body costs beside its kernels, what a second thread loses, and what creation takes."""
    rows = [
        ("`step()`", record["step_us_1_body"], record["step_over_graph_us"]),
        ("`run()`, a step", record["run_us_1_body"], record["run_over_graph_us"]),
        ("graph of a step, recorded by Warp", record["graph_us_1_body"], None),
        ("pymunk", record["pymunk_us_1_body"], None),
    ]
    sizes = [worlds * discs for worlds, discs in SIZES]
    shared = [(figure(n), record[f"threads1_us_{n}"], record[f"threads2_us_{n}"]) for n in sizes]
    made = [table(("one thesis world is made", "[ms]"), creation_rows(record))] if "creation_ms" in record else []
    return paragraphs(
        "A step of one disc at rest; below the graph's time lies what launching the kernels by their addresses saves.",
        table(("one body", "a step [us]", "over the graph [us]"), rows),
        f"Steps of more discs with one thread and with two, of which the largest loss is "
        f"{figure(record['threads2_penalty_us'])} us:",
        table(("discs at rest", "`threads=1` [us]", "`threads=2` [us]"), shared),
        *made,
    )


def skips(record: Record) -> str:
    """Show what features cost a scene that has them for one body."""
    rows = [
        (
            SKIPS[name].what,
            found["without_us"],
            found["with_us"],
            found["ratio"],
            found["difference_mm"],
            SKIPS[name].reason,
        )
        for name, found in record["rows"].items()
        if name in SKIPS
    ]
    header = ("one body, or a setting", "without [us]", "with [us]", "with over without", "difference [mm]", "why")
    return paragraphs(
        "A pile of discs at rest, and the pile with a feature given to a disc that lies apart or with a setting turned "
        "on: what a scene saves that does without.",
        table(header, rows),
    )


def population(record: Record) -> str:
    """Show what bodies and joints that come and go take."""
    names = {
        "step_us": "a step [us]",
        "add_us": "add a disc",
        "remove_us": "remove it",
        "add_batch_us": "add 100",
        "remove_batch_us": "remove them",
        "add_joint_us": "add a rod",
        "remove_joint_us": "remove it",
        "grow_us": "more slots",
        "slot_ns": "an empty slot in a step [ns]",
    }
    rows = [(size, *(row[name] for name in names)) for size, row in record["rows"].items()]
    return paragraphs(
        "Piles of discs at rest, between whose steps others come and go [us].", table(("discs", *names.values()), rows)
    )


def sleep(record: Record) -> str:
    """Show what sleep saves, what it costs, and what is different after it."""
    columns = ("bodies", "asleep_by_itself", "asleep_us", "asleep_step_us", "awake_slowdown", "half_share")
    rows = [
        (name, *(found[column] for column in (*columns, "wake_difference", "hit_difference")))
        for name, found in record["scenes"].items()
    ]
    header = (
        *("scene", "bodies", "asleep by themselves", "a step asleep: `run` [us]", "`step` [us]"),
        *("awake, sleep on over off", "every second world asleep over awake"),
        *("moved by waking, at most [mm]", "by a hit, in the mean [mm]"),
    )
    return paragraphs(
        "Piles at rest that sleep, and the same awake. Where not all fell asleep by themselves in 300 steps, as a "
        "pile creeps on, `sim.sleep` put the rest to sleep.",
        table(header, rows),
    )
