"""Receptions in observed frames: Remote ID broadcasts that a radio received, as columns.

The broadcasts that the receiver of an aircraft decodes arrive on its `rid_down` link, and those of the ground receivers
of an operator on the operator's `oracle` link. A monitor at the receiving end reads receptions from the frames that
arrive there. They do not include the true sender: address and body are claims.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.remote_id.link_payload import NO_RSSI, RidFrame, unpack_rows
from skyrange.contracts.frames import Ints, Payloads
from skyrange.contracts.monitors import ObservedFrames
from skyrange.core.errors import DecodeError
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
    found: list[RidFrame] = []
    for row in np.flatnonzero(kinds == 2).tolist():
        try:
            report = decode(frames.payloads[row])
        except DecodeError:
            continue
        rows += [row] * len(report.body)
        receivers += [names.setdefault(reception.receiver, len(names)) for reception in report.body]
        found += [reception.frame() for reception in report.body]
    heads = [frame.header for frame in found]
    order = np.argsort(_ints(rows), kind="stable")
    rssi = np.concatenate([table.rssi_cdbm[valid].astype(np.int64), _ints(head.rssi_cdbm for head in heads)])
    addresses = np.frombuffer(b"".join(head.address for head in heads), dtype=np.uint8).reshape(-1, 6)
    bodies = Payloads.join([table.bodies.take(valid), Payloads.of([frame.body for frame in found])])
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
