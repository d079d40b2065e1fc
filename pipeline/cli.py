"""The command line ``deep-contact``.

Its commands are the dataclasses of ``pipeline.commands``, whose fields tyro turns into flags.
"""

from __future__ import annotations

import contextlib
import functools
import io
import json
import operator
import re
import signal
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, cast, get_args

from dc_kernels.runtime.imports import require
from pipeline.commands.compare import Demo, Evaluate, Protocol
from pipeline.commands.fclib import Fclib
from pipeline.commands.figures import Figures
from pipeline.commands.generate import Generate
from pipeline.commands.scenes import Scenes
from pipeline.commands.simulate import Explain, Simulate
from pipeline.commands.train import Train, TrainContactnet, TrainStepper
from pipeline.commands.words import chosen_scene, misspelt, refuse_empty, values_of
from pipeline.data.recipe import load_recipe
from pipeline.networks.registry import load_plugin
from pipeline.process import terminable
from pipeline.stepper.choice import check_stepper

Command = (
    Simulate
    | Scenes
    | Demo
    | Protocol
    | Evaluate
    | Explain
    | Figures
    | Generate
    | Train
    | TrainContactnet
    | TrainStepper
    | Fclib
)
COMMANDS: dict[str, type] = {
    re.sub(r"(?<=[a-z])(?=[A-Z])", "-", command.__name__).lower(): command for command in get_args(Command)
}
"""The commands by the words that choose them."""
PYTHONS_WORDS = {"invalid literal for int() with base 10: ": "integer", "could not convert string to float: ": "number"}
"""What Python says of a text that is no number, and what was wanted."""


def parse(arguments: Sequence[str] | None = None) -> Any:
    """Load the plugins of a command line and return the command that it describes, which runs when called.

    Raises:
        ValueError: for a word, a value or a plugin that is wrong, naming it.
        SystemExit: 2 for what else is not understood, after tyro's lines on stderr; 0 after help.
    """
    tyro = require("tyro", "pipeline")
    conf = tyro.conf
    config = (
        conf.OmitArgPrefixes,
        conf.OmitSubcommandPrefixes,
        conf.CascadeSubcommandArgs,
        conf.FlagCreatePairsOff,
    )
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    refuse_empty(arguments)
    for stepper in values_of("--stepper", arguments):
        check_stepper("--stepper", stepper)  # tyro would not say where a file goes
    with contextlib.redirect_stdout(sys.stderr) if "--json" in arguments else contextlib.nullcontext():
        for path in values_of("--plugin", arguments):
            load_plugin(path)  # whose scenes are subcommands
    shown = io.StringIO()
    try:
        with contextlib.redirect_stderr(shown):
            return tyro.cli(_commands(conf, arguments), prog="deep-contact", args=arguments, config=config)
    except SystemExit as stop:
        if refused := _refused(stop) or (stop.code and misspelt(COMMANDS, arguments)):
            raise ValueError(refused) from None
        sys.stderr.write(shown.getvalue())
        raise


def _refused(stop: SystemExit) -> str:
    """Say what was wrong with a value, where tyro ended for one; empty where it ended for something else."""
    error = stop.__context__
    if type(error).__name__ != "InstantiationError":
        return ""
    message = str(getattr(error, "message", error))
    argument: Any = getattr(error, "arg", "")
    flag = getattr(getattr(argument, "lowered", None), "name_or_flags", ())
    if flag and message.startswith("Could not find valid parse"):
        given, wanted = message.partition("arguments: ")[2], " ".join(str(argument.lowered.metavar).split())
        help_text = argument.field.helptext
        meaning = (help_text() if callable(help_text) else help_text) or ""
        message = f"{given} is not of the form {wanted}. {meaning}"
    for words, kind in PYTHONS_WORDS.items():
        if message.startswith(words):
            message = f"{message.removeprefix(words)} is no {kind}"
    return f"{', '.join(flag)}: {message}" if flag else message


def _commands(conf: Any, arguments: Sequence[str]) -> Any:
    """Return the commands; the defaults of ``generate`` are the values of the TOML file that it is given."""
    files = values_of("--config", arguments)
    if arguments[:1] != ["generate"] or not files:
        return Command
    recipe = load_recipe(Path(files[-1]), chosen_scene(Generate, arguments[1:]))
    default = Generate(
        scene=cast(Any, recipe.scene), options=recipe.options, solver=recipe.solver, config=Path(files[-1])
    )
    own = Annotated[Generate, conf.subcommand(default=default)]
    return functools.reduce(operator.or_, [own if command is Generate else command for command in get_args(Command)])


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; return 0, or exit with another code after one line on stderr.

    With ``--json`` stdout is one line of JSON; whatever else is printed goes to stderr.

    Raises:
        SystemExit: 2 for what cannot be done; 130 after Ctrl-C, 143 after SIGTERM, with what is done so far kept.
    """
    with terminable() as ending:
        try:
            command = parse(arguments)
            with contextlib.redirect_stdout(sys.stderr) if command.json else contextlib.nullcontext():
                result = command()
            if command.json:
                print(json.dumps(result), flush=True)
            if not result.get("complete", True):
                raise KeyboardInterrupt
        except (ValueError, OverflowError, MemoryError, ImportError, OSError) as error:
            _say(" ".join(str(error).split()))
            raise SystemExit(2) from None
        except KeyboardInterrupt:
            _say("interrupted" if ending.number == signal.SIGINT else "terminated")
            raise SystemExit(ending.code) from None
    return 0


def _say(text: str) -> None:
    """Print a line on stderr."""
    print(f"deep-contact: {text}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
