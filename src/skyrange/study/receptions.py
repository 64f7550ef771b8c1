"""Who heard whom, where, and how strong? The recorded receptions as columns, by claimed link and receiver."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from skyrange.core.time import NS_PER_S
from skyrange.record.run import RunRecord
from skyrange.study.series import Record, vehicles

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Receptions:
    """One row per reception: `sender` and `receiver` are who sent and who heard, `enu_m` (n, 3) where that one was."""

    time_ns: NDArray[np.int64]
    sender: NDArray[np.str_]
    receiver: NDArray[np.str_]
    enu_m: Floats
    rssi_dbm: Floats
    decoded: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.time_ns)

    def of(self, senders: Iterable[str]) -> Receptions:
        """Those of some senders."""
        keep = np.isin(self.sender, list(senders))
        return Receptions(
            self.time_ns[keep], self.sender[keep], self.receiver[keep], self.enu_m[keep], self.rssi_dbm[keep],
            self.decoded[keep],
        )  # fmt: skip


def receptions_of(record: RunRecord) -> Receptions | None:
    """What a run recorded of them; None where it recorded none."""
    table = record.table("receptions")
    if not table.num_rows:
        return None
    places = np.stack([table.column(name).to_numpy() for name in ("east_m", "north_m", "up_m")], axis=1)
    senders = [link.partition(":")[2] for link in table.column("link").to_pylist()]
    return Receptions(
        table.column("time_ns").to_numpy(),
        np.array(senders, dtype=np.str_),
        np.array(table.column("receiver").to_pylist(), dtype=np.str_),
        places.astype(np.float64),
        table.column("rssi_dbm").to_numpy().astype(np.float64),
        np.array(table.column("outcome").to_pylist()) == "decoded",
    )


def who_heard_whom(heard: Receptions) -> list[dict[str, Any]]:
    """One row per sender and receiver: how many broadcasts were decoded of how many, and at which median strength."""
    pairs: dict[tuple[str, str], list[int]] = {}
    for row, pair in enumerate(zip(heard.sender.tolist(), heard.receiver.tolist(), strict=True)):
        pairs.setdefault(pair, []).append(row)
    found = []
    for (sender, receiver), rows in sorted(pairs.items()):
        decoded = heard.decoded[rows]
        strength = heard.rssi_dbm[rows][decoded] if decoded.any() else heard.rssi_dbm[rows]
        found.append(
            {
                "sender": sender,
                "receiver": receiver,
                "decoded": int(decoded.sum()),
                "of": len(rows),
                "median_dbm": float(np.median(strength)),
                "most_dbm": float(strength.max()),
            }
        )
    return found


MOST_AIRCRAFT = 40
"""Of larger fleets only what ground receivers heard is read, since everybody hears everybody."""


@dataclass(frozen=True, slots=True)
class Hearing:
    """What one receiver decoded of one sender: times are ends of receptions.

    `silence_s` is the longest between two, `None` where there was but one.
    """

    receiver: str
    sender: str
    decoded: int
    median_dbm: float
    most_dbm: float
    first_s: float
    last_s: float
    silence_s: float | None


def hearings(record: Record) -> list[Hearing]:
    """What each ground receiver heard, by receiver and sender; then each aircraft of a fleet of `MOST_AIRCRAFT`."""
    wanted = [str(row["id"]) for row in record.manifest.get("receivers") or []]
    fleet = [vehicle.id for vehicle in vehicles(record)]
    if len(fleet) <= MOST_AIRCRAFT:
        wanted += fleet
    if not wanted:
        return []
    parts: dict[tuple[str, str], list[tuple[NDArray[np.int64], Floats]]] = {}
    for batch in record.batches("receptions", ["time_ns", "link", "receiver", "rssi_dbm", "outcome"]):
        keep = pc.is_in(batch.column("receiver"), value_set=pa.array(wanted, pa.string()))
        rows = batch.filter(pc.and_(keep, pc.equal(batch.column("outcome"), "decoded")))
        if not rows.num_rows:
            continue
        pairs = np.array(pc.binary_join_element_wise(rows.column("receiver"), rows.column("link"), "\n").to_pylist())
        found, number = np.unique(pairs, return_inverse=True)
        order = np.argsort(number, kind="stable")
        ends = np.cumsum(np.bincount(number))[:-1]
        times = np.split(rows.column("time_ns").to_numpy()[order], ends)
        levels = np.split(rows.column("rssi_dbm").to_numpy()[order], ends)
        for pair, at_ns, rssi_dbm in zip(found.tolist(), times, levels, strict=True):
            receiver, link = pair.split("\n")
            parts.setdefault((receiver, link.partition(":")[2]), []).append((at_ns, rssi_dbm))
    places = {name: place for place, name in enumerate(wanted)}
    return [_hearing(*pair, parts[pair]) for pair in sorted(parts, key=lambda pair: (places[pair[0]], pair[1]))]


def _hearing(receiver: str, sender: str, parts: list[tuple[NDArray[np.int64], Floats]]) -> Hearing:
    seconds = np.sort(np.concatenate([at_ns for at_ns, _ in parts])) / NS_PER_S
    rssi_dbm = np.concatenate([rssi for _, rssi in parts])
    return Hearing(
        receiver,
        sender,
        len(seconds),
        float(np.median(rssi_dbm)),
        float(rssi_dbm.max()),
        float(seconds[0]),
        float(seconds[-1]),
        float(np.diff(seconds).max()) if len(seconds) > 1 else None,
    )
