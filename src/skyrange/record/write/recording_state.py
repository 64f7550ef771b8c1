"""State of a recorder beside its rows: numbering, digests, counts, outcomes, and the rates of truth and sensors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import gcd
from typing import Any, Final

from skyrange.core.errors import InputError, Problem
from skyrange.core.time import NEVER, Time, from_seconds, to_seconds
from skyrange.record.digests import Digests
from skyrange.record.schema import RECORDED, STUDY, SUMMARY
from skyrange.record.write.rows.frame_encoder import FrameEncoder
from skyrange.record.write.study import StudyRows


def check_rates(truth_hz: float, sensors_hz: float, features_hz: float) -> None:
    """Raise `InputError` for a rate outside 0 to 1000 Hz; features cannot be left out by a rate of 0."""
    rates = {"record.truth_hz": truth_hz, "record.sensors_hz": sensors_hz}
    expected = "a rate in Hz from 0 (not recorded) to 1000"
    problems = [Problem(where, repr(rate), expected) for where, rate in rates.items() if not 0 <= rate <= 1000]
    if not 0 < features_hz <= 1000:
        problems.append(Problem("record.features_hz", repr(features_hz), "a rate in Hz above 0, up to 1000"))
    if problems:
        raise InputError("recorder", problems)


def common_period_ns(truth_ns: Time, sensors_ns: Time) -> Time:
    """The longest period whose multiples include those of both; a period of `NEVER` (not recorded) is ignored."""
    wanted = [period for period in (truth_ns, sensors_ns) if period != NEVER]
    return gcd(*wanted) if wanted else NEVER


def period_ns(rate_hz: float) -> Time:
    """The period of a rate in Hz; `NEVER` for 0."""
    return min(from_seconds(min(1.0 / rate_hz, to_seconds(NEVER))), NEVER) if rate_hz else NEVER


SHARD_PAYLOADS: Final = 1 << 48
"""Numbers of payloads that each shard may use."""


def make_encoder(level: str, window_bytes: int, shard: int = 0) -> FrameEncoder:
    """The encoder of a shard of a run at a level of the record."""
    return FrameEncoder(window_bytes, shard * SHARD_PAYLOADS, with_groups=level == STUDY)


@dataclass(slots=True)
class RecordingState:
    """What a fork copies. Those of the shards of a run add up."""

    level: str
    encoder: FrameEncoder
    truth_ns: Time
    sensors_ns: Time
    truth_due: Time
    sensors_due: Time
    last_ns: Time = 0
    digests: Digests = field(default_factory=Digests)
    counts: dict[str, int] = field(default_factory=dict)
    not_kept: dict[str, int] = field(default_factory=dict)
    """Rows observed of tables that the level leaves out."""
    outcomes: dict[str, dict[str, Any]] = field(default_factory=dict)
    """As ground stations report them, by aircraft."""
    crashes: dict[str, Time] = field(default_factory=dict)
    """Times of the first crashes, by aircraft."""
    study_rows: StudyRows | None = None
    files: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Size and hash of the files that were attached, by name."""

    @classmethod
    def start(
        cls, header: Mapping[str, Any], level: str, *, truth_hz: float, sensors_hz: float, features_hz: float,
        window_bytes: int, shard: int = 0, encoder: FrameEncoder | None = None,
    ) -> RecordingState:  # fmt: skip
        """The state of a shard at the start; `window_bytes` is that of `FrameEncoder`, all else of `Recorder.open`.

        It has an encoder of its own unless it is given one that the runs of a batch share.
        """
        return cls(
            level,
            encoder or make_encoder(level, window_bytes, shard),
            truth_ns=period_ns(truth_hz),
            sensors_ns=period_ns(sensors_hz),
            truth_due=-NEVER if truth_hz else NEVER,
            sensors_due=-NEVER if sensors_hz and level != SUMMARY else NEVER,
            study_rows=StudyRows(header, period_ns(features_hz)) if level == STUDY else None,
        )

    def keeps(self, table: str) -> bool:
        """Whether the level keeps the rows of a table."""
        return table in RECORDED[self.level]

    def count(self, table: str, rows: int) -> None:
        """Count rows that were written."""
        self.counts[table] = self.counts.get(table, 0) + rows

    def leave_out(self, table: str, rows: int) -> None:
        """Count rows that were observed and that the level leaves out."""
        self.not_kept[table] = self.not_kept.get(table, 0) + rows

    def to_plain(self) -> dict[str, Any]:
        """What the first shard needs of another one that has ended, as plain data."""
        return {
            "last_ns": self.last_ns,
            "digests": self.digests.to_plain(),
            "counts": self.counts,
            "not_kept": self.not_kept,
            "outcomes": self.outcomes,
            "crashes": self.crashes,
            "files": self.files,
        }

    def add(self, shard: Mapping[str, Any]) -> None:
        """Add what `to_plain` of another shard returned."""
        self.last_ns = max(self.last_ns, int(shard["last_ns"]))
        self.digests = self.digests + Digests.from_plain(shard["digests"])
        for table, rows in shard["counts"].items():
            self.count(table, rows)
        for table, rows in shard["not_kept"].items():
            self.leave_out(table, rows)
        self.outcomes |= shard["outcomes"]
        self.crashes |= shard["crashes"]
        self.files |= shard["files"]
