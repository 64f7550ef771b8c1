"""Comparison of viewer's streams: what was told of positions and events, however it was cut into messages."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from skyrange.view.stream.events import TEXTS, EventTables
from skyrange.view.stream.messages import Message
from skyrange.view.stream.positions import Floats, Layer, Samples


def positions_of(messages: Iterable[Message]) -> dict[tuple[Layer, int, int], tuple[Floats, float]]:
    """By layer, aircraft and time in ms: the place that was told last, and its age."""
    found = {}
    for samples in (Samples.decode(message) for message in messages if message.kind == "P"):
        for row, place in enumerate(samples.rows):
            for k, time_ns in enumerate(samples.grid.times.tolist()):
                if np.isfinite(samples.enu_m[row, :, k]).all():
                    age_s = 0.0 if samples.age_s is None else float(samples.age_s[row, k])
                    found[samples.layer, place, time_ns // 1_000_000] = (samples.enu_m[row, :, k], age_s)
    return found


def events_of(messages: Iterable[Message]) -> EventTables:
    """All rows in one order, with acts merged as those of one message are."""
    found = EventTables()
    for message in messages:
        if message.kind == "E":
            for table, rows in EventTables.decode(message).rows.items():
                found.rows[table] += rows
    merged: list[dict[str, Any]] = []
    newest: dict[tuple[str, ...], dict[str, Any]] = {}
    for row in sorted(found.rows["acts"], key=lambda row: row["t"]):
        key = tuple(row[column] for column in TEXTS["acts"])
        before = newest.get(key)
        if before is not None and row["t"] - before["until"] <= 0.2:
            before["n"], before["until"] = before["n"] + row["n"], row["until"]
        else:
            newest[key] = row
            merged.append(row)
    found.rows["acts"] = merged
    for rows in found.rows.values():
        rows.sort(key=repr)
        rows.sort(key=lambda row: row["t"])
    return found


def require_same_flight(live: list[Message], recorded: list[Message]) -> None:
    """The live stream told all that the recorded one has: places within a centimetre, and all events."""
    seen, expected = positions_of(live), positions_of(recorded)
    end_ms = max(time_ms for _, _, time_ms in seen)
    for sample, (place, age_s) in expected.items():
        if sample[2] <= end_ms:
            assert np.abs(seen[sample][0] - place).max() <= 0.01, sample
            assert abs(seen[sample][1] - age_s) < 0.11, sample
    got, wanted = events_of(live), events_of(recorded)
    for table, rows in wanted.rows.items():
        assert got.rows[table] == rows, table
