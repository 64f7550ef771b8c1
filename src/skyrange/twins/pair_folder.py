"""Folder of a pair: reader of the manifest, runs and tables that `pairing.pair` writes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Final, NotRequired, get_args

import pyarrow as pa
from pydantic import ConfigDict, with_config
from typing_extensions import TypedDict

from skyrange.core.errors import InputError
from skyrange.core.files import expand_user
from skyrange.core.parquet_files import check_ranges, read_table
from skyrange.core.typed_json import Finite, Int64, read_formatted, require_type
from skyrange.record import RunRecord, load
from skyrange.record.manifest import fleet_of
from skyrange.statistics.means import Interval, estimate_mean
from skyrange.twins.arms import ATTACKED, NOMINAL, SHAM
from skyrange.twins.attribution import Relation, attribution_table
from skyrange.twins.effects import CHANGES, MEASURES, NAMES, effects_table
from skyrange.twins.failed_missions import FailedMissions, find_failed_missions
from skyrange.twins.lie_and_truth import lie_and_truth_table
from skyrange.twins.propagation import PHASES, propagation_table

FORMAT: Final = "skyrange.pair/4"
"""The format of a pair's folder, and the only one that is read."""

MANIFEST: Final = "pair.json"
EFFECTS: Final = "effects.parquet"
PROPAGATION: Final = "propagation.parquet"
ATTRIBUTION: Final = "attribution.parquet"
LIE_AND_TRUTH: Final = "honest.parquet"


class _Run(TypedDict):
    """A run of a pair in the manifest."""

    arm: str
    seed: Int64
    folder: str
    error: str | None


@with_config(ConfigDict(extra="allow"))
class _Manifest(TypedDict):
    """Contents of `pair.json`."""

    format: str
    name: str
    arms: list[str]
    active: dict[str, list[str]]
    attacks: dict[str, str]
    faults: list[str]
    baseline: str | None
    seeds: list[Int64]
    near_m: Finite
    threshold_m: Finite
    status: NotRequired[str]
    runs: NotRequired[list[_Run]]


@dataclass(frozen=True)
class Pair:
    """An opened pair folder. `manifest` is its `pair.json`."""

    path: Path
    manifest: Mapping[str, Any]

    @property
    def seeds(self) -> list[int]:
        """The seed of each repetition, in order."""
        return list(self.manifest["seeds"])

    @property
    def arms(self) -> list[str]:
        """The arms that were run: nominal, attacked, and those for attribution such as sham or only-ghost."""
        return list(self.manifest["arms"])

    @property
    def twins(self) -> list[str]:
        """The arms without an attack or fault, with which effects are compared: nominal and, if it was run, sham."""
        return [arm for arm in self.arms if arm in (NOMINAL, SHAM)]

    @property
    def twin(self) -> str:
        """The arm that the attacked run is drawn beside: nominal, or the sham where that alone was run."""
        return self.twins[0]

    @property
    def faults(self) -> list[str]:
        """The ids of the benign faults that act in the attacked run; the other authors are attacks."""
        return list(self.manifest["faults"])

    @property
    def baseline(self) -> str | None:
        """The arm against which effects are attributed; `None` if it was not run."""
        baseline: str | None = self.manifest["baseline"]
        return baseline

    @property
    def reference(self) -> str:
        """The arm with which effects are compared by default: sham if it was run, else nominal."""
        return SHAM if SHAM in self.arms else NOMINAL

    def run(self, arm: str, seed: int | None = None) -> RunRecord:
        """The record of one arm and seed (default: the first); raises `InputError` if that was not run."""
        seed = self.seeds[0] if seed is None else seed
        if arm not in self.arms or seed not in self.seeds:
            expected = f"one of {', '.join(self.arms)} with a seed of {', '.join(map(str, self.seeds))}"
            raise InputError.one(str(self.path), "run", f"{arm}, seed {seed}", expected)
        record = load(self.path / folder_of(arm, seed, self.seeds))
        fleet = fleet_of(record.manifest, str(record.path))
        if arm != ATTACKED and fleet != self._fleet:
            expected = f"the vehicles of the {ATTACKED} run, {', '.join(self._fleet[:20])}"
            hint = "The file was changed by hand or is damaged."
            value = ", ".join(fleet[:20]) or "none"
            raise InputError.one(str(record.path), "manifest.json: vehicles", value, expected, hint)
        return record

    @property
    def effects(self) -> pa.Table:
        """The table of `effects.parquet`. As those below, it raises `InputError` for a damaged file."""
        return self._read(EFFECTS, effects_table([]).schema, {"vehicle": self._fleet, "against": self.twins})

    @property
    def attribution(self) -> pa.Table:
        """The table of `attribution.parquet`: how each attack relates to each effect."""
        table = self._read(
            ATTRIBUTION,
            attribution_table([]).schema,
            {"vehicle": self._fleet, "outcome": NAMES, "relation": get_args(Relation)},
        )
        check_ranges(table, {"placebos": (0, 2**31 - 1), "level": (0.0, 1.0)}, str(self.path), ATTRIBUTION)
        return table

    @property
    def propagation(self) -> pa.Table:
        """The table of `propagation.parquet`: every hostile act and its consequences."""
        return self._read(PROPAGATION, propagation_table([]).schema, {"phase": PHASES})

    @property
    def lie_and_truth(self) -> pa.Table:
        """The table of `honest.parquet`: reactions to the claimed aircraft and to real ones. Empty without that arm."""
        empty = lie_and_truth_table([])
        if not (self.path / LIE_AND_TRUTH).exists():
            return empty
        return self._read(LIE_AND_TRUTH, empty.schema, {"vehicle": self._fleet})

    def _read(self, name: str, declared: pa.Schema, known: Mapping[str, Sequence[str]]) -> pa.Table:
        """A table; `known` are the values that some of its columns may have."""
        table = read_table(self.path / name, str(self.path), name, declared)
        for column, values in known.items():
            unknown = next((value for value in table.column(column).unique().to_pylist() if value not in values), None)
            if unknown is not None:
                hint = "The file was changed by hand or is damaged."
                expected = f"one of {', '.join(values[:20])}" + (" …" if len(values) > 20 else "")
                raise InputError.one(str(self.path), f"{name}: {column}", ascii(unknown)[:80], expected, hint)
        return table

    @cached_property
    def _fleet(self) -> list[str]:
        record = self.run(ATTACKED)
        return fleet_of(record.manifest, str(record.path))

    @cached_property
    def failed_missions(self) -> list[FailedMissions]:
        """Missions that failed in runs without an attack or fault that acts, on which all effects rest."""
        failures = (find_failed_missions(self.run(arm, seed), arm) for seed in self.seeds for arm in self.twins)
        return [failure for failure in failures if failure is not None]

    def intervals(self, against: str | None = None) -> dict[str, dict[str, Interval]]:
        """By aircraft and measure, the mean effect over the seeds with its 95 % confidence interval."""
        return intervals(self.effects.to_pylist(), against or self.reference)

    @property
    def report(self) -> Path:
        """The path of the comparison page."""
        return self.path / "report.html"


def load_pair(path: Path | str) -> Pair:
    """Open a pair's folder; raises `InputError` if it is not one, or is of another format."""
    folder = expand_user(path)
    who = str(folder)
    manifest = read_formatted(folder / MANIFEST, FORMAT, who, MANIFEST, remedy="fly the pair again.")
    require_type(manifest, _Manifest, who, MANIFEST)
    arms = manifest["arms"]
    if not manifest["seeds"] or ATTACKED not in arms or not {NOMINAL, SHAM} & {*arms}:
        value = f"arms {', '.join(arms) or 'none'}, {len(manifest['seeds'])} seeds"
        expected = f"{ATTACKED}, {NOMINAL} or {SHAM}, and at least one seed"
        raise InputError.one(who, MANIFEST, value, expected, "The file was changed by hand or is damaged.")
    return Pair(folder, manifest)


def folder_of(arm: str, seed: int, seeds: Sequence[int]) -> str:
    """The path of a run relative to its pair's folder."""
    return arm if len(seeds) == 1 else f"seed-{seed}/{arm}"


def intervals(rows: Sequence[Mapping[str, Any]], against: str) -> dict[str, dict[str, Interval]]:
    """By aircraft and measure, the mean over seeds with its interval, from `effects` rows against one twin."""
    samples: dict[str, dict[str, list[float]]] = {}
    for row in rows:
        if row["against"] != against:
            continue
        vehicle_samples = samples.setdefault(row["vehicle"], {})
        for name in MEASURES:
            if row[name] is not None:
                vehicle_samples.setdefault(name, []).append(row[name])
        for name in CHANGES:
            stem, _, unit = name.rpartition("_")
            twin = row[f"{stem}_twin_{unit}" if unit == "m" else f"{name}_twin"]
            if row[name] is not None and twin is not None:
                vehicle_samples.setdefault(name, []).append(row[name] - twin)
    return {
        vehicle: {
            name: interval
            for name, values in vehicle_samples.items()
            if (interval := estimate_mean(values)) is not None
        }
        for vehicle, vehicle_samples in samples.items()
    }
