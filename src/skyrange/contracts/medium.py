"""The contract of radio media, as columns: which receiver gets which transmission, and when a frame may be sent.

A medium never sees a frame's bytes: whoever offers a transmission keeps them under its `key`. Nothing here depends on
what is sent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.components import InstanceStatus
from skyrange.core.time import Time

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

ANY_CHANNEL = -1
"""In `TxBatch.channel`: the medium chooses. A Bluetooth request is always an advertising event on all its channels."""


class Waveform(IntEnum):
    """Modulation of a frame, and the rules by which its radio gets access to the channel."""

    DSSS_1M = 0
    """802.11 DSSS, 1 Mb/s, long preamble; carrier sense."""
    OFDM_6M = 1
    """802.11 OFDM, 6 Mb/s, in the 2.4 GHz band; carrier sense."""
    BLE_1M = 2
    """Bluetooth LE 1M: a legacy advertising event, one PDU on each of the channels 37, 38 and 39."""
    BLE_CODED = 3
    """Bluetooth LE Coded, S=8: an extended advertising event, pointers on 37, 38, 39 to a PDU on a data channel."""


class ScanStep(NamedTuple):
    """One step of a receiver's scan: a channel, and the waveforms that it receives there."""

    channel: int
    """Wi-Fi channel 1…13 or BLE channel index 37…39."""
    waveforms: tuple[Waveform, ...]


@dataclass(frozen=True, slots=True)
class ScanSchedule:
    """The scan of one receive chain: for each of `turns`, `window_ns` of listening in every `dwell_ns`, then a rest.

    All turns are in one band, Wi-Fi or Bluetooth. A single turn without a gap listens all the time. The phase of the
    scan at time 0 is chance, addressed by the receiver's name.
    """

    turns: tuple[ScanStep, ...]
    dwell_ns: Time = 0
    window_ns: Time = 0
    rest_ns: Time = 0


@dataclass(frozen=True, slots=True)
class RadioSpec:
    """One radio: its place or that it moves, what it listens to, its power, antenna and noise figure."""

    name: str
    """Unique; addresses its chance. For an aircraft's radio, the vehicle's id."""
    place_enu_m: tuple[float, float, float] | None = None
    """Of a fixed radio; None where the rows of `RadioTable` move it."""
    listening: tuple[ScanSchedule, ...] = ()
    """At most one chain per band; a radio without any only sends."""
    wifi_dbm: float = 15.0
    """Power into the antenna."""
    ble_dbm: float = 8.0
    antenna: str = "isotropic"
    """`isotropic`, or `dipole`: a vertical half-wave dipole."""
    gain_dbi: float = 0.0
    """Added to the antenna's pattern: cables, a case, an amplifier."""
    noise_figure_db: float = 7.0


class RadioTable(NamedTuple):
    """Positions of the radios: rows in the order of the medium's `radios`. A NaN position means that it is absent."""

    from_ns: Time
    """The table holds from this time until that of the next table."""
    pos_enu_m: Floats
    """(n, 3), metres, up from the ground."""
    vel_enu_mps: Floats
    """(n, 3)"""


class TxBatch(NamedTuple):
    """Frames that radios are to send: one row each, the frames of one radio and instant in their order."""

    radio: Ints
    """Row of the sender."""
    at_ns: Ints
    """When the frame is handed to its radio, after the last `advance`."""
    waveform: Ints
    """`Waveform`"""
    channel: Ints
    """Wi-Fi channel, or `ANY_CHANNEL`."""
    power_dbm: Floats
    """NaN for the radio's own."""
    size_bytes: Ints
    """Of the MAC frame with its check sequence, or of the advertising PDU's payload."""
    key: Ints
    """Names the frame in answers; 0 or more, unique among those under way."""


class EmitterTable(NamedTuple):
    """Sources of noise: one row per source and band."""

    radio: Ints
    centre_mhz: Floats
    width_mhz: Floats
    power_dbm: Floats
    """Total, into the antenna, spread evenly over the width."""
    from_ns: Ints
    to_ns: Ints


class TransmissionFate(IntEnum):
    """Fate of a transmission."""

    SENT = 0
    NO_ACCESS = 1
    """The channel was not free in time."""
    REFUSED = 2
    """No such frame: its size, channel or waveform does not exist."""
    LOST = 3
    """The program that simulates it ended while it was under way, or before."""


class ReceptionOutcome(IntEnum):
    """Outcome of a frame at a receiver that was in range."""

    DECODED = 0
    WEAK = 1
    """Too low a signal-to-noise ratio."""
    COLLIDED = 2
    """Other transmissions, noise sources or the city's background load covered it; alone it would have been decoded."""
    BUSY = 3
    """The receiver was locked on another frame."""
    SENDING = 4
    """The receiver's own radio was sending."""
    ELSEWHERE = 5
    """The receiver listened to another channel, to another waveform, or not at all."""


class Sent(NamedTuple):
    """Transmissions that ended, one row per burst on the air, in order of their ends."""

    key: Ints
    radio: Ints
    channel: Ints
    """The one that was used."""
    started_ns: Ints
    ended_ns: Ints
    fate: Ints
    """`TransmissionFate`; unless SENT, both times are those of giving up."""


class Heard(NamedTuple):
    """Outcomes of frames at receivers, in order of (end, key, receiver)."""

    key: Ints
    radio: Ints
    """Row of the receiver."""
    channel: Ints
    ended_ns: Ints
    rssi_dbm: Floats
    snir_db: Floats
    """Of the frame's worst part."""
    outcome: Ints
    """`ReceptionOutcome`"""


class OnAir(NamedTuple):
    """What one `advance` brought."""

    sent: Sent
    heard: Heard
    """Everything that was decoded; other outcomes too where the medium was asked for every pair."""


class ReceptionRows(NamedTuple):
    """Receptions as columns: the outcome of each frame at each receiver in range."""

    time_ns: Ints
    """End of the reception."""
    number: Ints
    """Which of `Receptions.names` the frame has; its serial there is in `serial`."""
    serial: Ints
    radio: Ints
    """Which of `Receptions.radios` received it."""
    place_enu_m: Floats
    """(n, 3), where the receiver was."""
    transport: Ints
    channel: Ints
    rssi_dbm: Floats
    snir_db: Floats
    outcome: Ints
    """`ReceptionOutcome`"""


class Receptions(NamedTuple):
    """Receptions for the record, from the owner of a medium."""

    names: Sequence[tuple[str, str, str]]
    """(link, direction, sender) of frames that were sent through the air."""
    radios: Sequence[str]
    rows: ReceptionRows


class ProgramStatus(NamedTuple):
    """A program that a medium runs, as a range lists it beside its own processes."""

    name: str
    pid: int
    """Process id of the last one that was started."""
    state: InstanceStatus
    """`READY` or `DEAD`."""
    ended: tuple[str, ...] = ()
    """How each process of this name ended that was started before, or that is not replaced."""


class Medium(Protocol):
    """A radio medium: which radio receives which frame, and when a frame gets its turn.

    What it answers depends neither on how the time is cut into `advance`s, nor, but for interference, on what else is
    on the air: chance is addressed by the radios' names and by times, never by rows or counters. Its state is
    deep-copyable; one that runs programs may refuse `copy.deepcopy` with a `ComponentError`.

    Derive from `MediumBase` to get the members that a medium without programs need not think of.
    """

    @property
    def repeatable(self) -> Literal["bytes", "outcome"]:
        """Whether the same inputs give the same answers to the byte; "outcome" for a program that cannot promise it."""
        ...

    @property
    def runs_programs(self) -> bool:
        """Whether it runs programs or reaches for some: it then uses processes, sockets or files."""
        ...

    @property
    def programs(self) -> Sequence[ProgramStatus]:
        """The programs that it runs now; empty for most media."""
        ...

    radios: Sequence[RadioSpec]
    """In the order of every table's rows: sorted by name."""
    lookahead_ns: Time
    """Extra latency of an engine that is a program; 0 for the builtin."""

    @property
    def losses(self) -> Ints:
        """(radios, outcomes): how often each `ReceptionOutcome` was met at each receiver so far."""
        ...

    @property
    def quiet(self) -> bool:
        """Whether nothing waits or is on the air: an `advance` would answer nothing."""
        ...

    @property
    def manifest(self) -> Mapping[str, Any]:
        """What the record says of it beside its kind: of a program its version, path and so on; else nothing."""
        ...

    def offer(self, now: Time, requests: TxBatch) -> None:
        """Take frames to be sent. Raises ValueError for a row that is not there or a time that has passed.

        A frame that does not exist (its size, channel, waveform or power) is told of as REFUSED; of one that is taken,
        everything has been told two seconds after its time.
        """
        ...

    def emit(self, now: Time, sources: EmitterTable) -> None:
        """From `now` on, just these sources make noise; earlier ones end."""
        ...

    def advance(self, until: Time, radios: RadioTable) -> OnAir:
        """Let the time pass up to and including `until`, in which the radios are where `radios` says."""
        ...

    def close(self) -> None:
        """End what it started, such as a program. Called once the run has ended, however it did; again does nothing."""
        ...


class MediumBase:
    """Members of a medium that runs no programs and repeats to the byte; override those that differ."""

    lookahead_ns: Time = 0
    repeatable: Literal["bytes", "outcome"] = "bytes"
    runs_programs: bool = False
    programs: Sequence[ProgramStatus] = ()

    @property
    def manifest(self) -> Mapping[str, Any]:
        """Nothing."""
        return {}

    def close(self) -> None:
        """There is nothing to end."""
