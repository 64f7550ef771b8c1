"""Network namespaces for operators and aircraft, all on one bridge. For root on Linux.

In a namespace packet tools (tc, Scapy, tcpdump, arpspoof) work as on a real network: `ip netns exec NAME COMMAND`. Each
has the interface `eth0`; the world and the approval are in the machine's own namespace, at the bridge's address.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from skyrange.core.errors import ComponentError, InputError
from skyrange.core.ids import owner_of
from skyrange.runtime.live.deployment import WORLD

NETWORKS: Final = range(77, 128)
"""10.N.0.0/16 is the network of a range, and `skyN` its bridge, for the first N that is free."""
_NAMED: Final = Path("/run/netns")
_PER_BYTE: Final = 250


@dataclass(slots=True)
class Namespaces:
    """The networks of one range. They exist within `with`, and are removed with this process, however it ends."""

    number: int
    names: Mapping[str, str]
    """Names of namespaces, by address."""
    hosts: Mapping[str, str]
    """Addresses by pattern of components, as a scenario's `hosts`."""
    _cleaner: subprocess.Popen[bytes] | None = field(default=None)

    @property
    def bridge(self) -> str:
        """The bridge's name."""
        return f"sky{self.number}"

    def through(self, address: str) -> Sequence[str]:
        """The command through which a process is started at an address; empty for the machine's own namespace."""
        return ("ip", "netns", "exec", self.names[address]) if address in self.names else ()

    def __enter__(self) -> Namespaces:
        undo = [f"ip netns del {name}" for name in self.names.values()] + [f"ip link del {self.bridge}"]
        # a process of its own, which cleans up when its pipe closes, even if this process is killed
        command = ["/bin/sh", "-c", f"cat; {'; '.join(undo)}"]
        self._cleaner = subprocess.Popen(  # noqa: S603 (the whole command is made here)
            command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
        )
        try:
            _ip(
                f"link add {self.bridge} type bridge",
                f"addr add {self.hosts[WORLD]}/16 dev {self.bridge}",
                f"link set {self.bridge} up",
            )
            for at, (address, name) in enumerate(self.names.items()):
                port = f"{self.bridge}-{at}"
                _ip(
                    f"netns add {name}",
                    f"link add {port} type veth peer name eth0 netns {name}",
                    f"link set {port} master {self.bridge} up",
                    f"-n {name} addr add {address}/16 dev eth0",
                    f"-n {name} link set lo up",
                    f"-n {name} link set eth0 up",
                )
        except ComponentError:
            self._clean_up()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._clean_up()

    def _clean_up(self) -> None:
        if self._cleaner is not None:
            self._cleaner.communicate()


def namespaces(components: Sequence[str]) -> Namespaces:
    """Plan one namespace for each ground station and each aircraft of `components`; nothing is created yet.

    Raises `InputError` without Linux, root or `ip`.
    """
    if not sys.platform.startswith("linux") or os.geteuid() != 0:
        who = "another system" if not sys.platform.startswith("linux") else f"user {os.geteuid()}"
        hint = "Run it with sudo, or several machines with hosts in the scenario."
        raise InputError.one("live", "--netns", who, "Linux, and root, to make network namespaces", hint)
    if shutil.which("ip") is None:
        raise InputError.one("live", "--netns", "no `ip` command", "iproute2", "Install the package iproute2.")
    number = next((network for network in NETWORKS if not _taken(network)), None)
    if number is None:
        hint = "`ip link` shows them; `ip link del skyN` removes one."
        raise InputError.one("live", "--netns", "all its networks are in use", f"a free one of sky{NETWORKS[0]}…", hint)
    owners = [component for component in components if component.endswith(".gcs")]
    owners += dict.fromkeys(
        f"{owner_of(component)}.*" for component in components if component.endswith((".companion", ".proxy"))
    )
    hosts = {WORLD: f"10.{number}.0.1"}
    names = {}
    for at, pattern in enumerate(owners):
        address = f"10.{number}.{1 + at // _PER_BYTE}.{1 + at % _PER_BYTE}"
        hosts[pattern] = address
        names[address] = f"sky{number}-{pattern.removesuffix('.*').replace('/', '-')}"
    return Namespaces(number, names, hosts)


def _taken(number: int) -> bool:
    if Path(f"/sys/class/net/sky{number}").exists() or any(_NAMED.glob(f"sky{number}-*")):
        return True
    routes = Path("/proc/net/route")
    prefix = f"{number:02X}0A"  # 10.N, little endian, at the end
    return routes.exists() and any(
        line.split()[1].endswith(prefix) for line in routes.read_text().splitlines()[1:] if len(line.split()) > 1
    )


def _ip(*commands: str) -> None:
    for command in commands:
        whole = ["ip", *command.split()]  # made here, without input of others
        done = subprocess.run(whole, capture_output=True, text=True, check=False)  # noqa: S603
        if done.returncode:
            raise ComponentError(
                "live", f"ip {command}: {done.stderr.strip() or done.returncode}", "--netns needs root"
            )
