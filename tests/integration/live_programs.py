"""A live range as a program, and real programs beside it: what they say, and what the range recorded of them."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from threading import Event, Thread
from typing import Any

import pytest

from skyrange.record import RunRecord, load

MAIN = "import sys; from skyrange.cli import main; sys.exit(main())"
MAVPROXY = shutil.which("mavproxy.py")
TSHARK = shutil.which("tshark")
NODE_MODULE = "skyrange.runtime.live.node.process"
"""What a node's process runs."""
LAT, LON = -35.363328, 149.1652241
CLIENTS = Path(__file__).parent / "clients"
ONE_AIRCRAFT = f"""
name = "clients"
seed = 4
duration_s = {{seconds}}
origin = {{{{ lat = {LAT}, lon = {LON} }}}}

[[operators]]
id = "blue"
vehicles = [{{{{ id = "b1", depart_s = 1, plan = {{{{ path = {{{{ points = [[0.0, 200.0]], alt_m = 5.0 }}}} }}}} }}}}]
"""
"""It flies north, farther than it comes in the time of a test."""


@cache
def mavsdk_python() -> str:
    """A Python that has MAVSDK 4 or later: `SKYRANGE_MAVSDK_PYTHON`, this one, or MAVProxy's; skips where none has."""
    found = [os.environ.get("SKYRANGE_MAVSDK_PYTHON", ""), sys.executable]
    if MAVPROXY is not None:
        found.append(str(Path(MAVPROXY).resolve().parent / "python"))
    for python in found:
        if python and Path(python).exists():
            tried = subprocess.run(
                [python, "-c", "from mavsdk.asyncio import Mavsdk"], capture_output=True, env=clean(), check=False
            )
            if tried.returncode == 0:
                return python
    pytest.skip("MAVSDK for Python 4 or later is not installed (SKYRANGE_MAVSDK_PYTHON may name a Python that has it)")


def clean() -> dict[str, str]:
    """The environment of a program that has a Python of its own."""
    environment = {**os.environ, "PYTHONUNBUFFERED": "1"}
    environment.pop("PYTHONPATH", None)
    return environment


def until(holds: Callable[[], Any], seconds: float, what: str, *while_running: subprocess.Popen[Any]) -> Any:
    """What `holds` gives once it gives anything; fails at once where one of `while_running` has ended before."""
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        ended = [program for program in while_running if program.poll() is not None]
        found = holds()
        if found:
            return found
        if ended:
            raise AssertionError(f"{what}: {_command(ended[0])} ended with {ended[0].returncode}{_words(ended[0])}")
        time.sleep(0.05)
    raise AssertionError(f"not within {seconds:g} s: {what}")


def _command(program: subprocess.Popen[Any]) -> str:
    return " ".join(map(str, program.args[-4:])) if isinstance(program.args, list) else str(program.args)


def _words(program: subprocess.Popen[Any]) -> str:
    """What a program that has ended said, as far as that is ours to read."""
    said = program.stderr.read() if program.stderr is not None and not program.stderr.closed else ""
    return f": {said}" if said else ""


class Flight:
    """`skyrange live` of a scenario, with a folder of its own."""

    def __init__(self, folder: Path, scenario: str, offset: int, *options: str) -> None:
        (folder / "live.toml").write_text(scenario)
        self.folder, self.offset = folder, offset
        where = ("--out", folder / "run", "--port-offset", offset)
        self.program = subprocess.Popen(
            skyrange("live", folder / "live.toml", *where, "--json", *options),
            stdout=subprocess.PIPE, stderr=(folder / "said.txt").open("w"), text=True,
        )  # fmt: skip

    @property
    def said(self) -> str:
        """Its standard error so far."""
        return (self.folder / "said.txt").read_text()

    def flying(self, node: str = "world") -> Path:
        """The folder of a node's part, once time has begun there."""
        part = self.folder / "run" / ".parts" / node

        def rows() -> bool:
            return (part / "manifest.json").exists() and load(part).rows("frames") > 0

        until(rows, 150.0, f"{node} to fly", self.program)
        return part

    def kill(self, node: str) -> None:
        """Kill one of its processes."""
        os.kill(self._process(node), signal.SIGKILL)

    def udp_port(self, node: str) -> int:
        """The UDP port of a process that has one, as an attacker finds it who sees its datagrams (proc_pid_net(5))."""
        process = Path(f"/proc/{self._process(node)}")
        own = {os.readlink(link) for link in (process / "fd").iterdir() if link.is_symlink()}
        rows = [row.split() for row in (process / "net" / "udp").read_text().splitlines()[1:]]
        (port,) = [int(row[1].rpartition(":")[2], 16) for row in rows if f"socket:[{row[9]}]" in own]
        return port

    def _process(self, node: str) -> int:
        orders = str(self.folder / "run" / ".parts" / f"{node}.program" / "node.json").encode()
        (found,) = [entry for entry in Path("/proc").iterdir() if entry.name.isdigit() and orders in _command_of(entry)]
        return int(found.name)

    def landed(self) -> tuple[dict[str, Any], RunRecord]:
        """Its summary and its record, at its end."""
        out, _ = self.program.communicate(timeout=150.0)
        assert self.program.returncode == 0, self.said
        return json.loads(out), load(self.folder / "run")


def nodes(folder: Path) -> dict[str, int]:
    """The process ids of the nodes of the range in a folder, by the names of their parts."""
    found = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            command = [word.decode() for word in _command_of(entry)]
            if NODE_MODULE in command and str(folder) in command[-2]:
                found[Path(command[-2]).parent.stem] = int(entry.name)
    return found


def _command_of(process: Path) -> list[bytes]:
    try:
        return (process / "cmdline").read_bytes().split(b"\0")
    except OSError:  # it has ended
        return []


@contextmanager
def live(folder: Path, scenario: str, offset: int, *options: str) -> Iterator[Flight]:
    """A flight that does not outlive its test."""
    flight = Flight(folder, scenario, offset, *options)
    try:
        yield flight
    finally:
        if flight.program.poll() is None:
            flight.program.terminate()
            try:
                flight.program.communicate(timeout=30.0)
            except subprocess.TimeoutExpired:
                flight.program.kill()


def skyrange(*arguments: object) -> list[str]:
    """The command line's program."""
    return [sys.executable, "-c", MAIN, *map(str, arguments)]


@contextmanager
def killed_after(program: subprocess.Popen[Any], seconds: float, *others: subprocess.Popen[Any]) -> Iterator[None]:
    """Kill a program at the end, after so many seconds, or when one of `others` has ended: it waits for nothing more.

    So reading what it prints ends with what it depends on, but for two seconds of last words.
    """
    over = Event()

    def watch() -> None:
        deadline = time.monotonic() + seconds
        while not over.wait(0.1) and time.monotonic() < deadline:
            if any(other.poll() is not None for other in others):
                over.wait(2.0)
                break
        program.kill()

    watcher = Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        over.set()
        watcher.join()
        program.kill()
        program.communicate()


def exit_code(program: subprocess.Popen[Any], seconds: float, *others: subprocess.Popen[Any]) -> int:
    """How a program ends within so many seconds; fails at once where one of `others` fails before it."""
    until(lambda: program.poll() is not None or any(other.poll() for other in others), seconds, "its end")
    failed = [other for other in others if program.poll() is None]
    assert not failed, [(_command(other), other.poll()) for other in failed]
    assert program.returncode is not None
    return int(program.returncode)


def client(
    python: str, script: str, *arguments: object, of: subprocess.Popen[Any], within_s: float = 150.0
) -> subprocess.CompletedProcess[str]:
    """Run a program of `clients` to its end, or to that of the range `of`."""
    command = [python, str(CLIENTS / script), *map(str, arguments)]
    program = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=clean())
    with killed_after(program, within_s, of):
        out, err = program.communicate()
    return subprocess.CompletedProcess(command, program.returncode, out, err)


@contextmanager
def beside(
    command: Sequence[str], folder: Path, within_s: float = 150.0, of: subprocess.Popen[Any] | None = None
) -> Iterator[subprocess.Popen[str]]:
    """A program that runs beside a range, at most as long as `of`, with its console in our hands."""
    program = subprocess.Popen(
        list(command), stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=folder,
        env={**(os.environ if MAIN in command else clean()), "HOME": str(folder), "PYTHONUNBUFFERED": "1"},
    )  # fmt: skip
    with killed_after(program, within_s, *([of] if of is not None else [])):
        yield program


def heard(program: subprocess.Popen[str], pattern: str) -> re.Match[str]:
    """Its next line in which `pattern` is found."""
    assert program.stdout is not None
    said = ""
    for line in program.stdout:
        said += line
        if found := re.search(pattern, line):
            return found
    raise AssertionError(f"it ended without {pattern!r}; it said:\n{said}")


def kinds(record: RunRecord, about: str) -> list[str]:
    """The events of an aircraft, in order."""
    return [row["kind"] for row in record.table("events").to_pylist() if row["about"] == about]
