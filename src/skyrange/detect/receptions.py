"""Remote ID in observed frames, as columns: broadcasts that a radio received, and what they claim in local coordinates.

The broadcasts that the receiver of an aircraft decodes arrive on its `rid_down` link, and those of the ground receivers
of an operator on the operator's `oracle` link. A monitor at the receiving end reads receptions from the frames that
arrive there. They do not include the true sender: address and body are claims.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.f3411.columns import decode_locations
from skyrange.codec.f3411.values import HORIZONTAL_ACCURACY_M, SPEED_ACCURACY_MPS
from skyrange.codec.remote_id.link_payload import NO_RSSI, RidFrame, unpack_rows
from skyrange.contracts.frames import Ints, Payloads
from skyrange.contracts.monitors import ObservedFrames
from skyrange.core import elementwise
from skyrange.core.errors import DecodeError
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Time
from skyrange.detect.messages import read_messages
from skyrange.detect.streams import StreamNumbers, extend
from skyrange.radio.ground_receptions import decode

_DOWN = "rid_down:"
_GROUND = "oracle:"


class ObservedReceptions(NamedTuple):
    """Broadcasts that were received, one row each, in the order of their frames."""

    rows: Ints
    """(n,) the frame that reports each; a frame of ground receivers reports several."""
    receivers: Sequence[str]
    """Names of the radios by the numbers in `receiver`: vehicles and ground receivers."""
    receiver: Ints
    """(n,) the number of the radio that received it."""
    time_ns: Ints
    """(n,) when the reception ended, in ns, as the receiver reports."""
    transport: Ints
    """(n,) `codec.link_payload.Transport`"""
    channel: Ints
    """(n,) Wi-Fi channel or Bluetooth channel index."""
    rssi_dbm: NDArray[np.float64]
    """(n,) signal strength; NaN if the receiver does not report it."""
    address: NDArray[np.uint8]
    """(n, 6) the sender's address, as claimed."""
    bodies: Payloads
    """n messages or message packs of ASTM F3411."""


def read_receptions(frames: ObservedFrames) -> ObservedReceptions:
    """The receptions that `frames` report; frames without receptions are left out."""
    kinds = np.array([_kind(port.link) for port in frames.ports], dtype=np.int64)[frames.places]
    kinds[~frames.received] = 0
    owners = [port.link.partition(":")[2] for port in frames.ports]
    names: dict[str, int] = {}
    downs = np.flatnonzero(kinds == 1)
    table = unpack_rows(frames.payloads.take(downs))
    valid = np.flatnonzero(table.valid)
    rows = downs[valid].tolist()
    receivers = [names.setdefault(owners[place], len(names)) for place in frames.places[rows].tolist()]
    rid_frames: list[RidFrame] = []
    for row in np.flatnonzero(kinds == 2).tolist():
        try:
            report = decode(frames.payloads[row])
        except DecodeError:
            continue
        rows += [row] * len(report.body)
        receivers += [names.setdefault(reception.receiver, len(names)) for reception in report.body]
        rid_frames += [reception.frame() for reception in report.body]
    heads = [frame.header for frame in rid_frames]
    order = np.argsort(_ints(rows), kind="stable")
    rssi = np.concatenate([table.rssi_cdbm[valid].astype(np.int64), _ints(head.rssi_cdbm for head in heads)])
    addresses = np.frombuffer(b"".join(head.address for head in heads), dtype=np.uint8).reshape(-1, 6)
    bodies = Payloads.join([table.bodies.take(valid), Payloads.of([frame.body for frame in rid_frames])])
    return ObservedReceptions(
        _ints(rows)[order],
        list(names),
        _ints(receivers)[order],
        np.concatenate([table.time_ns[valid], _ints(head.time_ns for head in heads)])[order],
        np.concatenate([table.transport[valid].astype(np.int64), _ints(head.transport for head in heads)])[order],
        np.concatenate([table.channel[valid].astype(np.int64), _ints(head.channel for head in heads)])[order],
        np.where(rssi == NO_RSSI, np.nan, rssi / 100.0)[order],
        np.concatenate([table.address[valid], addresses])[order],
        bodies.take(order),
    )


def _kind(link: str) -> int:
    """1 for a link with receptions of an aircraft, 2 for one with those of ground receivers, else 0."""
    return 1 if link.startswith(_DOWN) else 2 if link.startswith(_GROUND) else 0


def _ints(values: Iterable[int]) -> Ints:
    return np.array(list(values), dtype=np.int64)


Floats = NDArray[np.float64]
HOUR_S: Final = 3600.0
UNKNOWN_M: Final = 30.0
"""Accuracy of a position that states none (assumed: F3411 code 9)."""
UNKNOWN_MPS: Final = 1.0
"""Accuracy of a speed that states none (assumed: F3411 code 3)."""
_ACCURACY_M: Final = np.array(
    [UNKNOWN_M if accuracy is None else accuracy for accuracy in HORIZONTAL_ACCURACY_M] + [UNKNOWN_M] * 3
)
_ACCURACY_MPS: Final = np.array(
    [UNKNOWN_MPS if accuracy is None else accuracy for accuracy in SPEED_ACCURACY_MPS] + [UNKNOWN_MPS] * 11
)
UAS_ID_BYTES: Final = 20
_POSITION: Final = "GLOBAL_POSITION_INT"


class Claims(NamedTuple):
    """Locations that were received, one row each, in order of time for each place and sender."""

    places: Ints
    """(n,) the place of the link end in `ObservedFrames.ports`."""
    senders: Ints
    """(n,) a hash of the place and the UAS ID that the sender claims; of its address while it claims no UAS ID."""
    receiver: Ints
    """(n,) the number of the receiving radio in the names that `read_claims` returns."""
    time_ns: Ints
    """(n,) when the reception ended; not later than the service."""
    enu_m: Floats
    """(n, 3) the claimed position; NaN where unknown."""
    velocity_mps: Floats
    """(n, 2) the claimed velocity over ground; NaN where unknown."""
    speed_mps: Floats
    climb_mps: Floats
    age_s: Floats
    """(n,) from the stated time of the position to the reception, -1800…1800; NaN where unknown."""
    error_m: Floats
    """(n,) stated horizontal accuracy (95 %)."""
    error_mps: Floats
    """(n,) stated accuracy of the speed (95 %)."""
    rssi_dbm: Floats
    """(n,) NaN where the receiver reports none."""
    uas_ids: NDArray[np.bytes_]
    """(n,) the UAS ID in the same broadcast; b"" if there is none."""


class SenderNames:
    """UAS IDs by addresses: Bluetooth 4 sends Location and Basic ID in messages of their own."""

    def __init__(self) -> None:
        self._addresses = StreamNumbers()
        self._ids = np.zeros(0, dtype=np.int64)

    def find(self, addresses: Ints, ids: Ints, has_id: NDArray[np.bool_]) -> Ints:
        """(n,) hashes of the UAS ID of each row: its own, or the last of its address, or else the address itself."""
        numbers = self._addresses.assign(addresses)
        self._ids = extend(self._ids, len(self._addresses), -1)
        self._ids[numbers[has_id]] = ids[has_id]
        known = np.where(has_id, ids, self._ids[numbers])
        return np.where(known >= 0, known, addresses)


def read_claims(
    now: Time, frames: ObservedFrames, origin: Origin, utc_ns: Time, names: SenderNames
) -> tuple[Claims, list[str]]:
    """The Locations received, and the names of the receivers. `utc_ns` is Unix time at simulated time 0, in ns."""
    heard = read_receptions(frames)
    located = decode_locations(heard.bodies)
    ids = _hash(np.ascontiguousarray(located.uas_id).view(np.uint8).reshape(len(heard.rows), UAS_ID_BYTES))
    keys = names.find(_hash(heard.address), ids, located.has_id)
    rows = np.flatnonzero(located.has_location)
    time_ns = np.clip(heard.time_ns, 0, now)
    places = frames.places[heard.rows]
    senders = _mix(keys ^ _mix(places + 1))
    rows = rows[np.lexsort((rows, time_ns[rows], senders[rows]))]
    east_m, north_m = origin.to_enu(located.lat_deg[rows], located.lon_deg[rows])
    up_m = origin.msl_of(located.alt_geo_m[rows]) - origin.alt_msl_m
    track = np.radians(located.track_deg[rows])
    speed = located.speed_mps[rows]
    heading = np.stack((elementwise.sin(track), elementwise.cos(track)), axis=1)
    velocity = np.where(speed[:, None] == 0.0, 0.0, speed[:, None] * heading)
    said_s = (utc_ns + time_ns[rows]) % int(HOUR_S * NS_PER_S) / NS_PER_S
    age_s = (said_s - located.timestamp_s[rows] + HOUR_S / 2.0) % HOUR_S - HOUR_S / 2.0
    claims = Claims(
        places[rows],
        senders[rows],
        heard.receiver[rows],
        time_ns[rows],
        np.stack((east_m, north_m, up_m), axis=1),
        velocity,
        speed,
        located.vertical_mps[rows],
        age_s,
        _ACCURACY_M[located.horizontal_accuracy[rows]],
        _ACCURACY_MPS[located.speed_accuracy[rows]],
        heard.rssi_dbm[rows],
        located.uas_id[rows],
    )
    return claims, list(heard.receivers)


def find_receivers(frames: ObservedFrames, origin: Origin, known: dict[str, tuple[float, float, float]]) -> None:
    """Put the positions of aircraft into `known` by vehicle id, from telemetry at other ends, such as of `rid_data`."""
    if not any(not port.link.startswith(("rid_down:", "oracle:")) for port in frames.ports):
        return
    positions = read_messages(frames, _POSITION)
    if not len(positions.rows):
        return
    places, last = np.unique(frames.places[positions.rows][::-1], return_index=True)
    values = positions.values[len(positions.rows) - 1 - last]
    east_m, north_m = origin.to_enu(values["lat"] / 1e7, values["lon"] / 1e7)
    up_m = values["alt"] / 1000.0 - origin.alt_msl_m
    for place, *at in zip(places.tolist(), east_m.tolist(), north_m.tolist(), up_m.tolist(), strict=True):
        known[frames.ports[place].link.partition(":")[2]] = (at[0], at[1], at[2])


def _hash(raw: NDArray[np.uint8]) -> Ints:
    """(n,) 63-bit hashes of n rows of bytes."""
    total = np.zeros(len(raw), dtype=np.int64)
    for start in range(0, raw.shape[1], 4):
        word = np.zeros(len(raw), dtype=np.int64)
        for column in range(start, min(start + 4, raw.shape[1])):
            word = word << 8 | raw[:, column]
        total = _mix(total ^ word)
    return total


def _mix(values: Ints) -> Ints:
    """A permutation of 64-bit numbers that spreads their bits (the finaliser of SplitMix64), without the sign."""
    word = values.astype(np.uint64)
    word = (word ^ word >> np.uint64(30)) * np.uint64(0xBF58476D1CE4E5B9)
    word = (word ^ word >> np.uint64(27)) * np.uint64(0x94D049BB133111EB)
    word ^= word >> np.uint64(31)
    return (word & np.uint64(2**62 - 1)).astype(np.int64)
