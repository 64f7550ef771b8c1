"""Small studies for tests of scoring: rows with defaults, and tables of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import pyarrow as pa

from skyrange.scoring.tables import ALERTS, ATTACKS, FLIGHTS, INTRUSIONS, StudyTables, check_tables


def flight(run: str, vehicle: str = "a", *, arm: str = "nominal", **other: Any) -> dict[str, Any]:
    """A flight of an hour in the test part; its arm says whether an attack or a fault acts. Its block is a cluster."""
    return {
        "run": run, "block": run, "cluster": other.get("block", run), "flight": "", "arm": arm, "split": "test",
        "city": "plain", "aircraft": 1, "vehicle": vehicle, "duration_s": 3600.0, "own_from_s": 0.0, "shared_s": 0.0,
        "hostile": arm == "attacked", "fault": arm == "fault",
    } | other  # fmt: skip


def attack(run: str, vehicle: str = "a", **other: Any) -> dict[str, Any]:
    """A drift that acts from 1000 to 1060 s and can be observed from 1010 s; its effect ends when it stops."""
    row = {
        "run": run, "vehicle": vehicle, "attack_id": "x", "kind": "gnss.drift", "family": "gnss",
        "active_s": 1000.0, "stop_s": 1060.0, "observable_s": 1010.0, "effect_s": math.nan,
    } | other  # fmt: skip
    return {"effect_end_s": row["stop_s"]} | row


def alert(run: str, time_s: float, subject: str = "a", *, score: float = 1.0, detector: str = "d") -> dict[str, Any]:
    """An alert of detector `d`."""
    return {"run": run, "detector": detector, "time_s": time_s, "subject": subject, "kind": "k", "score": score}


def intrusion(run: str, vehicle: str = "a", **other: Any) -> dict[str, Any]:
    """A harmless intrusion from 1000 to 1060 s."""
    return {
        "run": run, "vehicle": vehicle, "attack_id": "x", "kind": "mavlink.mode", "active_s": 1000.0, "stop_s": 1060.0,
    } | other  # fmt: skip


def tables(
    flights: Sequence[dict[str, Any]],
    attacks: Sequence[dict[str, Any]] = (),
    alerts: Sequence[dict[str, Any]] = (),
    intrusions: Sequence[dict[str, Any]] = (),
) -> StudyTables:
    """The checked tables of some rows."""
    return check_tables(
        pa.Table.from_pylist(list(flights), schema=FLIGHTS),
        pa.Table.from_pylist(list(attacks), schema=ATTACKS),
        pa.Table.from_pylist(list(alerts), schema=ALERTS),
        pa.Table.from_pylist(list(intrusions), schema=INTRUSIONS),
    )
