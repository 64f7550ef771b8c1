"""Arms of a comparison: which attacks and faults act in a run, and in which state the others are.

An attack is in one of three states. *Active*: it acts as declared. *Sham*: it sends as much, at the same times, with
benign content. *Muted*: everything it does is discarded. The *counterfactual* of an attack is the state that stands for
"without it": the sham for an attack that lies, because muting it would remove its airtime as well; muted for one that
works by load, such as a jammer, and for one that alters readings of sensors alone, because its sham is the nominal run
(unless that denies what the attack denies before it lies).
A benign fault is an arm as an attack is; its counterfactual is muted.

The *honest* arm is beside these: every attack that claims an aircraft which is not there is replaced by a real one that
flies on the claimed track and sends the same. It is no counterfactual, because it is neither without the claim nor
harmless; it is what the reaction to a lie is compared with.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Final, Literal, get_args

from skyrange.attack.contract import Counterfactual
from skyrange.core.errors import InputError
from skyrange.scenario.model.scenario import Scenario

Selection = Literal["baseline", "nominal", "sham", "each", "subsets"]
"""Which arms are run: attacked and its baseline; attacked and nominal; sham as well; each attack alone and each left
out as well; all subsets."""

SELECTIONS: Final[tuple[Selection, ...]] = get_args(Selection)
MAX_SUBSETS_OF: Final = 4
"""The largest number of attacks of which every subset is run without being asked for: 16 arms and the nominal one."""

ATTACKED: Final = "attacked"
NOMINAL: Final = "nominal"
SHAM: Final = "sham"
HONEST: Final = "honest"


@dataclass(frozen=True, slots=True)
class Arm:
    """One run of a comparison. Attacks that are not `active` are in their counterfactual state, in `NOMINAL` muted."""

    name: str
    active: frozenset[str] = frozenset()


def acting_attacks(scenario: Scenario) -> dict[str, Counterfactual]:
    """The attacks and faults whose effects are asked for, each with its counterfactual.

    Those declared muted, sham or honest are not among them, nor those that wait for a start by hand.
    """
    counterfactuals: dict[str, Counterfactual] = {
        attack.id: attack.plugin.counterfactual
        for attack in scenario.attacks
        if not (attack.muted or attack.sham or attack.honest) and scenario.is_started(attack)
    }
    return counterfactuals | dict.fromkeys(acting_faults(scenario), "mute")


def claiming_attacks(scenario: Scenario) -> list[str]:
    """The ids of the acting attacks of a kind that can make the honest arm."""
    acting = acting_attacks(scenario)
    return [attack.id for attack in scenario.attacks if attack.id in acting and attack.plugin.honest]


def acting_faults(scenario: Scenario) -> list[str]:
    """The ids of the faults that are not declared muted, and do not wait for a start by hand."""
    return [fault.id for fault in scenario.faults if not fault.muted and scenario.is_started(fault)]


def plan_arms(
    attacks: Mapping[str, Counterfactual], selection: Selection | None = None, *, honest: bool = False
) -> list[Arm]:
    """The arms for these attacks, the nominal one first and the attacked one next.

    Without `selection`: every subset of up to `MAX_SUBSETS_OF` attacks, of more each alone and each left out. Where all
    counterfactuals are muted the sham arm would equal the nominal one and is not run. With `honest` that arm is the
    last. With "baseline" the only other arm is the one with which effects are compared.
    """
    chosen = selection or ("subsets" if len(attacks) <= MAX_SUBSETS_OF else "each")
    if chosen not in SELECTIONS:
        raise InputError.one("pair", "arms", chosen, f"one of {', '.join(SELECTIONS)}")
    ids = sorted(attacks)
    everything = frozenset(ids)
    lies = "sham" in attacks.values()
    arms = [Arm(SHAM if chosen == "baseline" and lies else NOMINAL), Arm(ATTACKED, everything)]
    if chosen in ("sham", "each", "subsets") and lies:
        arms.append(Arm(SHAM))
    if chosen == "each":
        sizes: Sequence[int] = (1, len(ids) - 1)
    else:
        sizes = range(1, len(ids)) if chosen == "subsets" else ()
    for size in sorted({size for size in sizes if 0 < size < len(ids)}):
        arms += [Arm(name_of(subset, ids), frozenset(subset)) for subset in combinations(ids, size)]
    return [*arms, Arm(HONEST)] if honest else arms


def count_arms(
    attacks: Mapping[str, Counterfactual], selection: Selection | None = None, *, honest: bool = False
) -> int:
    """At least how many arms `plan_arms` makes; subsets are counted without making them."""
    if selection == "subsets":
        return 1 << len(attacks)
    return len(plan_arms(attacks, selection, honest=honest))


def baseline_of(attacks: Mapping[str, Counterfactual], arms: Sequence[Arm]) -> str | None:
    """The name of the arm with all attacks in their counterfactual states; `None` if it was not run."""
    if "sham" not in attacks.values():
        return NOMINAL
    return SHAM if any(arm.name == SHAM for arm in arms) else None


def name_of(active: Sequence[str], ids: Sequence[str]) -> str:
    """The name of the arm in which `active`, some of `ids` but not all, act: `only-a`, `only-a+b` or `without-c`."""
    if len(active) == len(ids) - 1 > 1:
        (left_out,) = set(ids) - set(active)
        return f"without-{left_out}"
    return f"only-{'+'.join(active)}"


def scenario_of(scenario: Scenario, arm: Arm, seed: int) -> Scenario:
    """The scenario as it is run in an arm."""
    acting = acting_attacks(scenario)
    claiming = claiming_attacks(scenario) if arm.name == HONEST else ()

    def state(id_: str) -> dict[str, bool]:
        if arm.name == NOMINAL:
            return {"muted": True}
        if id_ in claiming:
            return {"honest": True}
        if id_ in acting and id_ not in arm.active:
            return {"sham": True} if acting[id_] == "sham" else {"muted": True}
        return {}

    return scenario.model_copy(
        update={
            "attacks": tuple(attack.model_copy(update=state(attack.id)) for attack in scenario.attacks),
            "faults": tuple(fault.model_copy(update=state(fault.id)) for fault in scenario.faults),
            "seed": seed,
        }
    )
