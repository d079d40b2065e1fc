"""Structs of a first-order solve in Delassus form."""

from functools import cache
from types import SimpleNamespace

from dc_kernels._warp.common import scalar_types
from dc_kernels._warp.groups import element_type, struct_type
from dc_kernels.delassus.groups import MEMORY, PROBLEM, PROGRESS, SEARCH, SETTINGS


@cache
def search_types(dtype: str) -> SimpleNamespace:
    """``real``, ``vec2``, ``vec4``, and the structs ``Problem``, ``Search``, ``Memory``, ``Settings``, ``Progress``."""
    structs = {
        "Problem": struct_type("delassus_problem", dtype, PROBLEM),
        "Search": struct_type("delassus_search", dtype, SEARCH),
        "Memory": struct_type("delassus_memory", dtype, MEMORY),
        "Settings": struct_type("delassus_settings", dtype, SETTINGS),
        "Progress": element_type("delassus_progress", dtype, PROGRESS),
    }
    return SimpleNamespace(**vars(scalar_types(dtype)), **structs)
