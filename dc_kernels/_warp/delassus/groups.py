"""Structs of a first-order solve in Delassus form."""

from functools import cache
from types import SimpleNamespace

from dc_kernels._warp.common import scalar_types
from dc_kernels._warp.groups import array_struct, scalar_struct
from dc_kernels.delassus.groups import MEMORY, PROBLEM, PROGRESS, SEARCH, SETTINGS


@cache
def search_types(dtype: str) -> SimpleNamespace:
    """``real``, ``vec2``, ``vec4``, and the structs ``Problem``, ``Search``, ``Memory``, ``Settings``, ``Progress``."""
    structs = {
        "Problem": array_struct("DelassusProblem", dtype, PROBLEM),
        "Search": array_struct("DelassusSearch", dtype, SEARCH),
        "Memory": array_struct("DelassusMemory", dtype, MEMORY),
        "Settings": scalar_struct("DelassusSettings", dtype, SETTINGS),
        "Progress": scalar_struct("DelassusProgress", dtype, PROGRESS),
    }
    return SimpleNamespace(**vars(scalar_types(dtype)), **structs)
