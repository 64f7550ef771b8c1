"""Use of the radio band as the owner of a medium knows it, for radio links that are not nodes of the medium."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from skyrange.contracts.medium import RadioTable
from skyrange.core.ids import FrameId
from skyrange.core.time import Time


class NoiseBurst(NamedTuple):
    """Noise of a jammer."""

    radio: int
    """Row of its radio in `Spectrum.radios`."""
    centre_mhz: float
    width_mhz: float
    power_dbm: float
    """Radiated power (EIRP), spread evenly over the width."""
    from_ns: Time
    to_ns: Time
    turnaround_ns: Time = 0
    """0: the noise lasts all the time. Otherwise a reactive jammer: it makes noise only while it hears a frame in its
    band, from this long after the frame's start until its end."""
    bssid: bytes = b""
    """The access point that a reactive jammer follows to other channels; empty for none."""
    follow_ns: Time = 0
    """How long the access point has been on a channel when the jammer finds it there."""


class Transmission(NamedTuple):
    """A Wi-Fi frame that was sent in the medium."""

    radio: int
    channel: int
    started_ns: Time
    ended_ns: Time


class ManagementFrame(NamedTuple):
    """An 802.11 management frame that a radio was asked to send."""

    radio: int
    at_ns: Time
    channel: int
    power_dbm: float
    mac_frame: bytes
    """With its frame check sequence."""
    ref: FrameId
    """The frame on the radio's link by which it was asked."""


class Spectrum:
    """Positions of a medium's radios, the noise, and what was sent since the last call of `take`. Deep-copyable."""

    __slots__ = ("_frames", "_sent", "bursts", "radios", "table")

    def __init__(self) -> None:
        self.radios: Sequence[str] = ()
        """Names of the medium's radios, in the order of the rows of `table`."""
        self.table: RadioTable | None = None
        self.bursts: Sequence[NoiseBurst] = ()
        """Those that are on or will be."""
        self._sent: list[Transmission] = []
        self._frames: list[ManagementFrame] = []

    def add_transmission(self, transmission: Transmission) -> None:
        """Tell of a frame that was sent."""
        self._sent.append(transmission)

    def add_management_frame(self, frame: ManagementFrame) -> None:
        """Have a management frame sent."""
        self._frames.append(frame)

    def take(self) -> tuple[list[Transmission], list[ManagementFrame]]:
        """What was told since the last call."""
        sent, self._sent = self._sent, []
        frames, self._frames = self._frames, []
        return sent, frames
