"""A small range whose aircraft sign their Remote ID: one over Wi-Fi, one over Bluetooth, one not at all."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from skyrange.codec.remote_id.link_payload import RidFrame, unpack
from skyrange.record import RunRecord
from skyrange.record.read.observations import RADIO_LINK
from skyrange.scenario.toml_files import load_data
from skyrange.study.runs import fly

SIGNS = {"auth": "drip", "verify": {"authorities": "all"}}


def table(duration_s: float = 30.0, **more: Any) -> dict[str, Any]:
    """A scenario as data. Aircraft stand 40 m apart and take off."""

    def operator(name: str, east_m: float, remote_id: dict[str, Any]) -> dict[str, Any]:
        plan = {"path": {"points": [[0, 0], [0, 60]], "alt_m": 30}, "speed_mps": 5, "end": "land"}
        vehicle = {"id": name[0] + "1", "start": [east_m, 0], "plan": plan}
        return {"id": name, "vehicles": [vehicle], **({"remote_id": remote_id} if remote_id else {})}

    receiver = {"id": "street", "operator": "green", "place": [0, 20, 4], "verify": "drip"}
    return {
        "name": "drip",
        "seed": 5,
        "duration_s": duration_s,
        "origin": [40.778, -73.955, 20],
        "radio": {"receivers": [receiver]},
        "operators": [
            operator("green", 0, SIGNS),
            operator("red", 40, {**SIGNS, "transports": ["bt4"], "auth_repeats": 3}),
            operator("blue", 80, {}),
        ],
    } | more


def flown(folder: Path, **more: Any) -> RunRecord:
    """The record of that scenario."""
    return fly(load_data(table(**more)), folder, report=False)


def broadcasts(record: RunRecord) -> Iterator[tuple[str, RidFrame]]:
    """Sender and content of every frame that an aircraft gave to its radio."""
    for frame in record.frames_with_payloads():
        if frame.link.startswith(RADIO_LINK) and frame.direction == "fwd":
            yield frame.link.removeprefix(RADIO_LINK), unpack(frame.payload)
