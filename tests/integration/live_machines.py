"""Machines for live ranges: network namespaces on one switch, each with a clock of its own. Needs root on Linux.

A machine is a network namespace with a time namespace: nothing is between them but the network.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from tests.integration.live_programs import skyrange

NET = f"sr{os.getpid() % 100_000}"
ADDRESSES = ("10.199.0.1", "10.199.0.2", "10.199.0.3")
AHEAD_S = (0, 5000, 900)
"""What each machine's clock shows more than the first one's."""


def _can() -> bool:
    if not sys.platform.startswith("linux") or os.geteuid() != 0 or not shutil.which("ip"):
        return False
    tried = ["unshare", "--net", "--time", "--monotonic", "1", "true"]
    return shutil.which("unshare") is not None and subprocess.run(tried, capture_output=True).returncode == 0


needs_machines = pytest.mark.skipif(not _can(), reason="needs root, `ip` and `unshare` with time namespaces")


def ip(command: str) -> None:
    """Run `ip` with these arguments."""
    subprocess.run(["ip", *command.split()], check=True, capture_output=True)


def network(at: int) -> str:
    """The name of a machine's network."""
    return f"{NET}{'abc'[at]}"


@contextmanager
def switched(count: int) -> Iterator[list[list[str]]]:
    """Machines on one switch: what to put before a command so that it runs on the first, the second, …"""
    names = [network(at) for at in range(count)]
    switch = f"{NET}s"
    try:
        ip(f"netns add {switch}")
        ip(f"-n {switch} link add br0 type bridge")
        ip(f"-n {switch} link set br0 up")
        for at, name in enumerate(names):
            ip(f"netns add {name}")
            ip(f"-n {name} link set lo up")
            ip(f"link add eth0 netns {name} type veth peer name p{at} netns {switch}")
            ip(f"-n {switch} link set p{at} master br0")
            ip(f"-n {switch} link set p{at} up")
            ip(f"-n {name} addr add {ADDRESSES[at]}/24 dev eth0")
            ip(f"-n {name} link set eth0 up")
        clocks = [["unshare", "--time", "--monotonic", str(ahead)] if ahead else [] for ahead in AHEAD_S]
        yield [["ip", "netns", "exec", name, *clocks[at]] for at, name in enumerate(names)]
    finally:
        for name in (*names, switch):
            subprocess.run(["ip", "netns", "del", name], check=False, capture_output=True)


def range_keys(folder: Path, *names: str) -> Path:
    """A folder of keys for machines of these names."""
    made = folder / "keys"
    subprocess.run(skyrange("keys", made, *names), check=True, capture_output=True)
    return made


def begin(command: list[str], log: Path) -> subprocess.Popen[bytes]:
    """Start a program that writes to `log`."""
    with log.open("wb") as output:
        return subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)


def node(key: Path, *options: str) -> list[str]:
    """`skyrange node`, to the first machine."""
    return skyrange("node", "--join", ADDRESSES[0], "--key", key, *options)


def manifest(folder: Path) -> dict[str, Any]:
    """That of the run in `folder`."""
    found: dict[str, Any] = json.loads((folder / "run" / "manifest.json").read_text())
    return found


def process_of(part: Path) -> int:
    """The process that records into `part`, on whichever machine; 0 while there is none."""
    config = os.fsencode(f"{part}.program/node.json")
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and config in (entry / "cmdline").read_bytes().split(b"\0"):
                return int(entry.name)
        except OSError:  # it has ended
            continue
    return 0


def namespaces() -> list[str]:
    """What ranges with `--netns` have made, and not yet removed."""
    return [one for one in os.listdir("/run/netns") if one.startswith("sky")] + [
        name for _, name in socket.if_nameindex() if name.startswith("sky")
    ]
