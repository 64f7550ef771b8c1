"""Tables of effects: per aircraft, per operator, means over seeds, and to which attacks they are attributed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from skyrange.figures.subject import Subject
from skyrange.report import quantities
from skyrange.report.rendering import render
from skyrange.statistics.means import Interval
from skyrange.twins.attribution import unknown_subsets
from skyrange.twins.effects import ENOUGH_PLACEBOS, OUTCOMES
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


def render_effects(subject: Subject, rows: Sequence[Row]) -> Markup:
    """Render one row per aircraft against one twin, the farthest departure first."""
    places = {vehicle.id: index for index, vehicle in enumerate(subject.fleet)}
    ordered = sorted(rows, key=lambda row: -row["departure_m"])
    shown = [_row(row, places) for row in ordered[:MAX_ROWS]]
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
            {"operator": name, "place": places[own[0]["vehicle"]], "numbers": _together(own)}
            for name, own in owned.items()
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
                *(format_reaction(row, one) for one in REACTIONS),
                _change(row["min_separation_m"], row[truth_name("min_separation_m")]),
                ((f"{row['apart_m']:.1f}", "m"),),
            ],
        }
        for row in ordered[:MAX_ROWS]
    ]
    titles = [one.title for one in REACTIONS] + ["least separation", "lie from truth at most"]
    return render("pair/honest.html.jinja", rows=shown, titles=titles, total=len(rows))


def render_ensemble(subject: Subject, found: Mapping[str, Mapping[str, Interval]], affected: Sequence[str]) -> Markup:
    """Render means over seeds with their intervals, of aircraft that departed in at least one run."""
    places = {vehicle.id: index for index, vehicle in enumerate(subject.fleet)}
    chosen = [name for name in found if name in affected] or list(found)
    return render(
        "pair/ensemble.html.jinja",
        measures=[name for _, name, *_ in _MEASURES],
        rows=[
            {
                "vehicle": name,
                "place": places[name],
                "intervals": [_interval(found[name].get(key), unit, scale, n) for key, _, unit, scale, n in _MEASURES],
            }
            for name in chosen[:MAX_ROWS]
        ],
    )


def _row(row: Row, places: Mapping[str, int]) -> Mapping[str, Any]:
    departed, energy = row["departed_s"], row["extra_energy_j"]
    to_its_end = () if row["outcome"] == row["outcome_twin"] else (("to its end", ""),)
    states = dict.fromkeys((row["outcome_twin"], row["outcome"]))
    return {
        "vehicle": row["vehicle"],
        "place": places[row["vehicle"]],
        "quiet": departed is None,
        "outcomes": [(_BADGES.get(state, "wait"), state) for state in states],
        "numbers": (
            quantities.MISSING if departed is None else quantities.quantity(departed, "s", 1),
            quantities.quantity(row["departure_m"], "m", 1),
            quantities.signed(row["delay_s"], "s", 2),
            (*quantities.signed(row["extra_distance_m"], "m", 1), *to_its_end),
            (*quantities.signed(None if energy is None else energy / 1000.0, "kJ", 2), *to_its_end),
            _change(row["min_separation_twin_m"], row["min_separation_m"]),
            _change(row["min_wall_twin_m"], row["min_wall_m"]),
            _counts(row["near_misses_twin"], row["near_misses"]),
            _counts(row["collisions_twin"], row["collisions"]),
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


def _interval(found: Interval | None, unit: str, scale: float, decimals: int) -> Mapping[str, Any] | None:
    if found is None:
        return None
    ends = [
        None if value is None else f"{value * scale:.{decimals}f}".replace("-", "−")
        for value in (found.low, found.high)
    ]
    return {
        "mean": quantities.signed(found.mean * scale, unit, decimals),
        "low": None if None in ends else ends[0],
        "high": ends[1],
        "n": found.n,
        "without": found.without,
        "bold": found.excludes_zero,
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
    faults = {row["attack"] for row in rows if row.get("fault")}
    places = {vehicle.id: index for index, vehicle in enumerate(subject.fleet)}
    effects: dict[tuple[str, str], dict[str, Mapping[str, Any]]] = {}
    for row in rows:
        effects.setdefault((row["vehicle"], row["outcome"]), {})[row["attack"]] = row
    shown = []
    for (vehicle, outcome), own in list(effects.items())[:MAX_ROWS]:
        first, unit = next(iter(own.values())), _UNITS[outcome]
        shown.append(
            {
                "vehicle": vehicle,
                "place": places[vehicle],
                "outcome": outcome,
                "numbers": [_value(first[key], unit) for key in ("difference", "limit")],
                "relations": [_describe_relation(own[attack]) for attack in attacks],
            }
        )
    return render(
        "pair/attribution.html.jinja",
        rows=shown,
        attacks=[f"{one} (fault)" if one in faults else one for one in attacks],
        total=len(effects),
    )


def _describe_relation(row: Mapping[str, Any]) -> Mapping[str, str]:
    shift_s = row["shift_s"]
    shift = f"{row['shift']} by {abs(shift_s):.1f} s" if row["shift"] is not None else ""
    return {"relation": row["relation"] if row.get("shown", True) else "not enough placebos", "shift": shift}


def _value(value: float, unit: str) -> quantities.Quantity:
    if unit == "J":
        return quantities.quantity(value / 1000.0, "kJ", 2)
    return quantities.quantity(value, unit, 1 if unit else 0)


def _describe_placebos(rows: Sequence[Mapping[str, Any]]) -> str:
    """How far the limits can be trusted."""
    if not rows:
        return ""
    if any("level" not in row for row in rows):
        return "An older version of skyrange made this pair: it does not say how far its limits can be trusted."
    if all(row["level"] == 0.0 for row in rows):
        return (
            "A limit is the smallest difference that counts. No placebo is needed to find it: these runs repeat to the "
            "byte, so two runs without the attack do not differ at all, and the sham changed no outcome."
        )
    fewest = min(row["placebos"] for row in rows if row["level"] > 0.0)
    what = (
        f"{fewest} placebo{'s' * (fewest != 1)}: a difference that is no effect exceeds it in 1 of {fewest + 1} cases"
    )
    told = f"A limit is the smallest difference that counts, or the largest of {what}."
    if all(row["shown"] for row in rows):
        return told
    return f"{told} An effect is shown from {ENOUGH_PLACEBOS} placebos on (--seeds)."


def _describe_unknown(pair: Pair) -> str:
    """What the runs cannot tell, "" if they tell everything."""
    if pair.baseline is None:
        return "The runs with the attacks' counterfactuals were not made (--arms), so no effect is attributed."
    unknown = unknown_subsets(pair.manifest.get("active", {}))
    if not unknown:
        return ""
    return (
        f"{unknown} combinations of attacks were not run. An effect that needs such a combination is reported as "
        "unknown; --arms subsets runs all of them."
    )
