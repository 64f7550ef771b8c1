"""Failed missions: those that an autopilot rejected, and those of arms in which no attack or fault acts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from skyrange.core.errors import ShortfallError
from skyrange.gcs.protocols.mission_transfer import LIST_NAMES
from skyrange.metrics.safety import first_mishaps
from skyrange.metrics.time_series import read_notes
from skyrange.record import RunRecord
from skyrange.record.manifest import require_entry

REJECTIONS: Final = (
    *(f"{name} {failure}" for name in LIST_NAMES.values() for failure in ("upload refused", "read-back differs")),
    "mode AUTO: ", "mission start: ",
)  # fmt: skip
"""How the ground station's reason begins where an autopilot rejected the mission (`gcs.flight`)."""
FAILURE: Final = "failure"
"""What the manifest says of an aircraft whose plan has `failure_expected`."""
_NAMED: Final = 5
"""Missions that a message names."""


@dataclass(frozen=True, slots=True)
class FailedMissions:
    """The missions that failed in a run although its scenario does not expect it."""

    arm: str
    seed: int
    reasons: Mapping[str, str]
    """By aircraft: its first collision or crash, or the reason that the ground station gives."""
    missions: int
    """Of all aircraft of the run."""

    def __str__(self) -> str:
        named = [f"{vehicle}: {reason}" for vehicle, reason in self.reasons.items()]
        count = f"{len(named)} of {self.missions} mission{'s' * (self.missions > 1)} failed"
        return f"{self.arm}, seed {self.seed}: {count}: {_join(named)}"


def rejected_missions(record: RunRecord) -> dict[str, str]:
    """Vehicles whose autopilot rejected the mission, or refused to fly it, with the reason that was recorded."""
    reasons = {vehicle: str(outcome.get("reason") or "") for vehicle, outcome in record.outcomes.items()}
    return {vehicle: reason for vehicle, reason in reasons.items() if reason.startswith(REJECTIONS)}


def require_missions(record: RunRecord) -> None:
    """Raise `ShortfallError` if a mission was rejected for which the run's scenario does not expect it."""
    expecting = _expectations(record)
    rejections = [f"{name}: {reason}" for name, reason in rejected_missions(record).items() if not expecting.get(name)]
    if rejections:
        raise ShortfallError(f"missions were rejected: {_join(rejections)}", record.path)


def find_failed_missions(record: RunRecord, arm: str) -> FailedMissions | None:
    """The missions that failed in a run; `None` if none did, or if its scenario expects each of them to fail."""
    expecting, rejected = _expectations(record), rejected_missions(record)
    mishaps = first_mishaps(read_notes(record, "events"))
    outcomes = record.outcomes
    fleet = [str(row["id"]) for row in record.manifest.get("vehicles") or ()]
    reasons = {
        name: mishaps.get(name) or str(outcomes[name].get("reason") or "no reason was recorded")
        for name in fleet
        if (name in mishaps or outcomes.get(name, {}).get("state") == "failed")
        and expecting.get(name) != FAILURE
        and not (name in expecting and name in rejected)
    }
    if not reasons:
        return None
    return FailedMissions(arm, require_entry(record.manifest, "seed", str(record.path)), reasons, len(fleet))


def require_baseline(failures: Iterable[str], folder: Path) -> None:
    """Raise `ShortfallError` if missions failed in arms in which nothing acts: effects are differences from these."""
    lines = list(failures)
    if lines:
        hint = "an aircraft that is meant to fail says so with plan.failure_expected"
        raise ShortfallError(f"missions failed without an attack: {_join(lines)} ({hint})", folder)


def _join(lines: Sequence[str]) -> str:
    """The first lines in one, and how many more there are."""
    more = f"; and {len(lines) - _NAMED} more" if len(lines) > _NAMED else ""
    return f"{'; '.join(lines[:_NAMED])}{more}"


def _expectations(record: RunRecord) -> dict[str, str]:
    """By aircraft, what its plan expects (`Plan.failure_expected`, `Plan.rejection_expected`), if it does."""
    vehicles = record.manifest.get("vehicles") or ()
    return {str(row["id"]): str(row["expected"]) for row in vehicles if row.get("expected")}
