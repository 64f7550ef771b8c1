"""Relations of attacks to an effect: necessary, sufficient, joint or redundant, from runs of subsets of the attacks.

The question is always the same: is the effect there if exactly these attacks act, and all others are replaced by their
counterfactuals? The definitions are those of component causes: a set of attacks is *sufficient* if the effect is there
when exactly these act, and *minimal* if no smaller part of it is (Rothman, "Causes", Am. J. Epidemiology 104 (1976)
587-592). Sets that were not run are filled in where a monotone effect leaves no choice: one that is there with some
attacks is there with more, one that is absent is absent with fewer. Other sets stay unknown.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations
from typing import Literal

Attacks = frozenset[str]
Relation = Literal["both", "necessary", "sufficient", "joint", "redundant", "none", "unknown"]
"""How one attack relates to an effect that is there when all attacks act:

- `both`: necessary and sufficient. The effect is there with it alone and gone without it.
- `joint`: the effect needs it, and needs others with it; all that the effect needs are joint.
- `necessary`: the effect is gone without it; beside it one or another suffices, or the runs do not tell what it needs.
- `sufficient`: the effect is there with it alone; it was not left out.
- `redundant`: it is part of a minimal set, and without it another set suffices.
- `none`: it is part of no minimal set.
- `unknown`: the runs do not tell.
"""


def relations(seen: Mapping[Attacks, bool]) -> dict[str, Relation]:
    """The relation of every attack to one effect.

    `seen` says for each set of attacks that was run whether the effect is there; the largest set holds all attacks. In
    the empty set, the baseline, the effect is absent by definition. Raises `ValueError` if the effect is not there when
    all act: then there is nothing to attribute.
    """
    everyone = max(seen, key=len)
    if not seen[everyone]:
        raise ValueError("the effect is not there when all attacks act")
    known = complete(seen)
    minimal = _minimal_sets(known)
    whole = len(known) == 2 ** len(everyone)
    found: dict[str, Relation] = {}
    for attack in sorted(everyone):
        alone, without = known.get(frozenset({attack})), known.get(everyone - {attack})
        if alone:
            found[attack] = "both" if without is False else "sufficient" if without is None else "redundant"
        elif without is False:
            joint = alone is False and whole and len(minimal) == 1 and attack in minimal[0]
            found[attack] = "joint" if joint else "necessary"
        elif whole:
            found[attack] = "redundant" if any(attack in one for one in minimal) else "none"
        else:
            found[attack] = "unknown"
    return found


def complete(seen: Mapping[Attacks, bool]) -> dict[Attacks, bool]:
    """`seen` with the empty set and with every set that a monotone effect determines; what was run keeps its value."""
    known = {**seen, frozenset(): False}
    there = [active for active, held in known.items() if held]
    absent = [active for active, held in known.items() if not held]
    for active in subsets(max(seen, key=len)):
        if active not in known:
            with_fewer, with_more = any(one <= active for one in there), any(active <= one for one in absent)
            if with_fewer != with_more:  # both only where what was run is not monotone: then nothing is determined
                known[active] = with_fewer
    return known


def subsets(attacks: Attacks) -> Iterator[Attacks]:
    """All subsets, the smallest first, in the order of their names."""
    for size in range(len(attacks) + 1):
        yield from map(frozenset, combinations(sorted(attacks), size))


def _minimal_sets(known: Mapping[Attacks, bool]) -> list[Attacks]:
    """The sets with the effect of which no smaller part has it."""
    there = [active for active, held in known.items() if held]
    return [active for active in there if not any(other < active for other in there)]
