"""Folder of a pair: the manifest, the runs and the tables that `pairing.pair` left, opened for reading."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import pyarrow as pa
import pyarrow.parquet as pq

from skyrange.core.errors import InputError
from skyrange.record import RunRecord, load
from skyrange.study.effects import CHANGES, MEASURES
from skyrange.study.spread import Interval, interval

FORMAT: Final = "skyrange.pair/1"
MANIFEST: Final = "pair.json"
ARMS: Final = ("nominal", "attacked", "sham")


@dataclass(frozen=True)
class Pair:
    """The folder of a pair, opened. `manifest` is its `pair.json`."""

    path: Path
    manifest: Mapping[str, Any]

    @property
    def seeds(self) -> list[int]:
        """Of each repetition, in order."""
        return list(self.manifest["seeds"])

    @property
    def arms(self) -> list[str]:
        """Which were flown: nominal, attacked, perhaps sham."""
        return list(self.manifest["arms"])

    @property
    def reference(self) -> str:
        """The arm that effects are against first: sham where there is one, else nominal."""
        return "sham" if "sham" in self.arms else "nominal"

    def run(self, arm: str, seed: int | None = None) -> RunRecord:
        """The record of one arm of one seed, the first by default. `InputError` for one that was not flown."""
        seed = self.seeds[0] if seed is None else seed
        if arm not in self.arms or seed not in self.seeds:
            expected = f"one of {', '.join(self.arms)} with a seed of {', '.join(map(str, self.seeds))}"
            raise InputError.one(str(self.path), "run", f"{arm}, seed {seed}", expected)
        return load(self.path / folder_of(arm, seed, self.seeds))

    @property
    def effects(self) -> pa.Table:
        """`effects.parquet`."""
        return pq.read_table(self.path / "effects.parquet")

    @property
    def labels(self) -> pa.Table:
        """`labels.parquet`."""
        return pq.read_table(self.path / "labels.parquet")

    def intervals(self, against: str | None = None) -> dict[str, dict[str, Interval]]:
        """By aircraft and measure, the mean effect over the seeds and its 95 % interval (`study.spread`)."""
        return intervals(self.effects.to_pylist(), against or self.reference)

    @property
    def report(self) -> Path:
        """The comparison page."""
        return self.path / "report.html"


def load_pair(path: Path | str) -> Pair:
    """Open a pair's folder. `InputError` where it is none."""
    folder = Path(path).expanduser()
    try:
        manifest = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError.one(str(folder), MANIFEST, str(error), "the folder of a pair") from None
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise InputError.one(str(folder), MANIFEST, "another format", FORMAT)
    return Pair(folder, manifest)


def folder_of(arm: str, seed: int, seeds: Sequence[int]) -> str:
    """Where a run lies in its pair's folder."""
    return arm if len(seeds) == 1 else f"seed-{seed}/{arm}"


def intervals(rows: Sequence[Mapping[str, Any]], against: str) -> dict[str, dict[str, Interval]]:
    """By aircraft and measure, the mean over seeds of `effects` rows against one twin."""
    samples: dict[str, dict[str, list[float]]] = {}
    for row in rows:
        if row["against"] != against:
            continue
        own = samples.setdefault(row["vehicle"], {})
        for name in MEASURES:
            if row[name] is not None:
                own.setdefault(name, []).append(row[name])
        for name in CHANGES:
            stem, _, unit = name.rpartition("_")
            twin = row[f"{stem}_twin_{unit}" if unit == "m" else f"{name}_twin"]
            if row[name] is not None and twin is not None:
                own.setdefault(name, []).append(row[name] - twin)
    return {
        vehicle: {name: found for name, values in own.items() if (found := interval(values)) is not None}
        for vehicle, own in samples.items()
    }
