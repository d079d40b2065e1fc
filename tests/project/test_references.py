"""Whoever a docstring names with a year stands in docs/references.md, and what stands there is used where it says."""

from __future__ import annotations

import re
import unicodedata
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def plain(text: str) -> str:
    """Letters without their accents: docstrings write More for Moré."""
    return "".join(letter for letter in unicodedata.normalize("NFKD", text) if not unicodedata.combining(letter))


TEXT = plain((ROOT / "docs" / "references.md").read_text(encoding="utf-8"))
SOURCES = [path for folder in ("dc_kernels", "pipeline", "bench") for path in sorted((ROOT / folder).rglob("*.py"))]
# a name, perhaps a second one or "et al.", and a year: Moreau 1988, Stewart and Trinkle (1996), Couplet 1730
CITATION = re.compile(r"\b([A-Z][\w'-]+)(?:,? et al\.)?,? \(?(1[5-9]\d\d|20[01]\d)\b")
ENTRIES = [" ".join(e.split("\n\n")[0].split()) for e in re.split(r"^- ", TEXT, flags=re.MULTILINE)[1:]]


def citations() -> dict[tuple[str, str], str]:
    """(name, year): a file that cites it."""
    found = {}
    for path in SOURCES:
        for name, year in CITATION.findall(" ".join(plain(path.read_text(encoding="utf-8")).split())):
            found.setdefault((name, year), path.relative_to(ROOT).as_posix())
    return found


def test_whoever_is_cited_is_listed():
    cited = citations()
    assert ("Moreau", "1988") in cited and ("Engedal", "2018") in cited and len(cited) > 20
    missing = [
        f"{name} {year} in {path}"
        for (name, year), path in cited.items()
        if not any(re.search(rf"\b{name}\b", entry) and year in entry for entry in ENTRIES)
    ]
    assert not missing


def test_each_source_is_listed_once():
    headings = re.findall(r"\*\*([^*]+\d{4})\*\*", " ".join(TEXT.split()))
    assert len(headings) > 30
    assert sorted(headings) == sorted(set(headings))


@pytest.mark.parametrize("entry", [entry for entry in ENTRIES if "/`" in entry], ids=lambda entry: entry[:30])
def test_a_source_is_used_where_it_says(entry):
    """A name or year in bold, an acronym of the title, or what docstrings call the source stands in each folder."""
    bold = " ".join(re.findall(r"\*\*([^*]+)\*\*", entry))
    names = [*re.findall(r"[A-Z]\w+", bold), *re.findall(r"\b[A-Z]{4,}\b", entry), *re.findall(r'"(\w+)"', entry)]
    for folder in re.findall(r"`((?:dc_kernels|pipeline|bench)/[\w/]*)`", entry):
        files = [path for path in (ROOT / folder).rglob("*") if path.suffix in (".py", ".h")]
        text = plain("\n".join(path.read_text(encoding="utf-8") for path in files)).lower()
        assert files and any(re.search(rf"\b{name.lower()}", text) for name in names or ["2026"]), folder
