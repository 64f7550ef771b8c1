"""Tables of effects: per aircraft, per operator, means over seeds, and to which attacks they are attributed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from markupsafe import Markup

from skyrange.figures.subject import Subject
from skyrange.report import quantities
from skyrange.report.pair.moments import Moments
from skyrange.report.rendering import render
from skyrange.report.viewer import at_moment
from skyrange.statistics.means import Interval
from skyrange.twins.attribution import unknown_subsets
from skyrange.twins.effects import CLAIM_PLACEBOS, ENOUGH_PLACEBOS, OUTCOMES
from skyrange.twins.lie_and_truth import REACTIONS, format_reaction, reacts, truth_name
from skyrange.twins.pair_folder import Pair

Row = Mapping[str, Any]

MAX_ROWS = 200

_MEASURES = (
    ("delay_s", "arrival delay", "s", 1.0, 2),
    ("extra_distance_m", "extra distance", "m", 1.0, 1),
    ("extra_energy_j", "extra energy", "kJ", 1e-3, 2),
    ("min_separation_m", "least separation", "m", 1.0, 1),
    ("min_wall_m", "nearest wall", "m", 1.0, 1),
    ("near_misses", "near misses", "", 1.0, 2),
    ("collisions", "collisions", "", 1.0, 2),
    ("departure_m", "from the twin at most", "m", 1.0, 1),
)
_BADGES = {"complete": "ok", "failed": "bad", "unfinished": "wait"}


def render_effects(subject: Subject, rows: Sequence[Row], find_moments: Callable[[Row], Moments]) -> Markup:
    """Render one row per aircraft against one twin, the farthest departure first; numbers lead to their moments."""
    places = {vehicle.id: index for index, vehicle in enumerate(subject.fleet)}
    ordered = sorted(rows, key=lambda row: -row["departure_m"])
    shown = [_row(row, places, find_moments(row)) for row in ordered[:MAX_ROWS]]
    return render("pair/effects.html.jinja", rows=shown, total=len(rows))


def render_operators(subject: Subject, rows: Sequence[Row]) -> Markup:
    """Render the sums of each operator's aircraft; empty if every operator has one aircraft."""
    owned: dict[str, list[Row]] = {}
    for row in rows:
        owned.setdefault(row["vehicle"].partition("/")[0], []).append(row)
    if len(owned) == len(rows):
        return Markup()
    places = {vehicle.id: index for index, vehicle in enumerate(subject.fleet)}
    return render(
        "pair/operators.html.jinja",
        rows=[
            {"operator": name, "place": places[operator_rows[0]["vehicle"]], "numbers": _together(operator_rows)}
            for name, operator_rows in owned.items()
        ],
    )


def render_lie_and_truth(subject: Subject, rows: Sequence[Row]) -> Markup:
    """Render one row per aircraft: what it did about a claimed aircraft, and about a real one in its place."""
    places = {vehicle.id: index for index, vehicle in enumerate(subject.fleet)}
    ordered = sorted(rows, key=lambda row: -max(row["departure_m"], row[truth_name("departure_m")]))
    shown = [
        {
            "vehicle": row["vehicle"],
            "place": places[row["vehicle"]],
            "quiet": not reacts(row),
            "numbers": [
                *(format_reaction(row, reaction) for reaction in REACTIONS),
                _change(row["min_separation_m"], row[truth_name("min_separation_m")]),
                ((f"{row['apart_m']:.1f}", "m"),),
            ],
        }
        for row in ordered[:MAX_ROWS]
    ]
    titles = [reaction.title for reaction in REACTIONS] + ["least separation", "lie from truth at most"]
    return render("pair/honest.html.jinja", rows=shown, titles=titles, total=len(rows))


def render_ensemble(
    subject: Subject, intervals: Mapping[str, Mapping[str, Interval]], affected: Sequence[str]
) -> Markup:
    """Render means over seeds with their intervals, of aircraft that departed in at least one run."""
    places = {vehicle.id: index for index, vehicle in enumerate(subject.fleet)}
    chosen = [name for name in intervals if name in affected] or list(intervals)
    return render(
        "pair/ensemble.html.jinja",
        measures=[name for _, name, *_ in _MEASURES],
        rows=[
            {
                "vehicle": name,
                "place": places[name],
                "intervals": [
                    _interval(intervals[name].get(key), unit, scale, n) for key, _, unit, scale, n in _MEASURES
                ],
            }
            for name in chosen[:MAX_ROWS]
        ],
    )


def _row(row: Row, places: Mapping[str, int], moments: Moments) -> Mapping[str, Any]:
    def at(shown: str | quantities.Quantity, time_s: float | None) -> quantities.Shown:
        return at_moment(shown, time_s, row["vehicle"])

    departed, energy = row["departed_s"], row["extra_energy_j"]
    to_its_end = () if row["outcome"] == row["outcome_twin"] else (("to its end", ""),)
    states = dict.fromkeys((row["outcome_twin"], row["outcome"]))
    return {
        "vehicle": row["vehicle"],
        "place": places[row["vehicle"]],
        "quiet": departed is None,
        "outcomes": [(_BADGES.get(state, "wait"), state) for state in states],
        "numbers": (
            at(quantities.MISSING if departed is None else quantities.quantity(departed, "s", 1), departed),
            at(quantities.quantity(row["departure_m"], "m", 1), moments.farthest_s),
            at(quantities.signed(row["delay_s"], "s", 2), moments.end_s),
            at((*quantities.signed(row["extra_distance_m"], "m", 1), *to_its_end), moments.end_s),
            at(
                (*quantities.signed(None if energy is None else energy / 1000.0, "kJ", 2), *to_its_end),
                None if energy is None else moments.end_s,
            ),
            at(_change(row["min_separation_twin_m"], row["min_separation_m"]), moments.nearest_s),
            at(_change(row["min_wall_twin_m"], row["min_wall_m"]), moments.wall_s),
            at(_counts(row["near_misses_twin"], row["near_misses"]), moments.nearest_s if row["near_misses"] else None),
            at(_counts(row["collisions_twin"], row["collisions"]), moments.collision_s),
        ),
    }


def _together(rows: Sequence[Row]) -> Sequence[str | quantities.Quantity]:
    """The sums over one operator's aircraft; distance and energy over those with the same outcome in both runs."""
    flown = [row for row in rows if row["outcome"] == row["outcome_twin"]]
    return (
        quantities.count(len(rows)),
        quantities.count(sum(row["departed_s"] is not None for row in rows)),
        quantities.count(sum(row["outcome"] != row["outcome_twin"] for row in rows)),
        quantities.signed(sum(row["delay_s"] or 0.0 for row in rows), "s", 2),
        quantities.signed(sum(row["extra_distance_m"] for row in flown), "m", 1),
        quantities.signed(sum(row["extra_energy_j"] or 0.0 for row in flown) / 1000.0, "kJ", 2),
        _counts(sum(row["near_misses_twin"] for row in rows), sum(row["near_misses"] for row in rows)),
        _counts(sum(row["collisions_twin"] for row in rows), sum(row["collisions"] for row in rows)),
    )


def _interval(interval: Interval | None, unit: str, scale: float, decimals: int) -> Mapping[str, Any] | None:
    if interval is None:
        return None
    ends = [
        None if value is None else f"{value * scale:.{decimals}f}".replace("-", "−")
        for value in (interval.low, interval.high)
    ]
    return {
        "mean": quantities.signed(interval.mean * scale, unit, decimals),
        "low": None if None in ends else ends[0],
        "high": ends[1],
        "n": interval.n,
        "without": interval.without,
        "bold": interval.excludes_zero,
    }


def _change(twin: float | None, attacked: float | None) -> quantities.Quantity:
    if twin is None and attacked is None:
        return quantities.MISSING
    shown = ["far" if value is None else f"{value:.1f}" for value in (twin, attacked)]
    return ((" → ".join(dict.fromkeys(shown)), "m"),)


def _counts(twin: int, attacked: int) -> str:
    return str(attacked) if twin == attacked else f"{twin} → {attacked}"


_UNITS = {outcome.name: outcome.unit for outcome in OUTCOMES}


def describe_attribution(pair: Pair, subject: Subject, seed: int) -> Mapping[str, Any]:
    """What the page says about attribution: its table, the baseline, the placebos and what the runs do not tell."""
    rows = [row for row in pair.attribution.to_pylist() if row["seed"] == seed]
    return {
        "baseline": f"the {pair.baseline or pair.reference} run",
        "placebos": _describe_placebos(rows),
        "table": render_attribution(subject, rows),
        "unknown": _describe_unknown(pair),
    }


def render_attribution(subject: Subject, rows: Sequence[Mapping[str, Any]]) -> Markup:
    """Render one row per aircraft and effect, with a column per attack and per fault."""
    attacks = list(dict.fromkeys(row["attack"] for row in rows))
    faults = {row["attack"] for row in rows if row["fault"]}
    places = {vehicle.id: index for index, vehicle in enumerate(subject.fleet)}
    effects: dict[tuple[str, str], dict[str, Mapping[str, Any]]] = {}
    for row in rows:
        effects.setdefault((row["vehicle"], row["outcome"]), {})[row["attack"]] = row
    shown = []
    for (vehicle, outcome), vehicle_effects in list(effects.items())[:MAX_ROWS]:
        first, unit = next(iter(vehicle_effects.values())), _UNITS[outcome]
        shown.append(
            {
                "vehicle": vehicle,
                "place": places[vehicle],
                "outcome": outcome,
                "numbers": [
                    at_moment(_value(first["difference"], unit), first["departed_s"], vehicle),
                    _value(first["limit"], unit),
                ],
                "relations": [_describe_relation(vehicle_effects[attack]) for attack in attacks],
            }
        )
    return render(
        "pair/attribution.html.jinja",
        rows=shown,
        attacks=[f"{attack} (fault)" if attack in faults else attack for attack in attacks],
        total=len(effects),
    )


def _describe_relation(row: Mapping[str, Any]) -> Mapping[str, str]:
    shift_s = row["shift_s"]
    shift = f"{row['shift']} by {abs(shift_s):.1f} s" if None not in (row["shift"], shift_s) else ""
    return {"relation": row["relation"] if row["shown"] else "not enough placebos", "shift": shift}


def _value(value: float, unit: str) -> quantities.Quantity:
    if unit == "J":
        return quantities.quantity(value / 1000.0, "kJ", 2)
    return quantities.quantity(value, unit, 1 if unit else 0)


def _describe_placebos(rows: Sequence[Mapping[str, Any]]) -> str:
    """How far the limits can be trusted."""
    if not rows:
        return ""
    if all(row["level"] == 0.0 for row in rows):
        return (
            "A limit is the smallest difference that counts. No placebo is needed to find it: these runs repeat to the "
            "byte, so two runs without the attack do not differ at all, and the sham changed no outcome."
        )
    fewest = min(row["placebos"] for row in rows if row["level"] > 0.0)
    what = (
        f"{fewest} placebo{'s' * (fewest != 1)}: a difference that is no effect exceeds it in 1 of {fewest + 1} cases"
    )
    sentence = f"A limit is the smallest difference that counts, or the largest of {what}."
    if fewest >= CLAIM_PLACEBOS:
        return sentence
    claim = f"a claim takes {CLAIM_PLACEBOS}, because each aircraft has a limit for each outcome"
    if all(row["shown"] for row in rows):
        return f"{sentence} Fewer than {CLAIM_PLACEBOS} are a look: {claim} (--seeds)."
    return f"{sentence} An effect is shown from {ENOUGH_PLACEBOS} placebos on; {claim} (--seeds)."


def _describe_unknown(pair: Pair) -> str:
    """What the runs cannot tell, "" if they tell everything."""
    if pair.baseline is None:
        return "The runs with the attacks' counterfactuals were not made (--arms), so no effect is attributed."
    unknown = unknown_subsets(pair.manifest["active"])
    if not unknown:
        return ""
    return (
        f"{unknown} combinations of attacks were not run. An effect that needs such a combination is reported as "
        "unknown; --arms subsets runs all of them."
    )
