"""Tables of a comparison with logs as text, for its page, for Markdown and for a terminal."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Final, NamedTuple

import numpy as np

from skyrange.parity.logs.comparison import LogParity
from skyrange.parity.logs.measures import QUANTITIES, SPREADS, FlightMeasures

NAMES: Final = {"builtin": "builtin autopilot", "ardupilot": "ArduPilot"}
_COLUMNS: Final = {
    "x_mps2": "along the body",
    "y_mps2": "across it",
    "z_mps2": "upright",
    "velocity": "velocity",
    "horizontal": "horizontal position",
    "vertical": "height",
    "compass": "compass",
    "hdop": "HDOP",
    "satellites": "satellites",
}
_NONE: Final = "–"


class TextTable(NamedTuple):
    """A table of texts; the first column names the row."""

    title: str
    lead: str
    head: tuple[str, ...]
    rows: Sequence[tuple[str, ...]]


def list_tables(result: LogParity) -> Iterator[TextTable]:
    """All tables of a comparison."""
    yield _tabulate_differences(result)
    yield _tabulate_tracks(result)
    yield _tabulate_flights(result)
    yield _tabulate_spreads(result)


def tabulate_quantities() -> TextTable:
    """What each quantity is."""
    rows = [(quantity.name, quantity.unit, quantity.definition) for quantity in QUANTITIES.values()]
    return TextTable("Quantities", "Heights are above home.", ("quantity", "unit", "definition"), rows)


def _tabulate_differences(result: LogParity) -> TextTable:
    rows = []
    for name, quantity in QUANTITIES.items():
        for autopilot in result.plan.seeds:
            median = result.median(autopilot, name)
            if median is None:
                rows.append((quantity.name, NAMES[autopilot], _NONE, _NONE, "0"))
                continue
            values = (median.value, median.low, median.high)
            value, low, high = (f"{v:+.1%}" if quantity.relative else f"{v:+.1f}{quantity.unit}" for v in values)
            rows.append((quantity.name, NAMES[autopilot], value, f"{low} to {high}", str(median.flights)))
    lead = (
        "The median over the flights of: median of the simulated flights less the log, relative to the log or in the "
        "unit of the quantity. The limits are those of 95 % by a bootstrap over the flights."
    )
    return TextTable("Differences", lead, ("quantity", "flown by", "difference", "limits", "flights"), rows)


def _tabulate_tracks(result: LogParity) -> TextTable:
    rows = []
    for autopilot in result.plan.seeds:
        scores = result.scores(autopilot)
        held = sum(score.held for score in scores)
        means = [
            float(np.mean([getattr(score, name) for score in scores])) if scores else math.nan
            for name in ("inside", "width_m", "away_m", "score_m")
        ]
        inside, width_m, away_m, score_m = means
        shown = f"{inside:.0%}", f"{width_m:.2f} m", f"{away_m:.2f} m", f"{score_m:.1f} m"
        rows.append((NAMES[autopilot], str(result.plan.seeds[autopilot]), f"{held} of {len(scores)}", *shown))
    lead = (
        "A band holds 95 % of the simulated tracks of a flight as a whole, at all times and along all axes. The "
        "interval score is its width and 40 times the distance of the log from it; less is better."
    )
    head = ("flown by", "seeds", "tracks held", "times inside", "width", "log from the middle", "interval score")
    return TextTable("Tracks", lead, head, rows)


def _tabulate_flights(result: LogParity) -> TextTable:
    rows = []
    for flight in result.flights:
        cells = []
        for name, quantity in QUANTITIES.items():
            logged, values = flight.log.quantities.get(name), flight.values(name)
            simulated = f"{np.median(values):.1f}" if len(values) else _NONE
            note = "" if logged is None or flight.is_judged(name) else " (not judged)"
            known = f"{logged.value:.1f}" if logged is not None else _NONE
            cells.append(f"{known} / {simulated} {quantity.unit}{note}")
        ended = ", ".join(f"{count} {outcome}" for outcome, count in sorted(flight.outcomes.items()))
        rows.append((flight.name, NAMES[flight.autopilot], *cells, ended))
    head = ("flight", "flown by", *(quantity.name for quantity in QUANTITIES.values()), "simulated flights")
    return TextTable("Flights", "Log / median of the simulated flights.", head, rows)


def _tabulate_spreads(result: LogParity) -> TextTable:
    first = next(iter(result.plan.seeds))
    groups = {"log": [flight.log for flight in result.of(first)]}
    for autopilot in result.plan.seeds:
        groups[NAMES[autopilot]] = [each for flight in result.of(autopilot) for each in flight.flown]
    rows = [("speed over ground in the middle of the leg, m/s", *(_show_speeds(flown) for flown in groups.values()))]
    for subject, (_, columns) in SPREADS.items():
        for column in columns:
            cells = [_show_spread(flown, subject, column) for flown in groups.values()]
            rows.append((f"{subject}: {_COLUMNS[column]}", *cells))
    lead = (
        "The speed: median, least and greatest of the flights. The others, in the air: the percentiles 50, 5 and 95 "
        "of each flight, and the median of these over the flights. All without a verdict."
    )
    return TextTable("Shown beside each other", lead, ("reported", *groups), rows)


def _show_speeds(flights: Sequence[FlightMeasures]) -> str:
    speeds = [speed for each in flights if (speed := each.find_leg_speed_mps()) is not None]
    return f"{np.median(speeds):.2f} ({min(speeds):.2f} to {max(speeds):.2f})" if speeds else _NONE


def _show_spread(flights: Sequence[FlightMeasures], subject: str, column: str) -> str:
    known = [each.spreads[subject][column] for each in flights if column in each.spreads.get(subject, {})]
    if not known:
        return "not reported"
    low, middle, high = np.median(np.array(known), axis=0)
    if not np.any(np.array(known)):
        return "0 throughout"
    return f"{middle:.3g} ({low:.3g} to {high:.3g})"


def describe_result(result: LogParity) -> str:
    """What was compared, in a sentence."""
    flights = len(result.plan.flights)
    by = [
        f"by {'the ' if name == 'builtin' else ''}{NAMES[name]} with {seeds} seeds"
        for name, seeds in result.plan.seeds.items()
    ]
    number = "One flight" if flights == 1 else f"{flights} flights"
    return f"{number} of {result.plan.firmware}, flown {' and '.join(by)}."
