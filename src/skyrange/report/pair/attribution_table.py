"""Table of attribution: for each effect on each aircraft, how every attack relates to it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from markupsafe import Markup

from skyrange.figures.subject import Subject
from skyrange.report import quantities
from skyrange.report.rendering import render
from skyrange.twins.attribution.attribute import unknown_subsets
from skyrange.twins.attribution.outcomes import ENOUGH_PLACEBOS, OUTCOMES
from skyrange.twins.pair_folder import Pair

MAX_ROWS = 200
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
