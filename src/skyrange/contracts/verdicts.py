"""Verdicts of taps on frames, and labels of the acts of attacks and faults."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from skyrange.contracts.alerts import Alert
from skyrange.contracts.mailboxes import Note
from skyrange.core.ids import FrameId
from skyrange.core.time import Time

Direction = Literal["fwd", "rev"]


@dataclass(frozen=True, slots=True)
class Pass:
    """Let it go on."""


@dataclass(frozen=True, slots=True)
class Drop:
    """Take it off the link."""


@dataclass(frozen=True, slots=True)
class Delay:
    """Hold it until `until`; the taps after this one see it then."""

    until: Time


@dataclass(frozen=True, slots=True)
class Replace:
    """Send `payload` in its place: a new frame, whose parent is the old one."""

    payload: bytes


@dataclass(frozen=True, slots=True)
class Inject:
    """Put a new frame on the link in `direction`, claiming `src` and `dst`.

    It meets only what comes after the tap in that direction. `parent` names the frame that it replays, if any.
    """

    payload: bytes
    direction: Direction
    src: str
    dst: str
    parent: FrameId | None = None


Verdict = Pass | Drop | Delay | Replace | Inject | Note | Alert
"""What a tap answers. A `Note` records what it has learnt; that of an attack's tap only while the attack acts. An
`Alert` is the alarm of a defence, which no other tap may raise."""

Verdicts = Sequence[Verdict]
"""What a tap answers a frame: at most one that decides on it, and any number of others; none lets it pass."""


class Label(NamedTuple):
    """One act of an attack or a fault, written by the kernel: who did what to which frame or sensor, and when.

    `frame` is the frame acted on or put on the link, `child` the one that a replacement put in its place. `until_ns` is
    set for delays. For "sensor", "body" and "scan", `frame` is the act's own id, whose link is the sensor or the part
    of the body: `gnss:blue/b1`, `motor:blue/b1`, `lidar:blue/b1`. There is one "scan" for each altered scan, at the
    time at which the scan begins.
    """

    at_ns: Time
    attack: str
    """Id of the attack, or of the fault."""
    actor: str
    action: str  # drop | delay | replace | inject | send | sensor | body | scan
    frame: FrameId
    child: FrameId | None = None
    until_ns: Time | None = None
    benign: bool = False
    """Whether the act is that of a sham, or of a real aircraft in the honest arm."""
    fault: bool = False
    """Whether the act is that of a benign fault, which has no adversary."""
    harmless_intrusion: bool = False
    """Whether it is one of the benign acts that an intrusion detector may report: a sham put a frame of somebody
    unauthorised on a link or in the air."""
