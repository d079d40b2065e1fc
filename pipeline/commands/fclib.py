"""The command ``fclib``, which exports and solves contact problems."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pipeline.commands.common import Common, Positional, SceneOption
from pipeline.fclib.runs import ExportOptions, SolveOptions, describe_export, describe_solve, export, solve_files
from pipeline.options import RunOptions, SolverOptions


@dataclass(frozen=True, kw_only=True)
class Export:
    """Simulate a scene and write contact problems of some steps as FCLIB files."""

    scene: SceneOption
    """What to run; each scene has options of its own."""
    run: RunOptions = field(default_factory=RunOptions)
    solver: SolverOptions = field(default_factory=SolverOptions)
    export: ExportOptions = field(default_factory=ExportOptions)

    def __call__(self, progress: bool) -> tuple[dict[str, Any], str]:
        result = export(self.scene, self.run, self.solver, self.export, progress)
        return result, describe_export(result)


@dataclass(frozen=True, kw_only=True)
class Solve:
    """Solve the contact problem of an FCLIB file, or those of all files of a folder."""

    path: Positional[Path]
    """File or folder."""
    options: SolveOptions = field(default_factory=SolveOptions)

    def __call__(self, progress: bool) -> tuple[dict[str, Any], str]:
        result = solve_files(self.path, self.options, progress)
        return result, describe_solve(result)


@dataclass(frozen=True, kw_only=True)
class Fclib(Common):
    """Export contact problems of a scene in FCLIB's HDF5 layout, or solve those of given files."""

    action: Export | Solve
    """What to do."""

    def __call__(self) -> dict[str, Any]:
        result, text = self.action(not self.json)
        if not self.json:
            print(text)
        return result
