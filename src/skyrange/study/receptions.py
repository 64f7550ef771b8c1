"""Who heard whom, where, and how strong? The recorded receptions as columns, by claimed link and receiver."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyrange.record.run import RunRecord

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
