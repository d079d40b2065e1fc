"""The process of ``deep-contact``: what interrupts it while the libraries are loaded ends it as a command would."""

from __future__ import annotations

import os
import signal
import sys
from types import FrameType


def main() -> int:
    """Run the command line (``pipeline.cli.main``); Ctrl-C and SIGTERM are heeded from here on."""

    def end(number: int, frame: FrameType | None) -> None:
        text = "interrupted" if number == signal.SIGINT else "terminated"
        os.write(2, f"deep-contact: {text}\n".encode())
        os._exit(128 + number)  # what is half loaded runs no more

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        from pipeline import cli
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    return cli.main()


if __name__ == "__main__":
    sys.exit(main())
