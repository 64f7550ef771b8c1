"""Measurement of the runs of a block: rows of the tables of a study's results."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any, Final

import numpy as np

from skyrange.core.time import NS_PER_S, to_seconds
from skyrange.dataset.families import find_family
from skyrange.dataset.labels import ATTACK, FAULT, INTRUSION, SHAM, read_acts
from skyrange.dataset.members import name_city
from skyrange.metrics.aircraft import DEPARTED_M
from skyrange.metrics.effect_ends import read_effect_ends_ns
from skyrange.metrics.exact_difference import identify_flight
from skyrange.metrics.safety import NEAR_M
from skyrange.record import RunRecord
from skyrange.record.manifest import fleet_of, require_entry
from skyrange.study.columns import column_of
from skyrange.study.design.blocks import Block, city_of
from skyrange.study.design.model import Study, StudyArm
from skyrange.study.run_measures import measure_run
from skyrange.twins.effects import ArmOutcomes, effect_rows
from skyrange.twins.failed_missions import find_failed_missions

Rows = dict[str, list[dict[str, Any]]]
"""Rows by table."""

RUNS: Final = "runs"
AIRCRAFT: Final = "aircraft"
EFFECTS: Final = "effects"
ALERTS: Final = "alerts"
ACTS: Final = "acts"
TABLES: Final = (RUNS, AIRCRAFT, EFFECTS, ALERTS, ACTS)
"""Tables of results: a row for each run, for each aircraft of a run, for each aircraft of a run compared with that of
the baseline, for each alert, and for each attack, fault or harmless intrusion in a run.
"""

WITHOUT: Final = ("seed", "against", "attacks", "faults", "attribution")
"""Columns of effects that are those of the block, or that only a pair has."""


def measure_block(study: Study, block: Block, records: Mapping[str, RunRecord], errors: Mapping[str, str]) -> Rows:
    """Measure the runs of a block, `records` by arm; `errors` says why other arms have none.

    The rows depend on the runs alone: they have no times of the wall clock.
    """
    rows: Rows = {table: [] for table in TABLES}
    outcomes: dict[str, ArmOutcomes] = {}
    for arm in study.arms:
        head = _head(block, arm.id)
        record = records.get(arm.id)
        if record is None:
            rows[RUNS].append({**head, "status": "failed", "error": errors.get(arm.id, "not flown")})
            continue
        outcomes[arm.id] = ArmOutcomes.read(record, NEAR_M)
        measures = {
            column_of(name): value for name, value in measure_run(record, outcomes[arm.id].measured).values.items()
        }
        manifest = record.manifest
        rows[RUNS].append(
            {
                **head,
                "status": str(manifest["status"]),
                "error": "",
                "failed_missions": _describe_failed(arm, record),
                "simulated_s": float(require_entry(manifest, "simulated_s", str(record.path))),
                "vehicles": len(fleet_of(manifest, str(record.path))),
                "city": city_of(study, block) or name_city(manifest),
                "families": " ".join(_declared_families(record)),
                "fingerprint": str((manifest.get("digests") or {}).get("fingerprint", "")),
                "flight": identify_flight(manifest),
                **measures,
            }
        )
        aloft_s = _airborne_s(outcomes[arm.id])
        rows[AIRCRAFT] += [
            {**head, **asdict(aircraft), "airborne_s": seconds, "takeoff_s": first}
            for aircraft, (seconds, first) in zip(outcomes[arm.id].measured, aloft_s, strict=True)
        ]
        rows[ALERTS] += [{**head, **alert} for alert in _alerts(record)]
        rows[ACTS] += [{**head, **act} for act in measure_acts(record)]
    baseline = outcomes.get(study.against)
    for arm_id, measured in outcomes.items():
        if baseline is None or arm_id == study.against:
            continue
        for row in effect_rows(block.seed, study.against, measured, baseline, DEPARTED_M):
            kept = {name: value for name, value in row.items() if name not in WITHOUT}
            rows[EFFECTS].append({**_head(block, arm_id), "against": study.against, **kept})
    return rows


def _describe_failed(arm: StudyArm, record: RunRecord) -> str:
    """The missions that failed in an arm in which no attack or fault acts; "" for none, and in other arms."""
    acts = arm.attacks == "active" or arm.faults == "active"
    if acts and (record.manifest.get("attacks") or record.manifest.get("faults")):
        return ""
    return str(find_failed_missions(record, arm.id) or "")


def _head(block: Block, arm: str) -> dict[str, Any]:
    return {"block": block.name, "point": block.point, "seed": block.seed, "arm": arm, **block.values}


def _airborne_s(outcomes: ArmOutcomes) -> list[tuple[float, float | None]]:
    """How long each aircraft was in the air, at the rate of the recorded truth, and since when: `None` for never."""
    ticks = outcomes.ticks
    seconds = np.diff(ticks.time_ns, prepend=ticks.time_ns[:1]) / NS_PER_S
    times: list[tuple[float, float | None]] = []
    for aloft in ticks.aloft.T:
        flying = np.flatnonzero(aloft)
        first = float(ticks.time_ns[flying[0]]) / NS_PER_S if flying.size else None
        times.append((round(float((seconds * aloft).sum()), 9), first))
    return times


def _alerts(record: RunRecord) -> Iterator[dict[str, Any]]:
    columns = ["time_ns", "detector", "kind", "subject", "score"]
    for batch in record.batches("alerts", columns):
        for row in batch.to_pylist():
            yield {"time_s": to_seconds(row.pop("time_ns")), **row}


def measure_acts(record: RunRecord) -> list[dict[str, Any]]:
    """When each attack, fault and harmless intrusion acted on each aircraft first and last, and when the effect ended
    (with the last act, but for attacks); an empty aircraft stands for none in particular.
    """
    run_acts = read_acts(record, _family_or_kind)
    fleet = {*fleet_of(record.manifest, str(record.path))}
    spans: dict[tuple[str, str, str], list[int]] = {}
    for act in run_acts.acts:
        if act.role == SHAM:
            continue
        key = act.author, act.owner if act.owner in fleet else "", act.role
        span = spans.setdefault(key, [act.at_ns, act.until_ns, 0])
        span[0], span[1], span[2] = min(span[0], act.at_ns), max(span[1], act.until_ns), span[2] + 1
    ends_ns = read_effect_ends_ns(
        record, {(author, vehicle): last for (author, vehicle, role), (_, last, _) in spans.items() if role == ATTACK}
    )
    return [
        {
            "attack": author,
            "kind": run_acts.kinds.get(author, ""),
            "family": run_acts.families.get(author) or "",
            "vehicle": vehicle,
            "fault": role == FAULT,
            "harmless_intrusion": role == INTRUSION,
            "first_s": to_seconds(first),
            "last_s": to_seconds(last),
            "effect_end_s": to_seconds(ends_ns[author, vehicle] if role == ATTACK else last),
            "acts": count,
        }
        for (author, vehicle, role), (first, last, count) in sorted(spans.items())
    ]


def _declared_families(record: RunRecord) -> list[str]:
    """The mechanism families of the attacks of a run, whether they acted or not."""
    return sorted({_family_or_kind(row) for row in record.manifest.get("attacks") or ()})


def _family_or_kind(attack: Mapping[str, Any]) -> str:
    """The family of an attack; a kind without one is a family by itself."""
    return find_family(attack) or str(attack["kind"])
