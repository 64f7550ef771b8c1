"""Export of a run as an MCAP file, which Foxglove and Lichtblick open.

Messages are JSON with Foxglove's schemas and our own, in zstd chunks, in order of time. Times are the scenario's
`start_utc` plus simulated time. Memory is bounded but for the buildings and the beliefs. Format: https://mcap.dev/spec.
"""

from __future__ import annotations

import heapq
import json
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from skyrange.core.errors import InputError
from skyrange.core.extras import missing_module
from skyrange.core.files import MAX_RECORD_BYTES, atomic_write, read_input
from skyrange.export import Export, require_origin
from skyrange.export.foxglove_messages import TOPICS, TimedMessage, building_messages, log_messages, pose_messages
from skyrange.export.foxglove_schemas import SCHEMAS
from skyrange.export.knowledge_messages import act_messages, belief_messages, claim_messages, reception_messages
from skyrange.export.scan_messages import scan_messages
from skyrange.figures.subject import fleet_colours
from skyrange.metrics.time_series import start_utc_ns
from skyrange.record.manifest import MANIFEST
from skyrange.record.read.run import RunRecord

MCAP: Final = "run.mcap"
METADATA: Final = "skyrange.run"
"""Name of the metadata record, which names the run."""
CHUNK_BYTES: Final = 4 << 20
"""Size of a chunk before compression. The index, which stays in memory, has an entry for each chunk and topic, and each
aircraft has a topic: with the library's 1 MiB, a file of 5,000 aircraft is a tenth larger."""
_ATTACHED: Final = {MANIFEST: "application/json", "scenario.toml": "application/toml"}


def write_mcap(record: RunRecord, path: Path | None = None) -> Export:
    """Write the poses of all aircraft, buildings and aircraft as a scene, events, decisions, labels and alerts as logs,
    a position for each aircraft, where its autopilot believed and its ground station heard it to be, the claims and
    receptions of Remote ID, the acts of attacks and faults, and the scans of sensors, to `path` (default: `run.mcap` in
    the run's folder).

    `items` and `by` of the result count messages, in all and by topic. The manifest and the scenario are attached.
    Raises `InputError` if the package mcap is not installed, if the run has no truth because of its level, and if its
    manifest has no origin or start; `OSError` if the file cannot be written. No incomplete file is left behind.
    """
    library = _load_mcap_writer()
    record.tables.require("truth")
    start_ns = start_utc_ns(record)
    messages = _messages(record, start_ns)
    counts: Counter[str] = Counter()
    target = path or record.path / MCAP
    with atomic_write(target) as file:
        writer = library.Writer(file, CHUNK_BYTES, library.CompressionType.ZSTD)
        writer.start(profile="", library="skyrange")
        for name, media_type in _ATTACHED.items():
            if (record.path / name).exists():
                data = read_input(record.path / name, str(record.path), name, max_bytes=MAX_RECORD_BYTES)
                writer.add_attachment(start_ns, start_ns, name, media_type, data)
        writer.add_metadata(METADATA, _describe_run(record))
        channels = _Channels(writer)
        for message in messages:
            at_ns = start_ns + message.time_ns
            if not 0 <= at_ns < 2**64:
                value = f"{message.time_ns} ns"
                raise InputError.one(str(record.path), message.topic, value, "a time that MCAP can hold, from 1970 on")
            channel = channels.number(message)
            writer.add_message(channel, at_ns, message.json.encode(), at_ns, counts[message.topic] & 0xFFFF_FFFF)
            counts[message.topic] += 1
        writer.finish()
    return Export(target, counts.total(), dict(sorted(counts.items())))


def _messages(record: RunRecord, start_ns: int) -> Iterator[TimedMessage]:
    origin, colours = require_origin(record), fleet_colours(record)
    streams = [
        building_messages(record.city, start_ns, str(record.path)),
        pose_messages(record, origin, start_ns, colours),
        belief_messages(record, origin, start_ns, colours),
        claim_messages(record, start_ns, colours),
        reception_messages(record, start_ns),
        act_messages(record, start_ns),
        scan_messages(record, start_ns),
        *(log_messages(record, table, start_ns) for table in TOPICS),
    ]
    return heapq.merge(*streams, key=lambda message: message.time_ns)


class _Channels:
    """The channels of a file, registered at the first message of their topic, and the schemas of these."""

    def __init__(self, writer: Any) -> None:
        self._writer = writer
        self._schemas: dict[str, int] = {}
        self._numbers: dict[str, int] = {}

    def number(self, message: TimedMessage) -> int:
        """The number of the channel of a message."""
        number = self._numbers.get(message.topic)
        if number is None:
            if message.schema not in self._schemas:
                text = json.dumps(SCHEMAS[message.schema]).encode()
                self._schemas[message.schema] = self._writer.register_schema(message.schema, "jsonschema", text)
            number = self._writer.register_channel(message.topic, "json", self._schemas[message.schema])
            self._numbers[message.topic] = number
        return number


def _describe_run(record: RunRecord) -> dict[str, str]:
    digests = record.manifest.get("digests") or {}
    facts = {name: record.manifest.get(name) for name in ("name", "seed", "start_utc", "skyrange")}
    facts |= {"status": record.status, "fingerprint": digests.get("fingerprint")}
    # JSON may hold half of a surrogate pair, which UTF-8 does not
    return {name: str(value).encode(errors="replace").decode() for name, value in facts.items() if value is not None}


def _load_mcap_writer() -> Any:
    try:
        import mcap.writer
    except ImportError as error:
        raise missing_module("mcap", "export", "export") from error
    return mcap.writer
