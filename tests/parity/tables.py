"""What do the pages say of two autopilots side by side? The tables of docs/data/parity.json, made of a comparison."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TypedDict

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
HOVER: Mapping[str, tuple[str, str, int]] = {
    "wander_m": ("level distance from the mean place, RMS", "m", 3),
    "speed_mps": ("level speed, RMS", "m/s", 3),
    "height_m": ("height around its mean, RMS", "m", 3),
    "climb_mps": ("climb, RMS", "m/s", 3),
    "tilt_deg": ("tilt, mean", "°", 2),
}
"""Measures of a hover: what they are, unit, decimals."""


class Table(TypedDict):
    """A table of the pages."""

    heads: list[str]
    rows: list[list[str]]


def measures(parity: Parity, depart_s: float) -> Table:
    """For each measure the mission where the two are farthest apart, and how many per cent that is."""
    rows = []
    for name, (words, unit) in SHOWN.items():
        found = [row for row in parity.rows() if row.measure == name]
        if not found:
            continue
        shift = depart_s if name == "lift_off_s" else 0.0
        far = max(found, key=lambda row: abs(row.difference))
        if max(abs(far.first), abs(far.second)) < SMALL[unit]:
            continue
        share = far.difference / (far.second - shift) if far.second != shift else np.nan
        both = (f"{value - shift:.2f} {unit}" for value in (far.first, far.second))
        rows.append(
            [words, str(len(found)), _mission(far.vehicle), *both, f"{far.difference:+.2f} {unit}", f"{share:+.1%}"]
        )
    legs = [row for row in parity.rows() if row.measure.startswith("leg_")]
    far = max(legs, key=lambda row: abs(row.difference))
    where = f"{_mission(far.vehicle)}, leg {far.measure.split('_')[1]}"
    both = (f"{value:.2f} s" for value in (far.first, far.second))
    rows.append(
        ["a leg's duration", f"{len(legs)} legs", where, *both, f"{far.difference:+.2f} s", f"{far.relative:+.1%}"]
    )
    heads = ["measure", "missions", "largest difference in", "builtin", "ArduPilot", "difference", "relative"]
    return {"heads": heads, "rows": rows}


def missions(parity: Parity) -> Table:
    """One row per mission: what happened, and how far apart the two aircraft were."""
    rows = []
    for name, one in parity.first.items():
        other = parity.second[name]
        modes = " ".join(_said([mode for _, mode in each.modes]) for each in _different(one, other, "modes"))
        items = " / ".join(
            _said([str(seq) for _, seq in each.items]) or "none" for each in _different(one, other, "items")
        )
        common = min(len(one.items), len(other.items))
        last = [f"{each.items[common - 1][0]:.2f} s" for each in (one, other) if common]
        rows.append([_mission(name), modes, items, ", ".join(last) or "none", f"{parity.apart_m(name):.1f} m"])
    heads = ["mission", "modes", "items reached", "last common item, builtin and ArduPilot", "largest distance"]
    return {"heads": heads, "rows": rows}


def rates(flown: Mapping[str, Mapping[float, Parity]], depart_s: float) -> Table:
    """For each measure the largest difference that cheaper rates make, over all winds: by rates, then by wind."""
    rows: dict[str, list[str]] = {}
    for by_wind in flown.values():
        for words, (mission, difference) in _of_rates(by_wind, depart_s):
            rows.setdefault(words, [words]).extend((mission, difference))
    heads = ["measure", *(head for name in flown for head in (f"{name}: largest in", "difference"))]
    return {"heads": heads, "rows": list(rows.values())}


def _of_rates(by_wind: Mapping[float, Parity], depart_s: float) -> Iterator[tuple[str, tuple[str, str]]]:
    flights = [(wind_mps, name, parity) for wind_mps, parity in by_wind.items() for name in parity.first]
    lasts = []
    for wind_mps, name, parity in flights:
        items = [flight.items for flight in (parity.first[name], parity.second[name])]
        if common := min(map(len, items)):
            lasts.append((items[0][common - 1][0] - items[1][common - 1][0], wind_mps, name))
    if lasts:
        difference, wind_mps, name = max(lasts, key=lambda last: abs(last[0]))
        yield "last common item", (_place(name, wind_mps), f"{abs(difference):.1f} s")
    known = [(wind_mps, row) for wind_mps, parity in by_wind.items() for row in parity.rows()]
    for measure, (words, unit) in {**SHOWN, "leg_": ("a leg's duration", "s")}.items():
        found = [(wind_mps, row) for wind_mps, row in known if row.measure.startswith(measure)]
        if not found:
            continue
        wind_mps, far = max(found, key=lambda one: abs(one[1].difference))
        shift = depart_s if measure == "lift_off_s" else 0.0
        leg = f", leg {far.measure.split('_')[1]}" if measure == "leg_" else ""
        share = abs(far.difference / (far.second - shift)) if far.second != shift else np.nan
        yield words, (f"{_place(far.vehicle, wind_mps)}{leg}", f"{abs(far.difference):.2f} {unit}, {share:.1%}")
    apart_m, wind_mps, name = max((parity.apart_m(name), wind_mps, name) for wind_mps, name, parity in flights)
    yield "position at equal time", (_place(name, wind_mps), f"{apart_m:.1f} m")


def hover(builtin: Mapping[str, float], ardupilot: Mapping[str, float]) -> Table:
    """How steadily the two hover."""
    rows = [
        [
            words,
            f"{builtin[name]:.{decimals}f} {unit}",
            f"{ardupilot[name]:.{decimals}f} {unit}",
            f"{builtin[name] / ardupilot[name] - 1.0:+.1%}",
        ]
        for name, (words, unit, decimals) in HOVER.items()
    ]
    return {"heads": ["measure", "builtin", "ArduPilot", "difference"], "rows": rows}


def messages(parity: Parity, vehicle: str) -> Table:
    """Messages that are not sent equally often, by more than 1 in 20 and 2 in all; then those that are."""
    one, other = parity.first[vehicle], parity.second[vehicle]
    rows, alike = [], []
    for name in sorted({*one.sent, *other.sent}):
        counts = one.sent.get(name, 0), other.sent.get(name, 0)
        if abs(counts[0] - counts[1]) <= max(2, 0.05 * max(counts)):
            alike.append(name)
            continue
        hz = [f"{each.rates_hz.get(name, 0.0):.2f}" for each in (one, other)]
        rows.append([f"`{name}`", *map(str, counts), *hz])
    heads = ["message", "builtin, in all", "ArduPilot, in all", "builtin, Hz in the air", "ArduPilot, Hz in the air"]
    rows.append([", ".join(f"`{name}`" for name in alike), "equally often", "", "", ""])
    return {"heads": heads, "rows": rows}


def _mission(vehicle: str) -> str:
    return vehicle.split("/")[1]


def _place(vehicle: str, wind_mps: float) -> str:
    return f"{_mission(vehicle)}, wind" if wind_mps else _mission(vehicle)


def _different(one: FlightMeasures, other: FlightMeasures, what: str) -> list[FlightMeasures]:
    same = [part[1] for part in getattr(one, what)] == [part[1] for part in getattr(other, what)]
    return [one] if same else [one, other]


def _said(names: list[str]) -> str:
    return ", ".join(names)
