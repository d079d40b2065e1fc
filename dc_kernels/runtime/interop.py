"""Arrays of other libraries, checked and used in place: torch tensors, numpy arrays and ``wp.array``."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from dc_kernels.model.dtypes import FLOATS
from dc_kernels.model.settings import WrongType, counted


class NotCopied:
    """Base of objects that use given memory in place, and can be neither copied nor pickled."""

    def __reduce_ex__(self, protocol: Any) -> Any:
        """Raise an error: a copy would not use the given arrays.

        Raises:
            TypeError: always; the error names the alternative.
        """
        name = type(self).__name__
        raise TypeError(
            f"this {name} works on arrays where their owner has them, and is neither copied nor pickled; "
            f"make another {name} on copies of them"
        )


class InPlace(NotCopied):
    """Base of stages that work on given arrays."""

    dtype: np.dtype
    backend: str

    @property
    def lengths(self) -> Mapping[str, int]:
        """Return the numbers of its elements, by noun."""
        raise NotImplementedError

    def __repr__(self) -> str:
        """Return sizes, scalar type and backend."""
        counts = ", ".join(counted(number, name) for name, number in self.lengths.items())
        return f"<{type(self).__name__}: {counts}; {self.dtype}, {self.backend} on cpu>"


DLPACK_CPU = 1  # of its types of devices


def address(array: Any, name: str, dtype: np.dtype) -> tuple[int, tuple[int, ...]]:
    """Return address and shape of an array in the CPU's memory that kernels can read in place.

    Args:
        array: torch tensor, numpy array or ``wp.array``.
        name: name of the array in error messages.
        dtype: required dtype.

    Raises:
        ValueError: the array has another type, dtype or device, is not contiguous, or is a tensor that requires a
            gradient, which would be lost.
    """
    if isinstance(array, np.ndarray):
        kind, device, whole = array.dtype, "cpu", array.flags.c_contiguous
    elif hasattr(array, "data_ptr"):
        kind, device, whole = _numpy_type(array.dtype), array.device.type, array.is_contiguous()
    elif hasattr(array, "ptr") and hasattr(array, "is_contiguous"):
        kind, device, whole = _numpy_type(array.dtype), str(array.device), array.is_contiguous
    else:
        raise ValueError(f"{name} is a {type(array).__name__}; it must be a torch tensor, numpy array or wp.array")
    if kind != dtype:
        raise ValueError(f"{name} has dtype {kind}; it must be {dtype.name}")
    if device != "cpu":
        raise ValueError(f"{name} is on {device}; it must be on the cpu")
    if not whole:
        strides = array.stride() if hasattr(array, "data_ptr") else array.strides
        raise ValueError(f"{name} has strides {tuple(strides)}; it must be contiguous")
    if isinstance(array, np.ndarray):
        return array.__array_interface__["data"][0], array.shape  # array.ctypes.data takes ten times as long
    if hasattr(array, "data_ptr"):
        if array.requires_grad:
            raise ValueError(f"{name} requires a gradient, which would be lost; give {name}.detach()")
        return array.data_ptr(), tuple(array.shape)
    return array.ptr, tuple(array.shape)


@functools.lru_cache(64)
def _numpy_type(kind: Any) -> Any:
    """The dtype of torch or Warp as numpy's, found once; its name where numpy has none."""
    name = getattr(kind, "__name__", None) or str(kind).removeprefix("torch.")
    try:
        return np.dtype(name)
    except TypeError:
        return name


def host_view(name: str, array: Any) -> Any:
    """A torch tensor, ``wp.array`` or array with DLPack as numpy, the same memory; anything else as it is.

    Raises:
        TypeError: for a tensor that numpy cannot show.
        ValueError: for one on a GPU, or a tensor that requires a gradient, which would be lost.
    """
    if isinstance(array, np.ndarray):
        return array
    if hasattr(array, "data_ptr"):
        _check_device(name, array)
        if array.requires_grad:
            raise ValueError(f"{name} requires a gradient, which would be lost; the torch operators keep it")
        return _seen(name, array.numpy)
    if hasattr(array, "ptr") and hasattr(array, "is_contiguous"):
        if str(array.device) != "cpu":
            raise ValueError(f"{name} is on {array.device}; it must be on the CPU, where these kernels run")
        return array.numpy()
    if hasattr(array, "__dlpack__"):
        kind, _ = array.__dlpack_device__()
        if kind != DLPACK_CPU:
            raise ValueError(f"{name} is on a device of DLPack's type {int(kind)}; it must be on the CPU")
        return _seen(name, functools.partial(np.from_dlpack, array))
    return array


def _seen(name: str, view: Callable[[], np.ndarray]) -> np.ndarray:
    """The memory that a call shows.

    Raises:
        TypeError: with the name, where it is of a dtype that numpy has not, sparse, or negated when it is read.
    """
    try:
        return view()
    except (TypeError, RuntimeError, BufferError) as error:
        raise WrongType(f"{name} is not plain numbers in memory: {error}") from None


def tensor_array(name: str, tensor: Any) -> np.ndarray:
    """The memory of a tensor of float32 or float64 as a numpy array.

    Raises:
        ValueError: for one that would have to be copied.
    """
    _check_device(name, tensor)
    if str(tensor.dtype).removeprefix("torch.") not in FLOATS:
        raise ValueError(f"{name} has dtype {tensor.dtype}; it must be {' or '.join(FLOATS)}")
    if not tensor.is_contiguous():
        raise ValueError(f"{name} has strides {tensor.stride()} for shape {tuple(tensor.shape)}; it must be contiguous")
    return tensor.detach().numpy()


def tensor_integers(name: str, tensor: Any) -> np.ndarray | None:
    """The memory of a tensor of integers as a numpy array; None for None."""
    if tensor is None:
        return None
    _check_device(name, tensor)
    return tensor.detach().numpy()


def _check_device(name: str, tensor: Any) -> None:
    if tensor.device.type != "cpu":
        raise ValueError(f"{name} is on {tensor.device}; it must be on the CPU, where these kernels run")
