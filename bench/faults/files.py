"""Hostile files: every kind that is read, changed in every way, loaded by a process of its own.

A file is refused by an error that names it, or accepted. An accepted one is wrong where it does not load as the
original does and holds a value that none may have, by rules of ``loaders`` of its own; and always where data from
outside of it would be read.
"""

from __future__ import annotations

import shutil
import tempfile
from pathlib import Path
from typing import Any

from bench.faults.changes import Hostile, hostile_files
from bench.faults.common import ask_all, thinned
from bench.faults.loaders import LOADERS
from bench.faults.originals import FOLDERS, NAMES, make_originals

SECONDS = 40.0  # for a file, after which it counts as hung
MOST, MOST_QUICK = 170, 14  # files of each kind


def measure(quick: bool) -> dict[str, Any]:
    """Count hostile files and how they fared; ``file_faults`` names those that went wrong."""
    from tqdm import tqdm

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        make_originals(folder / "originals")
        every = {kind: hostile_files(folder / "originals", kind) for kind in NAMES}
        chosen = [file for files in every.values() for file in thinned(files, MOST_QUICK if quick else MOST)]
        references = {kind: load_original(folder / "originals", kind) for kind in NAMES}
        bar = tqdm(total=len(chosen), unit="file", desc="files", dynamic_ncols=True)
        questions = (write(folder, i, file) for i, file in enumerate(chosen))
        answers = ask_all("bench.faults.loaders", questions, SECONDS, bar.update)
        bar.close()
    faults: dict[str, list[str]] = {"crashed": [], "hung": [], "accepted_wrong": [], "unclear": []}
    accepted = 0
    for question, found in answers:
        label, file = f"{question['kind']}: {question['name']}", chosen[question["number"]]
        if isinstance(found, str):
            faults[found].append(label)
        elif "digest" in found:
            accepted += 1
            if file.refused or (found["digest"] != references[file.kind] and found["wrong"]):
                faults["accepted_wrong"].append(f"{label} ({', '.join(found['wrong'][:3]) or 'from outside'})")
        elif "MemoryError" in found["refused"]:
            faults["crashed"].append(f"{label} ({found['refused']})")
        elif not found["clear"]:
            faults["unclear"].append(f"{label} ({found['refused']})")
    return {
        "hostile_files": len(answers),
        "files_accepted": accepted,
        "crashed": len(faults["crashed"]),
        "hung": len(faults["hung"]),
        "accepted_wrong": len(faults["accepted_wrong"]),
        "files_unclear": len(faults["unclear"]),
        "files_by_kind": {kind: sum(file.kind == kind for file in chosen) for kind in NAMES},
        "file_faults": {name: sorted(rows) for name, rows in faults.items()},
    }


def load_original(originals: Path, kind: str) -> str:
    """What the original of a kind loads as.

    Raises:
        RuntimeError: where it does not load, or holds what this module finds wrong.
    """
    found, wrong = LOADERS[kind](originals / FOLDERS.get(kind, kind) / NAMES[kind])
    if wrong:
        raise RuntimeError(f"the original {kind} is wrong: {wrong}")
    return found


def write(folder: Path, number: int, file: Hostile) -> dict[str, Any]:
    """Write a hostile file, beside what belongs to it, and make the question for its loader."""
    source, target = folder / "originals" / FOLDERS.get(file.kind, file.kind), folder / f"{number}"
    target.mkdir()
    for path in source.iterdir():
        if path.name != NAMES[file.kind]:
            shutil.copyfile(path, target / path.name)
    file.write(source / NAMES[file.kind], target / NAMES[file.kind])
    return {"kind": file.kind, "name": file.name, "number": number, "path": str(target / NAMES[file.kind])}
