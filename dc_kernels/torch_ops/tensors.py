"""Checks of tensors before an operator sees them, whose own errors name no argument."""

from __future__ import annotations

from typing import Any

from dc_kernels.model.settings import WrongType, numeric, shown
from dc_kernels.runtime.imports import require

torch = require("torch", "pipeline")


def check_tensors(**tensors: Any) -> None:
    """Raise an error for what is no tensor, or for tensors that are not all on one device.

    Raises:
        TypeError, ValueError: naming the argument.
    """
    for name, tensor in tensors.items():
        if not isinstance(tensor, torch.Tensor):
            raise WrongType(f"{name} is {shown(tensor)}; it must be a torch tensor")
    check_devices(**tensors)


def check_devices(**tensors: Any) -> None:
    """Raise a ValueError, naming the argument, for tensors that are not all on one device."""
    (first, one), *others = tensors.items()
    for name, tensor in others:
        if tensor.device != one.device:
            raise ValueError(f"{name} is on {tensor.device}; it must be on {one.device}, as {first} is")


def given_tensor(name: str, values: Any) -> Any:
    """Return integers of a user, or None, as a tensor; a tensor is returned as it is.

    Raises:
        TypeError: naming the argument.
    """
    if values is None or isinstance(values, torch.Tensor):
        return values
    return torch.from_numpy(numeric(name, values, "integers", "iu").copy())


def flat_batch(points: Any, start: Any, point_bin: Any) -> tuple[Any, Any, Any]:
    """Points (W, n, 2) or (W, n, 3) and their bins (W, n) one world after the other, and where each begins.

    Raises:
        ValueError: for offsets beside them, bins of another shape, or points that would have to be copied.
    """
    worlds, count = points.shape[:2]
    if start is not None:
        raise ValueError(f"start must be None where points has shape {tuple(points.shape)}, a world a row")
    if point_bin is not None:
        point_bin = given_tensor("point_bin", point_bin)
        if tuple(point_bin.shape) != (worlds, count):
            raise ValueError(f"point_bin has shape {tuple(point_bin.shape)}; it must be ({worlds}, {count})")
        point_bin = point_bin.reshape(-1)
    return flat("points", points), torch.arange(worlds + 1) * count, point_bin


def flat(name: str, tensor: Any) -> Any:
    """A tensor (W, n, k) as (W n, k), the same memory."""
    if not tensor.is_contiguous():
        raise ValueError(f"{name} has strides {tensor.stride()} for shape {tuple(tensor.shape)}; it must be contiguous")
    return tensor.reshape(-1, tensor.shape[2])
