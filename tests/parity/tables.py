"""What do the pages say of two autopilots side by side? Tables in Markdown, made of a comparison."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from skyrange.parity.flights import FlightMeasures, Parity

SHOWN: Mapping[str, tuple[str, str]] = {
    "lift_off_s": ("lift-off after departure", "s"),
    "in_the_air_s": ("in the air", "s"),
    "disarmed_after_s": ("from 0.5 m to motors off", "s"),
    "height_max_m": ("greatest height", "m"),
    "climb_max_mps": ("fastest climb", "m/s"),
    "descent_max_mps": ("fastest descent", "m/s"),
    "speed_max_mps": ("greatest speed", "m/s"),
    "tilt_max_deg": ("greatest tilt", "°"),
    "yaw_rate_max_degps": ("fastest turn", "°/s"),
    "turned_deg": ("turned in all", "°"),
    "cross_track_max_m": ("cross-track error, greatest", "m"),
    "cross_track_rms_m": ("cross-track error, RMS", "m"),
}
"""Measures that a table of a wind has, in this order."""
SMALL: Mapping[str, float] = {"s": 0.05, "m": 0.02, "m/s": 0.02, "°": 1.0, "°/s": 1.0}
"""A relative difference of less than that says nothing."""


KINDS = ("builtin", "ArduPilot")


def measures(parity: Parity, depart_s: float, names: tuple[str, str] = KINDS) -> Iterator[str]:
    """For each measure the mission where the two are farthest apart, and how many per cent that is."""
    yield f"| measure | missions | largest difference in | {names[0]} | {names[1]} | difference | |"
    yield "|---|---|---|---|---|---|---|"
    for name, (words, unit) in SHOWN.items():
        rows = [row for row in parity.rows() if row.measure == name]
        if not rows:
            continue
        shift = depart_s if name == "lift_off_s" else 0.0
        far = max(rows, key=lambda row: abs(row.difference))
        if max(abs(far.first), abs(far.second)) < SMALL[unit]:
            continue
        share = far.difference / (far.second - shift) if far.second != shift else np.nan
        yield (
            f"| {words} | {len(rows)} | {far.vehicle.split('/')[1]} | {far.first - shift:.2f} {unit} | "
            f"{far.second - shift:.2f} {unit} | {far.difference:+.2f} {unit} | {share:+.1%} |"
        )
    legs = [row for row in parity.rows() if row.measure.startswith("leg_")]
    far = max(legs, key=lambda row: abs(row.difference))
    yield (
        f"| a leg's duration | {len(legs)} legs | {far.vehicle.split('/')[1]}, leg {far.measure.split('_')[1]} | "
        f"{far.first:.2f} s | {far.second:.2f} s | {far.difference:+.2f} s | {far.relative:+.1%} |"
    )


def missions(parity: Parity, names: tuple[str, str] = KINDS) -> Iterator[str]:
    """One row per mission: what happened, and how far apart the two aircraft were."""
    yield f"| mission | modes | items reached | last common item, {' and '.join(names)} | largest distance |"
    yield "|---|---|---|---|---|"
    for name, one in parity.first.items():
        other = parity.second[name]
        modes = " ".join(_said([mode for _, mode in each.modes]) for each in _different(one, other, "modes"))
        items = " / ".join(
            _said([str(seq) for _, seq in each.items]) or "none" for each in _different(one, other, "items")
        )
        common = min(len(one.items), len(other.items))
        last = [f"{each.items[common - 1][0]:.2f} s" for each in (one, other) if common]
        apart = f"{parity.apart_m(name):.1f} m"
        yield f"| {name.split('/')[1]} | {modes} | {items} | {', '.join(last) or 'none'} | {apart} |"


def _different(one: FlightMeasures, other: FlightMeasures, what: str) -> list[FlightMeasures]:
    same = [part[1] for part in getattr(one, what)] == [part[1] for part in getattr(other, what)]
    return [one] if same else [one, other]


def _said(names: list[str]) -> str:
    return ", ".join(names)


def messages(parity: Parity, vehicle: str) -> Iterator[str]:
    """Messages that are not sent equally often, by more than 1 in 20 and 2 in all."""
    one, other = parity.first[vehicle], parity.second[vehicle]
    yield "| message | builtin, in all | ArduPilot, in all | builtin, Hz in the air | ArduPilot, Hz in the air |"
    yield "|---|---|---|---|---|"
    alike = []
    for name in sorted({*one.sent, *other.sent}):
        counts = one.sent.get(name, 0), other.sent.get(name, 0)
        if abs(counts[0] - counts[1]) <= max(2, 0.05 * max(counts)):
            alike.append(name)
            continue
        rates = one.rates_hz.get(name, 0.0), other.rates_hz.get(name, 0.0)
        yield f"| `{name}` | {counts[0]} | {counts[1]} | {rates[0]:.2f} | {rates[1]:.2f} |"
    yield ""
    yield f"Equally often: {', '.join(f'`{name}`' for name in alike)}."
