"""Defences of a run: their acts and alarms, and the time until receivers trust a sender of Remote ID."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from typing import Any, Final

from skyrange.core.time import NS_PER_S, from_seconds
from skyrange.metrics.time_series import Record, read_notes
from skyrange.record.read.run import RunRecord
from skyrange.remoteid.broadcast_profiles import sender_address
from skyrange.vehicle.avoidance.contract import AvoidanceLimits


@dataclass(frozen=True, slots=True)
class DefenceActs:
    """What one defence did in one run."""

    id: str
    kind: str
    params: Mapping[str, Any]
    touches: Sequence[str]
    acts: Mapping[str, int]
    """Number of acts by action: drop, delay, replace, inject, sensor and so on."""
    alarms: int
    first_alarm_s: float | None


def read_defences(run: RunRecord) -> list[DefenceActs]:
    """Each defence that is not muted, as declared in the manifest."""
    declared = [row for row in run.manifest.get("defences") or () if not row.get("muted")]
    if not declared:
        return []
    acts: dict[str, Counter[str]] = {}
    for note in read_notes(run, "events"):
        if note.kind == "event.defence_act":
            acts.setdefault(note.about, Counter())[str(note.data["action"])] += 1
    raised: dict[str, list[int]] = {}
    for row in run.table("alerts", ["time_ns", "detector"]).to_pylist():
        raised.setdefault(row["detector"], []).append(row["time_ns"])
    return [
        DefenceActs(
            row["id"],
            row["kind"],
            row.get("params", {}),
            row.get("touches", []),
            acts.get(row["id"], Counter()),
            len(raised.get(row["id"], ())),
            min(raised[row["id"]]) / NS_PER_S if row["id"] in raised else None,
        )
        for row in declared
    ]


KIND: Final = "event.remote_id_trust"
VERIFIED: Final = "message verified"
LOOK_AHEAD_S: Final = AvoidanceLimits().look_ahead_s
"""How far the shipped kinds of avoidance look ahead by default."""
_SESSION_OF_DRIP: Final = "session:012001003"


@dataclass(frozen=True, slots=True)
class TrustPair:
    """What one receiver made of one sender."""

    receiver: str
    """An aircraft, or a receiver on the ground."""
    sender: str
    """The aircraft with this sender address; "" if no aircraft of the scenario has it."""
    address: str
    signs: bool
    """Whether that aircraft signs its Remote ID."""
    first_ns: int
    """First reception."""
    trusted_ns: int | None
    """First verified Location or System message."""
    state: str
    """The last verdict."""

    @property
    def time_to_trust_s(self) -> float | None:
        """From the first reception to the first verified message."""
        return None if self.trusted_ns is None else (self.trusted_ns - self.first_ns) / NS_PER_S


@dataclass(frozen=True, slots=True)
class TrustSummary:
    """Trust in a run: its pairs, and how many of the senders sign."""

    pairs: tuple[TrustPair, ...]
    aircraft: int
    adopters: int
    """Aircraft that sign."""

    @property
    def signed(self) -> tuple[TrustPair, ...]:
        """The pairs whose sender signs."""
        return tuple(pair for pair in self.pairs if pair.signs)

    def within(self, look_ahead_s: float = LOOK_AHEAD_S) -> int:
        """Pairs whose sender signs and was trusted no later than an avoidance looks ahead."""
        times = [pair.time_to_trust_s for pair in self.signed]
        return sum(time_s is not None and time_s <= look_ahead_s for time_s in times)

    def facts(self, look_ahead_s: float = LOOK_AHEAD_S) -> dict[str, Any]:
        """The summary as plain data."""
        times = [time_s for pair in self.signed if (time_s := pair.time_to_trust_s) is not None]
        return {
            "aircraft": self.aircraft,
            "adopters": self.adopters,
            "pairs": len(self.pairs),
            "signed": len(self.signed),
            "trusted": len(times),
            "median_s": round(median(times), 3) if times else None,
            "longest_s": round(max(times), 3) if times else None,
            "look_ahead_s": look_ahead_s,
            "within_look_ahead": self.within(look_ahead_s),
        }


def remote_id_trust(record: Record) -> TrustSummary:
    """Every pair of a receiver that verifies and a sender that it heard, in the order of first receptions.

    A receiver that noted more than 256 changes of verdicts, as in a flood, tells only some of the later ones.
    """
    vehicles = record.manifest.get("vehicles") or []
    signs = {str(row["id"]): str(row.get("uas_id", "")).startswith(_SESSION_OF_DRIP) for row in vehicles}
    names = {sender_address(name).hex(): name for name in signs}
    pairs: dict[tuple[str, str], TrustPair] = {}
    for note in read_notes(record, "events"):
        if note.kind == KIND:
            pair = _with(pairs, note.about, note.data, note.time_ns, names, signs)
            pairs[pair.receiver, pair.address] = pair
    ordered = sorted(pairs.values(), key=lambda pair: pair.first_ns)
    return TrustSummary(tuple(ordered), len(signs), sum(signs.values()))


def _with(
    pairs: Mapping[tuple[str, str], TrustPair],
    about: str,
    data: Mapping[str, Any],
    time_ns: int,
    names: Mapping[str, str],
    signs: Mapping[str, bool],
) -> TrustPair:
    receiver, address, state = str(data.get("receiver", about)), str(data.get("address")), str(data.get("state"))
    before = pairs.get((receiver, address))
    trusted_ns = before.trusted_ns if before is not None else None
    if trusted_ns is None and state == VERIFIED:
        trusted_ns = from_seconds(float(data["at_s"]))
    first_ns = before.first_ns if before is not None else from_seconds(float(data["first_s"]))
    sender = names.get(address, "")
    return TrustPair(receiver, sender, address, signs.get(sender, False), first_ns, trusted_ns, state)
