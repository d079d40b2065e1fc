"""The words of a command line: which option or subcommand is meant, and what is wrong with one that there is not."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from typing import get_args

from dc_kernels.model.settings import field_types, plain_type
from pipeline.commands.common import SceneOption
from pipeline.scenes import SCENES

Commands = Mapping[str, type]
"""Dataclasses by the words that choose them."""


def subcommands(command: type) -> tuple[Commands, bool]:
    """Return what may be chosen after a command, by word, and whether these are scenes; nothing for most commands."""
    for hint in field_types(command).values():
        if hint == SceneOption:
            return SCENES, True
        if hint is not None and get_args(hint) and all(map(is_dataclass, get_args(hint))):
            return {one.__name__.lower(): one for one in get_args(hint)}, False
    return {}, False


def flags(command: type) -> Iterator[tuple[str, bool]]:
    """Give the flags of a command, or of an option that is a dataclass, and whether each is one without a value."""
    for name, hint in field_types(command).items():
        plain = plain_type(hint)
        if hint == SceneOption:
            continue
        if is_dataclass(plain):
            yield from flags(plain)  # type: ignore[arg-type]
        else:
            flag = f"--{name.replace('_', '-')}"
            yield flag, plain is bool
            if plain is bool:
                yield f"--no-{flag[2:]}", True


def values_of(flag: str, arguments: Sequence[str]) -> list[str]:
    """Return the first value of a flag each time that it is given, as ``--flag VALUE`` or ``--flag=VALUE``."""
    found = []
    for i, word in enumerate(arguments):
        name, equals, value = word.partition("=")
        if name == flag and (equals or i + 1 < len(arguments)):
            found.append(value if equals else arguments[i + 1])
    return found


def chosen_scene(command: type, arguments: Sequence[str]) -> str | None:
    """Return the scene that the arguments of a command choose; None where they choose none."""
    silent = {flag for flag, alone in flags(command) if alone}
    for before, word in zip(["", *arguments], arguments):
        is_value = before.startswith("--") and "=" not in before and before.replace("_", "-") not in silent
        if word in SCENES and not is_value:
            return word
    return None


def refuse_empty(arguments: Sequence[str]) -> None:
    """Raise ``ValueError`` for a flag with an empty value, which would stand for the working directory or nothing."""
    for word, following in zip(arguments, [*arguments[1:], "-"]):
        flag, equals, value = word.partition("=")
        if flag.startswith("--") and not (value if equals else following):
            raise ValueError(f"{flag} is empty; it must have a value")


def misspelt(commands: Commands, arguments: Sequence[str]) -> str:
    """Say which word of a command line there is not, and the nearest that there is; empty where all are known."""
    said, choices, kind, known = "deep-contact", commands, "command", {"--help"}
    left = list(arguments)
    while choices:
        word = left[0] if left else ""
        if not word or word.startswith("-"):
            break
        if word not in choices:
            return f"{word!r} is no {kind}{_nearest(word, choices)}; there are {', '.join(choices)}"
        command = choices[word]
        said, left = f"{said} {word}", left[1:]
        known |= {flag for flag, _ in flags(command)}
        choices, scenes = subcommands(command)
        kind = "scene" if scenes else f"action of {word}"
    else:
        return _unknown_flag(said, known, left)
    for word in left:  # a scene may stand behind flags
        if word in choices:
            said, known = f"{said} {word}", known | {flag for flag, _ in flags(choices[word])}
            return _unknown_flag(said, known, left)
    return ""


def _unknown_flag(said: str, known: Collection[str], words: Sequence[str]) -> str:
    """Say which flag among words a command has not, and the nearest that it has."""
    for word in words:
        flag = word.partition("=")[0].replace("_", "-")
        if flag.startswith("--") and flag not in known:
            return f"{flag} is no option of {said}{_nearest(flag, known)}; {said} --help shows all"
    return ""


def _nearest(word: str, known: Collection[str]) -> str:
    """Ask for the nearest of the known words; empty where none is near."""
    near = difflib.get_close_matches(word.lstrip("-"), [one.lstrip("-") for one in known], 1, 0.6)
    return f" (did you mean {'--' * word.startswith('--')}{near[0]}?)" if near else ""
