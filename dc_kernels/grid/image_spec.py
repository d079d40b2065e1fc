"""Description of the images of a scene, shared by simulation, data sets, training and files of networks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, asdict, dataclass, field
from typing import Any

import numpy as np

from dc_kernels.grid.channels import BODY_CHANNELS, CONTACT_CHANNELS, IMPULSES, channel_codes
from dc_kernels.grid.grid import Grid
from dc_kernels.grid.stencil import Stencil
from dc_kernels.model.settings import Count, NotNegative, Settings, WrongType, shown
from dc_kernels.runtime.inputs import check_mapping


@dataclass(frozen=True)
class ImageSpec(Settings):
    """Grid, channels and stencil of the images that show bodies and contacts.

    Raises:
        ValueError: a channel is unknown or repeated, or a setting is out of range.
    """

    grid: Grid
    """Grid of the nodes, relative to each world's origin."""
    _: KW_ONLY
    body_channels: tuple[str, ...] = ("mass", "velocity_x", "velocity_y", "omega")
    """Channels of bodies, keys of ``channels.BODY_CHANNELS``; may be empty."""
    contact_channels: tuple[str, ...] = ("normal_x", "normal_y")
    """Channels of contacts, keys of ``channels.CONTACT_CHANNELS``; may be empty."""
    stencil: Stencil = field(default_factory=Stencil)
    """Weights of the nodes for bodies and contacts; not normalized by "shepard"."""
    bins: Count = 1
    """Number of bins by which contacts are separated, over the half circle of normal directions (n and -n share a bin);
    bin b is centred on the angle b pi / bins [1]."""
    walls: NotNegative | None = 100.0
    """Mass that is added to the nodes covered by static shapes (``area.wall_nodes``) [kg]; None, or no channel "mass":
    none."""
    area: bool = False
    """Whether bodies are splatted over their area, in cells of a spacing (``area.area_points``)."""

    def check(self) -> None:
        """Raise a ``ValueError`` for channels that do not exist, or settings that do not go together."""
        for name, table in (("body_channels", BODY_CHANNELS), ("contact_channels", CONTACT_CHANNELS)):
            channel_codes(name, getattr(self, name), table)
        if not self.body_channels and not self.contact_channels:
            raise ValueError("body_channels and contact_channels are both empty; an image needs a channel")
        if self.stencil.normalize == "shepard":
            raise ValueError("stencil.normalize is 'shepard'; that of images must be 'particle' or 'sum'")
        self.stencil.support(self.grid.spacing)

    @property
    def channels(self) -> tuple[str, ...]:
        """Names in the order of the image: the bodies', then the contacts', "normal_x/3" for bin 3 of several."""
        contacts = self.contact_channels
        binned = [f"{name}/{b}" for b in range(self.bins) for name in contacts] if self.bins > 1 else contacts
        return (*self.body_channels, *binned)

    @property
    def impulse_channels(self) -> int:
        """How many channels an image of impulses has: the normal and the tangential impulse of each bin [1]."""
        return len(IMPULSES) * self.bins

    @property
    def body_codes(self) -> np.ndarray:
        """Codes of the bodies' channels in the kernels, int32."""
        return channel_codes("body_channels", self.body_channels, BODY_CHANNELS)

    @property
    def contact_codes(self) -> np.ndarray:
        """Codes of the contacts' channels in the kernels, int32."""
        return channel_codes("contact_channels", self.contact_channels, CONTACT_CHANNELS)

    @property
    def wall_channel(self) -> int:
        """The channel that walls are added to; -1: none."""
        return self.body_channels.index("mass") if self.walls and "mass" in self.body_channels else -1

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as plain values, as JSON has them."""
        values = asdict(self)
        values["grid"]["origin"] = [float(x) for x in self.grid.origin]
        return {**values, "body_channels": list(self.body_channels), "contact_channels": list(self.contact_channels)}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> ImageSpec:
        """Return what ``to_dict`` described; what is left out is as by default.

        Raises:
            TypeError, ValueError: for an unknown name, one that is missing, or a value of another type or out of range.
        """
        given = dict(check_mapping("values", values))
        try:
            grid = dict(check_mapping("grid of values", given.pop("grid")))
            stencil = dict(check_mapping("stencil of values", given.pop("stencil", {})))
            grid["origin"] = tuple(grid["origin"])
            return cls(Grid(**grid), stencil=Stencil(**stencil), **given)
        except WrongType:
            raise
        except KeyError as error:
            raise ValueError(f"values of images are {shown(values)}; they lack {error}") from None
        except TypeError as error:  # a keyword that there is not, or an origin that is no tuple
            raise ValueError(f"values of images are {shown(values)}: {error}") from None
