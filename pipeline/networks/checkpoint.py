"""Files of networks: what a network is and knows, and the state that training continues from, bit for bit.

Both are safetensors files, written under a temporary name and renamed when whole. The strings in their metadata:

- ``schema`` and ``version``: ``deep-contact.network`` or ``deep-contact.training``, and its version;
- ``network``, ``config``: name and configuration (JSON) from which ``models.build`` makes the network again;
- ``plugin``, of a network from outside this package: the file or module that registers it, which is never loaded by
  itself, since a file of weights is not to choose what code runs;
- ``manifest`` (of a network; JSON): what its maker says of it: images, seeds, data set, versions, metrics;
- ``state`` (of training; JSON): groups of the optimiser, schedule, progress, identity.

A network's file holds its weights under their names. That of a training holds weights under ``model/NAME``, the
optimiser's tensors under ``optimizer/PARAMETER/NAME``, torch's generator as ``rng``, and what a caller adds under
``extra/NAME``: it needs no other file, so that nothing can be mixed up when a run is killed between two of them.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

from dc_kernels.grid.grid import Grid
from dc_kernels.grid.image_spec import ImageSpec
from dc_kernels.model.settings import with_article
from dc_kernels.runtime.files import check_regular
from dc_kernels.runtime.imports import require
from pipeline.files import plain, versions, write_bytes
from pipeline.networks import models
from pipeline.networks.registry import entry

torch = require("torch", "pipeline")
safetensors = require("safetensors", "pipeline")

NETWORK_SCHEMA, NETWORK_VERSION = "deep-contact.network", 1
TRAINING_SCHEMA, TRAINING_VERSION = "deep-contact.training", 2
MOST_LAYERS = 64
"""Entries of a list in a configuration, beside one for each tensor in its file [1]."""


def all_versions() -> dict[str, str]:
    """Return ``files.versions`` and those of the libraries that train."""
    return {**versions(), **{name: metadata.version(name) for name in ("torch", "safetensors")}}


def commit() -> str | None:
    """Return the commit of the checkout that this package runs from, with a + where it was changed; None elsewhere."""
    git = ["git", "-C", str(Path(__file__).resolve().parent)]
    try:
        found = [
            subprocess.run([*git, *command], capture_output=True, text=True, check=True, timeout=10).stdout.strip()
            for command in (["rev-parse", "--short", "HEAD"], ["status", "--porcelain", "--untracked-files=no"])
        ]
    except (OSError, subprocess.SubprocessError):
        return None
    return found[0] + ("+" if found[1] else "")


def save_checkpoint(path: Path | str, model: Any, manifest: Mapping[str, Any]) -> None:
    """Write a network.

    Args:
        path: of the file, .safetensors.
        model: a network that ``models.build`` made.
        manifest: plain values: what the network was trained on and for.

    Raises:
        ValueError: for a module that ``build`` did not make, or a manifest that JSON cannot hold.
    """
    described = {**_described(model, NETWORK_SCHEMA, NETWORK_VERSION), "manifest": _json("manifest", manifest)}
    _write(Path(path), model.state_dict(), described)


def load_checkpoint(
    path: Path | str, *, network: str | None = None, grid: Grid | None = None
) -> tuple[Any, dict[str, Any]]:
    """Load a network and its manifest.

    Args:
        path: of the file.
        network: the name that it must have; None: any.
        grid: that of the images in its manifest, as it must be; None: any.

    Returns:
        The network, in evaluation mode, and its manifest.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is damaged, of another kind or version, of another network or grid than asked for, or of a plugin
            that is not loaded; the tensors must be those of the network described, which is not built before.
    """
    described, tensors = _read(Path(path), NETWORK_SCHEMA, NETWORK_VERSION)
    if network is not None and described["network"] != network:
        raise ValueError(f"{path} holds the network {described['network']!r}, not {network!r}")
    manifest, config = (_parsed(path, described, name) for name in ("manifest", "config"))
    found = _images(path, manifest)
    if grid is not None and found != grid:
        raise ValueError(f"{path} was trained on the grid {found}, not on {grid}")
    _check_plugin(path, described)
    _check_config(path, described["network"], config, tensors)
    model = models.build(described["network"], config)
    model.load_state_dict(tensors)
    return model.eval(), manifest


def save_training(
    path: Path | str,
    model: Any,
    optimizer: Any,
    schedule: Any,
    progress: Mapping[str, Any],
    identity: Mapping[str, Any],
    extra: Mapping[str, Any] | None = None,
) -> None:
    """Write all that a training continues from.

    Args:
        path: of the file, .safetensors.
        model: a network that ``models.build`` made.
        optimizer: of torch, over ``model.parameters()`` in one group or more.
        schedule: of torch, or None.
        progress: plain values: epoch, batches done in it, steps done, best metric, ...
        identity: plain values that decide the bits of the training: a run with others cannot continue from here.
        extra: tensors by name, of the caller's own.
    """
    tensors = {f"model/{name}": tensor for name, tensor in model.state_dict().items()}
    groups, scalars = optimizer.state_dict(), {}
    for index, values in groups["state"].items():
        for name, value in values.items():
            if isinstance(value, torch.Tensor):
                tensors[f"optimizer/{index}/{name}"] = value
            elif value is not None:
                scalars[f"{index}/{name}"] = value
    tensors.update({f"extra/{name}": tensor for name, tensor in (extra or {}).items()})
    tensors["rng"] = torch.get_rng_state()
    state = {
        "groups": groups["param_groups"],
        "scalars": scalars,
        "schedule": None if schedule is None else schedule.state_dict(),
        "progress": progress,
        "identity": identity,
    }
    described = {**_described(model, TRAINING_SCHEMA, TRAINING_VERSION), "state": _json("state", state)}
    _write(Path(path), tensors, described)


def load_training(
    path: Path | str, model: Any, optimizer: Any, schedule: Any, identity: Mapping[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Put a training back to where ``save_training`` left it, torch's global generator too.

    Returns:
        Progress, and the extra tensors.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is damaged, of another kind or version, or another training: the first difference is named.
    """
    described, tensors = _read(Path(path), TRAINING_SCHEMA, TRAINING_VERSION)
    state = _parsed(path, described, "state")
    mine = {"network": model.network_name, **models.config_dict(model), **identity}
    theirs = {"network": described["network"], **_parsed(path, described, "config"), **_identity(path, state)}
    for name, value in json.loads(_json("identity", mine)).items():
        if theirs.get(name) != value:
            raise ValueError(f"{path} was trained with {name} = {theirs.get(name)!r}; this run has {value!r}")
    try:
        return _restore(path, state, tensors, model, optimizer, schedule)
    except (AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
        if str(path) in str(error):
            raise
        raise ValueError(f"{path} is damaged: {type(error).__name__}: {error}") from error


def _identity(path: Path | str, state: Mapping[str, Any]) -> dict[str, Any]:
    """Return what decided the bits of a training that was saved."""
    found = state.get("identity")
    if not isinstance(found, dict):
        raise ValueError(f"{path} is damaged: its state has no identity")
    return found


def _restore(
    path: Path | str, state: Mapping[str, Any], tensors: Mapping[str, Any], model: Any, optimizer: Any, schedule: Any
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Put a training back to a state and tensors; see ``load_training``."""
    parts: dict[str, dict[str, Any]] = {"model": {}, "optimizer": {}, "extra": {}}
    for name, tensor in tensors.items():
        kind, _, rest = name.partition("/")
        if kind in parts:
            parts[kind][rest] = tensor
    own = optimizer.state_dict()["param_groups"]
    if [group["params"] for group in state["groups"]] != [group["params"] for group in own]:
        raise ValueError(f"{path} is damaged: its groups of parameters are not those of the optimiser")
    weights = [weight for group in optimizer.param_groups for weight in group["params"]]
    values: dict[int, dict[str, Any]] = {}
    for name, value in {**state["scalars"], **parts["optimizer"]}.items():
        index, _, field = name.partition("/")
        if isinstance(value, torch.Tensor) and value.ndim and value.shape != weights[int(index)].shape:
            wanted = tuple(weights[int(index)].shape)
            raise ValueError(f"{path}: optimizer/{name} has shape {tuple(value.shape)}; its weight has {wanted}")
        values.setdefault(int(index), {})[field] = value
    if not isinstance(state["progress"], dict):
        raise ValueError(f"{path} is damaged: its progress is {with_article(type(state['progress']).__name__)}")
    _check_tensors(path, model, parts["model"])
    for name, tensor in parts["optimizer"].items():
        _check_finite(path, f"optimizer/{name}", tensor)
    model.load_state_dict(parts["model"])
    groups = [_as_given(saved, mine) for saved, mine in zip(state["groups"], own)]
    optimizer.load_state_dict({"state": dict(sorted(values.items())), "param_groups": groups})
    if schedule is not None:
        schedule.load_state_dict(state["schedule"])
    torch.set_rng_state(tensors["rng"])
    return state["progress"], parts["extra"]


# ------------------------------------------------------------------ files


def _described(model: Any, schema: str, version: int) -> dict[str, str]:
    """Return the metadata that both kinds of file have."""
    config = _json("config", models.config_dict(model))
    plugin = entry(model.network_name).plugin
    more = {} if plugin is None else {"plugin": plugin}
    return {"schema": schema, "version": str(version), "network": model.network_name, "config": config, **more}


def _check_plugin(path: Path | str, described: Mapping[str, str]) -> None:
    """Raise ``ValueError`` where a network's plugin is not loaded, naming it."""
    try:
        entry(described["network"])
    except ValueError as error:
        if "plugin" not in described:
            raise ValueError(f"{path}: {error}") from None
        plugin = described["plugin"]
        how = f"give --plugin {plugin}, or call load_plugin" if plugin.endswith(".py") else f"import {plugin} first"
        raise ValueError(
            f"{path} holds the network {described['network']!r} of the plugin {plugin}, which is not loaded: {how}"
        ) from None


def _json(name: str, value: Any) -> str:
    """Write a value as JSON; an error calls it ``name``."""
    try:
        return json.dumps(plain(value), allow_nan=True)
    except TypeError as error:
        raise ValueError(f"{name} holds what JSON cannot: {error}") from None


def _parsed(path: Path | str, described: Mapping[str, str], name: str) -> dict[str, Any]:
    """Parse a JSON object of the metadata."""
    try:
        value = json.loads(described[name])
    except (KeyError, ValueError, RecursionError) as error:
        raise ValueError(f"{path} is damaged: its metadata have no readable {name!r} ({error})") from None
    if not isinstance(value, dict):
        raise ValueError(f"{path} is damaged: its {name!r} is a {type(value).__name__}; it must be an object of JSON")
    return value


def _images(path: Path | str, manifest: Mapping[str, Any]) -> Grid | None:
    """Return the grid of the images in a manifest; None where there are none."""
    if "images" not in manifest:
        return None
    try:
        return ImageSpec.from_dict(manifest["images"]).grid
    except (ArithmeticError, AttributeError, TypeError, ValueError) as error:
        raise ValueError(f"{path} is damaged: its manifest's images are no description of images: {error}") from None


def _check_config(path: Path | str, network: str, config: Mapping[str, Any], tensors: Mapping[str, Any]) -> None:
    """Raise ``ValueError`` unless a file's tensors are those of its network, which takes no memory for that.

    So no layer is larger than the file, and no list of layers longer than ``MOST_LAYERS``.
    """
    for name, value in config.items():
        if isinstance(value, list) and len(value) > max(MOST_LAYERS, len(tensors)):
            raise ValueError(f"{path}: {name} of {network} has {len(value)} entries, for {len(tensors)} tensors")
    try:
        with torch.device("meta"):
            _check_tensors(path, models.build(network, config), tensors)
    except (ArithmeticError, RuntimeError, TypeError, ValueError) as error:
        if str(path) in str(error):
            raise
        raise ValueError(f"{path}: its configuration makes no network: {error}") from None


def _as_given(saved: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """Return a group of an optimiser with its tuples, such as Adam's betas, which JSON does not know."""
    return {name: tuple(value) if isinstance(own.get(name), tuple) else value for name, value in saved.items()}


def _write(path: Path, tensors: Mapping[str, Any], described: dict[str, str]) -> None:
    """Write tensors and metadata in one go."""
    save = require("safetensors.torch", "pipeline").save  # as bytes: a file of its own making nobody else may read
    write_bytes(path, save({name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}, described))


def _read(path: Path, schema: str, version: int) -> tuple[dict[str, str], dict[str, Any]]:
    """Read metadata and tensors of a file.

    Raises:
        OSError: it cannot be read.
        ValueError: it is damaged or foreign.
    """
    if not path.exists():
        raise FileNotFoundError(f"{path} is not there")
    check_regular(path)
    with open(path, "rb"):
        pass  # says what is wrong with the path itself
    try:
        with safetensors.safe_open(path, framework="pt") as file:
            described = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118, it is no dict
    except safetensors.SafetensorError as error:
        raise ValueError(f"{path} is damaged or no safetensors file: {error}") from None
    if described.get("schema") != schema:
        raise ValueError(f"{path} has the schema {described.get('schema')!r}; it must be {schema!r}")
    if described.get("version") != str(version):
        raise ValueError(f"{path} has version {described.get('version')} of {schema}; this code reads {version}")
    if "network" not in described:
        raise ValueError(f"{path} is damaged: its metadata do not name the network")
    return described, tensors


def _check_tensors(path: Path | str, model: Any, tensors: Mapping[str, Any]) -> None:
    """Check tensors of a file against those of a model.

    Raises:
        ValueError: naming the first that is missing, too many, of another shape or dtype, or not finite.
    """
    own, weights = model.state_dict(), dict(model.named_parameters())
    for name in sorted(own.keys() | tensors.keys()):
        if name not in tensors or name not in own:
            raise ValueError(f"{path} {'lacks' if name in own else 'has'} {name!r}, unlike {model.network_name}")
        found, wanted = tensors[name], own[name]
        if found.shape != wanted.shape or found.dtype != wanted.dtype:
            raise ValueError(
                f"{path}: {name} is {found.dtype} {tuple(found.shape)}; "
                f"{model.network_name} has {wanted.dtype} {tuple(wanted.shape)}"
            )
        # only a bound kept beside the weights, one number, may be infinite
        _check_finite(path, name, found, infinite=name not in weights and not found.ndim)


def _check_finite(path: Path | str, name: str, tensor: Any, infinite: bool = False) -> None:
    """Raise ``ValueError`` naming the first number of a tensor that is NaN, or infinite if that is not allowed."""
    if not tensor.is_floating_point():
        return
    bad = torch.nonzero(torch.isnan(tensor) if infinite else ~torch.isfinite(tensor))
    if len(bad):
        index = tuple(bad[0].tolist())
        place = f"{name}[{', '.join(map(str, index))}]" if index else name
        raise ValueError(f"{path}: {place} is {float(tensor[index])}; it must be finite")
