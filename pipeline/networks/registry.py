"""Networks by name: those of this package, of installed packages, and of files that a user loads.

    @register("mine", GridConfig)
    class Mine(GridNetwork): ...

A name is looked up among what is registered, then in the modules of ``ELSEWHERE``, then among the entry points of the
group ``deep_contact.networks`` of installed packages: an entry point's name is the network's, its value the module that
registers it. This module loads without torch.
"""

from __future__ import annotations

import importlib
import sys
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata, util
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

from dc_kernels.model.settings import Count, Limits, Positive, Settings, checker

Width = Annotated[float, Limits(above=0.0, most=16.0)]
Share = Annotated[float, Limits(least=0.0, below=1.0)]
OptimizerName = Literal["sgd", "adamw"]
ScheduleName = Literal["constant", "decay", "onecycle"]
DecodeName = Literal["bilinear", "reverse"]

BODIES = ("mass", "velocity_x", "velocity_y", "omega")
NORMALS = ("normal_x", "normal_y")
GROUP = "deep_contact.networks"
"""Group of the entry points of packages that bring networks."""
PLUGIN = "deep_contact_plugin_"
"""Begins the names of the modules of files that a user loads."""


@dataclass(frozen=True, kw_only=True)
class Setup(Settings):
    """What a network reads of images and how it is trained, unless options say otherwise."""

    bodies: tuple[str, ...] = BODIES
    """Channels that show bodies."""
    contacts: tuple[str, ...] = NORMALS
    """Channels that show contacts."""
    nodes: Count = 61
    """Nodes along each side of the box [1]."""
    decode: DecodeName = "reverse"
    """Way back to the contacts: bilinear (Wu), or reverse SPH (Engedal)."""
    optimizer: OptimizerName = "adamw"
    """SGD with Nesterov momentum, or AdamW."""
    schedule: ScheduleName = "onecycle"
    """How the learning rate goes over the steps."""
    rate: Positive = 1e-3
    """Learning rate, of "onecycle" the highest."""


class Entry(NamedTuple):
    """What ``models.build`` makes a network from, and how it is trained."""

    config: type
    """Frozen dataclass of its sizes, whose values are plain: numbers, strings, booleans, tuples of them."""
    module: Callable[[Any], Any]
    """Makes the ``torch.nn.Module`` of a configuration."""
    setup: Setup | None
    """How it is trained on images; None: it does not read images of a data set."""
    plugin: str | None
    """File or module outside this package that registered it."""


NETWORKS: dict[str, Entry] = {}
"""Networks that are registered, by name."""
ELSEWHERE = {
    **dict.fromkeys(("convfc", "pressure", "peak", "unet"), "pipeline.networks.models"),
    "contactnet": "pipeline.contactnet.network",
    "stepnet": "pipeline.stepper.network",
}
"""Modules of this package that register networks when they are imported, by name of the network."""


def register(name: str, config: type, setup: Setup | None = Setup()) -> Callable[[Any], Any]:
    """Make a module class known to ``models.build``, to ``deep-contact train`` and to checkpoints under a name.

    Args:
        name: of the network.
        config: frozen dataclass of its sizes, from whose instance alone the class makes the module; a training fills
            the fields rows, columns, channels, outputs, width and dropout, as far as there are any.
        setup: what it reads and how it is trained; None: it is not trained on images.

    Raises:
        ValueError: the name is that of a network of this package, or another plugin has registered it.
    """

    def add(module: Any) -> Any:
        plugin = _origin(module)
        taken = NETWORKS[name].plugin if name in NETWORKS else None
        if plugin is not None and (name in ELSEWHERE or (name in NETWORKS and taken != plugin)):
            raise ValueError(f"network {name!r} of {plugin} is registered already, by {taken or 'this package'}")
        NETWORKS[name] = Entry(config, module, setup, plugin)
        return module

    return add


def _origin(module: Any) -> str | None:
    """Return the file or the module that defines a network; None for one of this package."""
    name = str(getattr(module, "__module__", "__main__"))
    if name.split(".")[0] == "pipeline":
        return None
    file = getattr(sys.modules.get(name), "__file__", None)
    return Path(file).name if file and (name.startswith(PLUGIN) or name == "__main__") else name


def known() -> tuple[str, ...]:
    """Return the names of all networks that can be made."""
    installed = (point.name for point in metadata.entry_points(group=GROUP))
    return tuple(dict.fromkeys([*ELSEWHERE, *NETWORKS, *installed]))


_name = checker(str)


def entry(name: str) -> Entry:
    """Return the entry of a network by name.

    Raises:
        ValueError: for an unknown name, or an entry point whose module does not register it.
    """
    name = _name("network", name)
    if name not in NETWORKS and name in ELSEWHERE:
        importlib.import_module(ELSEWHERE[name])
    if name not in NETWORKS:
        for point in metadata.entry_points(group=GROUP, name=name):
            point.load()
            if name not in NETWORKS:
                raise ValueError(f"entry point {name} = {point.value} of {GROUP} registers no network of that name")
    if name not in NETWORKS:
        raise ValueError(f"network is {name!r}; it must be one of {known()}, or of a plugin that is loaded (--plugin)")
    return NETWORKS[name]


def trained() -> tuple[str, ...]:
    """Return the names of the networks that are known to be trained on images."""
    return tuple(name for name in known() if name not in NETWORKS or NETWORKS[name].setup is not None)


def load_plugin(path: Path | str) -> Any:
    """Run a Python file that registers networks, starts or scenes, and return its module; a second time does nothing.

    Raises:
        ValueError: it is no Python file, registers what is there already, or raises anything else: naming its line.
        OSError: there is no such file.
    """
    file = Path(path)
    if not file.is_file():
        raise FileNotFoundError(f"plugin {file} is not there")
    name = f"{PLUGIN}{file.stem}"
    loaded = sys.modules.get(name)
    if loaded is not None and Path(str(loaded.__file__)).resolve() == file.resolve():
        return loaded
    if loaded is not None:
        raise ValueError(f"plugin {file} has the name of {loaded.__file__}, which is loaded; rename one of them")
    spec = util.spec_from_file_location(name, file) if file.suffix == ".py" else None
    if spec is None or spec.loader is None:
        raise ValueError(f"plugin {file} is no Python file; its name must end with .py")
    module = util.module_from_spec(spec)
    sys.modules[name] = module  # where dataclasses and pickle look for it
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[name]
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(file)]
        line = f", line {lines[-1]}" if lines else ""
        raise ValueError(f"plugin {file}{line} raises {type(error).__name__}: {error}") from error
    except BaseException:
        del sys.modules[name]
        raise
    return module
