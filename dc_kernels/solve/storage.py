"""The contact solver's arrays: rows of contacts and joints, history of a solve, and its statistics."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dc_kernels.model.arrays import ArrayGroup, Model
from dc_kernels.model.config import SolverConfig
from dc_kernels.model.enums import Flag
from dc_kernels.model.fields import ROLLING, ROWS, STATS
from dc_kernels.model.room import Room
from dc_kernels.model.settings import counted
from dc_kernels.solve.iteration import PAST
from dc_kernels.solve.joints import TREE_JOINT, TREE_MOVES, Apart, Forest
from dc_kernels.solve.rows import COLORS, COLUMNS, LANES, OWN, SURFACED, resists_rolling

MOST_HISTORY = 10**8  # numbers of all worlds: each solve clears what it leaves over, and an interrupt must not wait
SPARE_BLOCKS = 10  # blocks beyond full ones: a colour's last block is partly empty, and piles have 6-10 colours


class Rows(ArrayGroup):
    """Solver rows and colours (``model.fields.ROWS``)."""

    table = ROWS


class SolveStats(ArrayGroup):
    """Statistics of the last solve of each world (``model.fields.STATS``).

    ``history`` has the largest impulse change of each sweep, (W, max_sweeps), zero beyond ``sweeps``; it is (W, 0)
    unless the settings ask for it.
    """

    table = STATS

    def __repr__(self) -> str:
        """Worlds, what the last solve took, scalar, backend and device."""
        sweeps, residual = self.numpy("sweeps"), self.numpy("residual")
        last = ""
        if len(sweeps):
            least, most = int(sweeps.min()), int(sweeps.max())
            last = f"{counted(most, 'sweep') if least == most else f'{least} to {most} sweeps'}, residual "
            last += f"{residual.max():.2g}; " if len(sweeps) == 1 else f"up to {residual.max():.2g}; "
        kind = f"{self.dtype.name}, {self.backend} on {self.device}"
        return f"<{type(self).__name__}: {counted(len(sweeps), 'world')}; {last}{kind}>"


def sweeps_kept(config: SolverConfig, worlds: int) -> int:
    """Sweeps of each world whose change is kept.

    Raises:
        MemoryError: those of all worlds are more than ``MOST_HISTORY``.
    """
    sweeps = config.max_sweeps if config.history else 0
    if sweeps * worlds > MOST_HISTORY:
        raise MemoryError(
            f"SolveStats.history of max_sweeps {sweeps} in {worlds} worlds would be {sweeps * worlds} numbers; "
            f"it may be {MOST_HISTORY}"
        )
    return sweeps


class SolverStorage:
    """Rows, stats and their room; their kernels are ``pack_rows``, those of a schedule, ``unpack_impulses``.

    Attributes:
        rows: packed rows of the step.
        stats: what the last solve did.
        room: blocks of LANES rows reserved for each world.
    """

    def __init__(
        self,
        model: Model,
        config: SolverConfig,
        variant: str,
        *,
        contacts: np.ndarray,
        bodies: int,
        at_once: int,
        any_colors: bool = False,
        own_rows: np.ndarray | None = None,
        lines: bool = True,
    ) -> None:
        """Reserve rows for the joints and for so many contacts of each world.

        Args:
            model: of the simulation.
            config: settings of the solver.
            variant: layout of the rows, a key of ``rows.COLUMNS``.
            contacts: reserved for each world, (W,).
            bodies: of all worlds, padding bodies included.
            at_once: worlds whose solves may be in flight together.
            own_rows: of general Jacobians in each world, (W,); None: there are none.
            lines: whether the joints of the model are packed as rods.
            any_colors: reserve for whatever colours so many contacts may have; else for those of usual piles.
        """
        self.at_once, self._any_colors = at_once, any_colors
        self._width, self._surfaced = len(COLUMNS[variant]) * LANES, variant in SURFACED
        self._rolls = resists_rolling(model)
        rods = np.diff(model.numpy("joint_start")).astype(np.int64) * lines
        own_rows = np.zeros_like(rods) if own_rows is None else own_rows
        self._joints = rods + own_rows
        self._contacts = int(contacts.sum())
        self._most_bodies = int(np.diff(model.numpy("body_start")).max(initial=0))
        self.room = Room("blocks of rows", Flag.ROW_OVERFLOW, self._blocks_for(contacts))
        worlds = model.world_count
        sizes = {
            **model.sizes,
            "joint": model.joint_count,
            "contact": int(contacts.sum()),
            "body+1": bodies,
            "world color": worlds * COLORS,
            "world color+1": worlds * (COLORS + 1),
            "sweep": sweeps_kept(config, worlds),
            "row direction": 0,
            "row past": 0,
            "own row": int(own_rows.sum()),
            "stiff body": model.body_count if variant in OWN else 0,
            **dict.fromkeys(("tree", "tree joint", "tree factor", "tree wanted", "tree move"), 0),
            **dict.fromkeys(("tree+1", "apart", "apart body+1"), 0),
        }
        sizes.update(self._row_sizes(sizes, config))
        self.rows = Rows(sizes, model.dtype, model.device, model.backend)
        self.stats = SolveStats(sizes, model.dtype, model.device, model.backend)
        self.rows.fill("block_start", self.room.starts())
        self._lay_out(rods, own_rows)

    def plant(self, forest: Forest, bodies: int) -> None:
        """Take the trees of the joints, which are then solved directly.

        Args:
            forest: of all worlds.
            bodies: of all worlds, 0 where there are no trees.
        """
        count = len(forest.row)
        sizes = {"tree joint": count, "tree factor": TREE_JOINT * count, "tree wanted": 3 * count}
        sizes["tree move"] = TREE_MOVES * bodies
        sizes |= {"tree": len(forest.first) - 1, "tree+1": len(forest.first)}
        self.rows.reallocate([name for name in ROWS if name.startswith("tree_")], **sizes)
        for name, values in forest._asdict().items():
            self.rows.fill(f"tree_{name}", values)

    def separate(self, apart: Apart) -> None:
        """Take the bodies that joints keep from colliding with each other."""
        sizes = {"apart": len(apart.body), "apart body+1": len(apart.start)}
        self.rows.reallocate([name for name in ROWS if name.startswith("apart_")], **sizes)
        for name, values in apart._asdict().items():
            self.rows.fill(f"apart_{name}", values)

    def _lay_out(self, rods: np.ndarray, own_rows: np.ndarray) -> None:
        """Write where the rods and the general rows of each world begin."""
        for name, count in (("line_start", rods), ("row_start", own_rows)):
            self.rows.fill(name, np.concatenate([[0], np.cumsum(count)]).astype(np.int32))

    def _blocks_for(self, contacts: np.ndarray) -> np.ndarray:
        """Blocks reserved for so many contacts and the joints of each world."""
        rows = contacts + self._joints
        if self._any_colors:
            return np.minimum(-(-rows // LANES) + COLORS, rows)
        return -(-rows // LANES) + SPARE_BLOCKS

    def _row_sizes(self, sizes: dict[str, int], config: SolverConfig) -> dict[str, int]:
        """Sizes of the axes that follow the room, and of what the settings, or earlier ones, ask for."""
        pairs = self.room.total * 2 * LANES
        direction = sizes["row direction"] > 0 or config.acceleration == "nncg"
        past = sizes["row past"] > 0 or config.acceleration != "none"
        return {
            "row column": self.room.total * self._width,
            "row pair": pairs,
            "row direction": pairs if direction else 0,
            "row past": self.at_once * self.past_width if past else 0,
            "row lane": self.room.total * LANES if self._surfaced else 0,
            "switched contact": self._contacts if self._surfaced and config.contact_switches else 0,
            ROLLING: self._contacts if self._rolls else 0,
        }

    def use(
        self, variant: str, contacts: np.ndarray, config: SolverConfig, rods: np.ndarray, own_rows: np.ndarray
    ) -> None:
        """Lay out rows of another variant, with so many rods and general rows of each world, from now on.

        The next step makes them.
        """
        self._width, self._surfaced = len(COLUMNS[variant]) * LANES, variant in SURFACED
        self._joints = rods + own_rows
        bodies = self.rows.sizes["body"] if variant in OWN else 0
        self.relayout(contacts, config, {"own row": int(own_rows.sum()), "stiff body": bodies})
        self._lay_out(rods, own_rows)

    def adopt(self, rows: Rows, stats: SolveStats, slots: np.ndarray) -> None:
        """Take over the rows of the same bodies, and their room."""
        self.rows, self.stats, self.room.slots = rows, stats, slots

    @property
    def past_width(self) -> int:
        """Numbers that a world's accelerated solve may have to look back on."""
        rows = int(self.room.slots.max(initial=0)) * 2 * LANES
        velocities = -(-4 * self._most_bodies // LANES) * LANES  # a world's part begins with a whole vector
        return PAST * rows + velocities

    @property
    def used(self) -> np.ndarray:
        """Blocks of each world at the last step, (W,)."""
        return self.rows.numpy("block_needed")

    def keep_history(self, config: SolverConfig) -> None:
        """Allocate the history of sweeps as the settings want it, unless it is so already.

        Raises:
            MemoryError: see ``sweeps_kept``.
        """
        sweeps = sweeps_kept(config, self.stats.sizes["world"])
        if sweeps != self.stats.sizes["sweep"]:
            self.stats.reallocate(("history",), sweep=sweeps)

    def switch(self, config: SolverConfig) -> None:
        """Allocate the surface speeds of contacts that may be changed, or free them."""
        wanted = self._row_sizes(self.rows.sizes, config)["switched contact"]
        if wanted != self.rows.sizes["switched contact"]:
            self.rows.reallocate(("surface_speed",), **{"switched contact": wanted})

    def roll(self, rolls: bool) -> None:
        """Allocate the places of the impulses of rolling resistance, or free them."""
        self._rolls = rolls
        self.rows.reallocate(("roll_slot",), **{ROLLING: self._contacts if rolls else 0})

    def provide(self, config: SolverConfig) -> bool:
        """Allocate what an iteration needs and has not got yet; whether there was any."""
        wanted = self._row_sizes(self.rows.sizes, config)
        missing = {"direction": "row direction", "past": "row past"}
        missing = {name: axis for name, axis in missing.items() if wanted[axis] and not self.rows.sizes[axis]}
        for name, axis in missing.items():
            self.rows.reallocate((name,), **{axis: wanted[axis]})
        return bool(missing)

    def relayout(self, contacts: np.ndarray, config: SolverConfig, sizes: Mapping[str, int] | None = None) -> None:
        """Allocate the rows anew for so many contacts of each world, and other ``sizes``; the next step makes them."""
        self.room.slots = np.maximum(self.room.slots, self._blocks_for(contacts))
        self._contacts = int(contacts.sum())
        changed = {**(sizes or {}), "contact": self._contacts, **self._row_sizes(self.rows.sizes, config)}
        self.rows.renew(**changed)
        self.rows.assign("block_start", self.room.starts())
