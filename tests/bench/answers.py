"""A child of the bench ``faults`` for its tests: it answers, crashes, hangs, or talks."""

import os
import signal
import time

from bench.faults.common import answer


def reply(question):
    if question == "crash":
        os.kill(os.getpid(), signal.SIGSEGV)
    if question == "hang":
        time.sleep(60.0)
    print("what a library says")
    return [question, os.getpid()]


if __name__ == "__main__":
    answer(reply)
