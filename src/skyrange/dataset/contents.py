"""Contents of a data set: its runs and their rows, how each run is flown again, and the checksums of its files."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from skyrange.core.files import atomic_write, open_input
from skyrange.dataset.members import Member
from skyrange.dataset.progress import BUILDING
from skyrange.dataset.views import ViewSettings
from skyrange.record.folder import GIVEN_FILES
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
        counts: dict[str, int] = {}
        for record in self.records:
            for row in (*(record.manifest.get("attacks") or ()), *(record.manifest.get("faults") or ())):
                if not (row.get("muted") or row.get("sham") or row.get("honest")):
                    counts[str(row["kind"])] = counts.get(str(row["kind"]), 0) + 1
        return dict(sorted(counts.items()))


REGENERATE: Final = "regenerate.json"


def write_regenerate(folder: Path, contents: Contents) -> None:
    """Write `regenerate.json`: the text of each scenario once, and the runs that refer to it by its SHA-256."""
    scenarios: dict[str, str] = {}
    runs: dict[str, Any] = {}
    for member, record in zip(contents.members, contents.records, strict=True):
        manifest = record.manifest
        digest = hashlib.sha256(member.scenario.encode()).hexdigest()
        scenarios[digest] = member.scenario
        inputs = {
            name: entry
            for name, entry in (manifest.get("files") or {}).items()
            if name.startswith(("missions/given/", f"{GIVEN_FILES}/", "plugins/", "city.", "radio/"))
        }
        runs[member.run] = {
            "block": member.block, "arm": member.arm, "split": member.split, "seed": member.seed,
            "factors": dict(member.factors), "scenario": digest, "versions": manifest.get("versions", {}),
            "numeric": (manifest.get("platform") or {}).get("numeric", ""), "engines": manifest.get("engines", {}),
            "fingerprint": (manifest.get("digests") or {}).get("fingerprint", ""), "input_files": inputs,
        }  # fmt: skip
    value = {
        "format": "skyrange.dataset/1",
        "how": "Write a scenario's text to scenario.toml and fly it with `skyrange run scenario.toml` in the same "
        "versions. The scenario has the arm's attacks muted or sham already, and the seed. The run's fingerprint is "
        "that given here on a platform with the same `numeric`.",
        "views": {
            "places": [{"links": place.links, "side": place.side} for place in contents.settings.places],
            "rate_hz": contents.settings.rate_hz,
        },
        "scenarios": scenarios,
        "runs": runs,
    }
    with atomic_write(folder / REGENERATE) as file:
        file.write((json.dumps(value, indent=1, ensure_ascii=False, sort_keys=True) + "\n").encode())


CHECKSUMS: Final = "SHA256SUMS"


def sha256_of(path: Path) -> str:
    """The SHA-256 of a file in hexadecimal digits."""
    with open_input(path, str(path.parent), path.name) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def dataset_files(folder: Path) -> Iterator[Path]:
    """The files of a data set in order of their names, without the checksums."""
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.name != CHECKSUMS and BUILDING not in path.relative_to(folder).parts:
            yield path


def write_checksums(folder: Path) -> None:
    """Write the checksums of all files; `sha256sum --check SHA256SUMS` compares them."""
    lines = [f"{sha256_of(path)}  {path.relative_to(folder).as_posix()}\n" for path in dataset_files(folder)]
    with atomic_write(folder / CHECKSUMS) as file:
        file.write("".join(lines).encode())
