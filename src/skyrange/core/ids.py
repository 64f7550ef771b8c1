"""Identifiers of vehicles, endpoints, link instances and frames, and their stable hashes.

`blue/b1` is a vehicle, `blue/b1.autopilot` one of its endpoints, `gcs:blue/b1` one link instance. These names are in
every log, label and figure, and they address chance, so they never depend on the order of registration.
"""

from __future__ import annotations

import re
from functools import lru_cache
from hashlib import blake2b
from typing import NamedTuple

ID_PATTERN = re.compile(r"^[A-Za-z0-9][A-Za-z0-9_-]{0,31}$")
"""Operator, vehicle and attack ids: they become file names and parts of link names."""

APPROVAL = "approval"


class Port(NamedTuple):
    """One end of one link: where its owner sends and receives."""

    endpoint: str
    link: str
    run: int = 0
    """The run of a batch whose link it is, 0 for a run alone."""


class FrameId(NamedTuple):
    """Identity of a frame: the link, its direction, the true sender, and that sender's serial number there."""

    link: str
    direction: str
    sender: str
    serial: int

    def __str__(self) -> str:
        return f"{self.link}|{self.direction}|{self.sender}|{self.serial}"

    @classmethod
    def parse(cls, text: str) -> FrameId:
        """The id that `str` wrote; `ValueError` on anything else."""
        link, direction, sender, serial = text.split("|")
        return cls(link, direction, sender, int(serial))


def vehicle_id(operator: str, vehicle: str) -> str:
    """`operator/vehicle`, unique in the range."""
    return f"{operator}/{vehicle}"


def operator_of(vehicle: str) -> str:
    """The operator's part of a vehicle id."""
    return vehicle.split("/", 1)[0]


def endpoint(owner: str, role: str) -> str:
    """`owner.role`: `blue/b1.autopilot`, `blue.gcs`."""
    return f"{owner}.{role}"


def originator_id(endpoint_name: str) -> str:
    """The true sender of what an endpoint sends on a link over which it otherwise forwards: `blue/b1.companion.own`.

    It has serials of its own, so that what is forwarded there is numbered as if the endpoint had sent nothing.
    """
    return endpoint(endpoint_name, "own")


def owner_of(endpoint_name: str) -> str:
    """The vehicle or operator that an endpoint belongs to."""
    return endpoint_name.rsplit(".", 1)[0]


def link_name(kind: str, owner: str) -> str:
    """`kind:owner`, the name of a link instance: `gcs:blue/b1`, `approval:blue`."""
    return f"{kind}:{owner}"


_RUN_MARK = "|"


def qualify(run: int, name: str) -> str:
    """A name that is unique over the runs of a batch: `name` in run 0, `3|name` in run 3.

    No id has the mark in it. What is recorded, sent or drawn goes by the run's own name.
    """
    return name if run == 0 else f"{run}{_RUN_MARK}{name}"


def split_run(name: str) -> tuple[int, str]:
    """The run and the own name of which `qualify` made a name."""
    run, mark, own = name.partition(_RUN_MARK)
    return (int(run), own) if mark else (0, name)


@lru_cache(maxsize=65_536)
def hash64(text: str) -> int:
    """A 64-bit address of a name, the same on every machine (BLAKE2b, 8 bytes, little endian)."""
    return int.from_bytes(blake2b(text.encode(), digest_size=8).digest(), "little")
