"""Contents of a data set that is being described: its runs, their rows and how they were viewed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from skyrange.dataset.members import Member
from skyrange.dataset.run_views import ViewSettings
from skyrange.record.read.run import RunRecord

RUNS: Final = "runs.parquet"
"""The file with a row for each run."""


@dataclass(frozen=True, slots=True)
class Contents:
    """What the descriptions of a data set are made of."""

    name: str
    description: str
    license_url: str
    creator: str
    url: str
    """Where it is published; "" for nowhere yet."""
    published: str
    """YYYY-MM-DD."""
    members: Sequence[Member]
    records: Sequence[RunRecord]
    """One for each member."""
    rows: Mapping[str, Mapping[str, int]]
    """By run and view, the number of rows."""
    settings: ViewSettings

    @property
    def versions(self) -> list[str]:
        """The versions of skyrange that flew the runs, in order."""
        return sorted({str(record.manifest.get("skyrange", "unknown")) for record in self.records})

    @property
    def splits(self) -> list[str]:
        """The names of all splits, in order."""
        return sorted({member.split for member in self.members})

    def rows_of(self, view: str, split: str | None = None) -> int:
        """Number of rows of a view, or of a split of it."""
        return sum(self.rows[member.run].get(view, 0) for member in self.members if split in (None, member.split))

    @property
    def kinds(self) -> dict[str, int]:
        """The attack and fault kinds that are declared, each with its number of runs in which it is neither muted nor
        sham.
        """
        found: dict[str, int] = {}
        for record in self.records:
            for row in (*(record.manifest.get("attacks") or ()), *(record.manifest.get("faults") or ())):
                if not (row.get("muted") or row.get("sham") or row.get("honest")):
                    found[str(row["kind"])] = found.get(str(row["kind"]), 0) + 1
        return dict(sorted(found.items()))
