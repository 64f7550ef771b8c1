"""The verdict on a pair: what was lost, and what made which aircraft leave its path, when, and at what cost."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from skyrange.twins.pair_folder import Pair

_RELATIONS: Final = {
    "both": "necessary and sufficient",
    "necessary": "necessary",
    "sufficient": "sufficient",
    "joint": "necessary, together with others",
    "redundant": "another one suffices too",
}
"""Words for how the attacks relate to the effect (`twins.attribution`); others are left out."""


_NAMES_SHOWN: Final = 3


def describe_verdict(pair: Pair, seed: int) -> str:
    """What was lost in the run of `seed`, and the aircraft that first departed from its path, by whom, and in how many
    seeds it did.
    """
    rows = [row for row in pair.effects.to_pylist() if row["against"] == pair.twin and row["seed"] == seed]
    return " ".join(filter(None, (describe_losses(rows), _describe_departure(pair, seed))))


def describe_losses(rows: Sequence[Mapping[str, Any]]) -> str:
    """The collisions of aircraft and the missions that the twin does not have to lose, from rows of effects of one run;
    empty where nothing was lost.
    """
    collided = [row["vehicle"] for row in rows if row["collisions"] > row["collisions_twin"]]
    lost = [row["vehicle"] for row in rows if row["outcome"] != "complete" and row["outcome_twin"] == "complete"]
    parts = [
        f"{len(collided)} aircraft collided ({_list_some(collided)})" if collided else "",
        f"{len(lost)} mission{'s were' if len(lost) > 1 else ' was'} lost ({_list_some(lost)})" if lost else "",
    ]
    said = "; ".join(filter(None, parts))
    return f"{said}." if said else ""


def _list_some(names: Sequence[str]) -> str:
    more = len(names) - _NAMES_SHOWN
    return ", ".join(names[:_NAMES_SHOWN]) + (f" and {more} more" if more > 0 else "")


def _describe_departure(pair: Pair, seed: int) -> str:
    """The aircraft that first departed from its path, by whom, and in how many seeds."""
    rows = [row for row in pair.effects.to_pylist() if row["against"] == pair.twin]
    departed = [row for row in rows if row["departed_s"] is not None]
    of_seed = [row for row in departed if row["seed"] == seed]
    if not of_seed:
        if len(pair.seeds) == 1:
            return f"No aircraft left its path in this run, seed {seed}."
        others = len({row["seed"] for row in departed})
        elsewhere = f"one did in {others} of {len(pair.seeds)} seeds" if others else f"nor in any of {len(pair.seeds)}"
        return f"No aircraft left its path with seed {seed}; {elsewhere}."
    first = min(of_seed, key=lambda row: row["departed_s"])
    authors, vehicle = _authors(first), first["vehicle"]
    what = f"{' and '.join(authors)} made {vehicle} leave" if authors else f"{vehicle} left"
    relation = (
        _RELATIONS.get(str(first["attribution"]), "") if authors else "no attack or fault is shown to be the cause"
    )
    sentence = f"{what} its path at {first['departed_s']:.1f} s: {_costs(first)}{f'; {relation}' if relation else ''}."
    more = len(of_seed) - 1
    also = f" {more} more aircraft left {'its path' if more == 1 else 'their paths'}." if more else ""
    alike = {row["seed"] for row in departed if row["vehicle"] == vehicle and _authors(row) == authors}
    many = f"With seed {seed}; it did so in {len(alike)} of {len(pair.seeds)} seeds."
    return f"{sentence} {f'In this run, seed {seed}.' if len(pair.seeds) == 1 else many}{also}"


def _authors(row: Mapping[str, Any]) -> list[str]:
    """The attacks and faults that caused an effect."""
    return [*row["attacks"], *row["faults"]]


def _costs(row: Mapping[str, Any]) -> str:
    """Distance from the twin, delay, energy, and how the mission ended if the twin's ended otherwise."""
    parts = [f"{row['departure_m']:.0f} m off its path"]
    if (delay_s := row["delay_s"]) is not None and abs(delay_s) >= 1.0:
        parts.append(f"{abs(delay_s):.0f} s {'late' if delay_s > 0 else 'early'}")
    if (energy_j := row["extra_energy_j"]) is not None and abs(energy_j) >= 100.0:
        parts.append(f"{energy_j / 1000:.1f} kJ {'more' if energy_j > 0 else 'less'}")
    if row["outcome"] != row["outcome_twin"]:
        parts.append(f"its mission {row['outcome']} instead of {row['outcome_twin']}")
    return ", ".join(parts)
