"""Commands that every signal ends while they do something: prints the exit code of each.

A program of its own, because it forks a process for each command and signal, and those have no other threads.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import time
from collections.abc import Iterator
from typing import Any

import typer

import skyrange.cli
from skyrange.cli import app as commands

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def list_commands(command: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """All commands below one, with the words that name them."""
    if not hasattr(command, "commands"):
        yield path, command
        return
    for name, below in command.commands.items():
        yield from list_commands(below, (*path, name))


def run_interrupted(root: Any, path: tuple[str, ...], command: Any, number: signal.Signals) -> int:
    """The exit code of a command that a signal reaches while it waits; negative for that of a signal that ended it."""
    told, tell = os.pipe()
    child = os.fork()
    if child == 0:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        for each in SIGNALS:  # `nohup`, or a shell in the background, has them ignored, which children inherit
            signal.signal(each, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)

        def wait(**_: object) -> None:
            os.write(tell, b"!")
            time.sleep(20.0)

        command.params, command.callback = [], wait
        commands.app = root
        sys.argv = ["skyrange", *path]
        skyrange.cli.main()
    os.close(tell)
    os.read(told, 1)
    os.close(told)
    os.kill(child, number)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def main() -> None:
    """Print the exit codes by command and signal, as JSON; of all commands, or of those that the arguments name."""
    root = typer.main.get_command(commands.app)
    codes = {
        " ".join(path): {number.name: run_interrupted(root, path, command, number) for number in SIGNALS}
        for path, command in list_commands(root)
        if not sys.argv[1:] or " ".join(path) in sys.argv[1:]
    }
    print(json.dumps(codes))


if __name__ == "__main__":
    main()
