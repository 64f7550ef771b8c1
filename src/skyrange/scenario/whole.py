"""What must hold of a scenario as a whole? Someone flies, no name stands twice, every rule meets a link.

The checks read models and raw tables alike, so that a file with bad values elsewhere still hears of these.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from fnmatch import fnmatchcase
from typing import Any

from skyrange.core.errors import Fault, nearest
from skyrange.scenario.fleet import MAX_VEHICLES
from skyrange.scenario.links import link_names


def whole_faults(scenario: Any) -> list[Fault]:
    """All faults between the parts of a Scenario, or of the table it is to be built from.

    Of a table, only what can be told before its values are known to be sound.
    """
    faults: list[Fault] = []
    operators = _list(scenario, "operators")
    if operators is not None:
        if not operators:
            faults.append(Fault("operators", "none", "at least one operator", "A scenario needs a fleet."))
        faults += _twice("operators", operators, "id", "an id that no other operator has")
        for index, operator in enumerate(operators):
            faults += _fleet_faults(f"operators.{index}", operator)
    if not isinstance(scenario, Mapping):
        faults += _rule_faults(scenario)
    return faults


def _fleet_faults(where: str, operator: Any) -> Iterator[Fault]:
    vehicles = _list(operator, "vehicles")
    if vehicles is None:
        return
    here = f"{where}.vehicles"
    if not vehicles:
        yield Fault(here, "none", "at least one vehicle", "An operator needs a fleet.")
    if len(vehicles) > MAX_VEHICLES:
        yield Fault(
            here,
            f"{len(vehicles)} vehicles",
            f"at most {MAX_VEHICLES}, because MAVLink's system id is 8 bits",
            "Share them among several operators.",
        )
    yield from _twice(here, vehicles, "id", "an id that no other vehicle of this operator has")
    if len(vehicles) <= MAX_VEHICLES:
        yield from _twice(here, vehicles, "system_id", "a system id that no other vehicle of this operator has")
    for index, vehicle in enumerate(vehicles):
        if _get(vehicle, "placing") == "clear" and _get(_get(vehicle, "plan"), "anchor") == "file":
            yield Fault(
                f"{here}.{index}.placing",
                "clear",
                "exact, because the mission file is anchored where it was drawn",
                'Set plan.anchor = "start" to let it be shifted.',
            )


def _rule_faults(scenario: Any) -> Iterator[Fault]:
    names = link_names(scenario.operators)
    for index, rule in enumerate(scenario.links):
        if not any(fnmatchcase(name, rule.match) for name in names):
            hint = nearest(rule.match, names) or f"A link's name is like {names[-1]!r}." if names else ""
            yield Fault(f"links.{index}.match", rule.match, "a name or pattern that some link matches", hint)


def _twice(where: str, parts: Sequence[Any], key: str, expected: str) -> Iterator[Fault]:
    seen: dict[Any, int] = {}
    for index, part in enumerate(parts):
        value = _get(part, key)
        if not isinstance(value, (str, int)) or value in ("", 0):
            continue
        first = seen.setdefault(value, index)
        if first != index:
            shown = value if isinstance(value, str) else repr(value)
            yield Fault(f"{where}.{index}.{key}", shown, expected, f"{where}.{first} has it already.")


def _list(part: Any, key: str) -> Sequence[Any] | None:
    value = _get(part, key)
    return value if isinstance(value, (list, tuple)) else None


def _get(part: Any, key: str) -> Any:
    return part.get(key) if isinstance(part, Mapping) else getattr(part, key, None)
