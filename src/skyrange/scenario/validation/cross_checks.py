"""Cross-checks of a scenario: there are aircraft, names are unique, and every rule matches a link or an endpoint.

The checks accept models and raw tables, so that they also work on a file in which other values are invalid.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from typing import Any

from skyrange.core.errors import Problem, nearest
from skyrange.core.ids import vehicle_id
from skyrange.scenario.model.attacks import check_act_vehicles
from skyrange.scenario.model.fleet import MAX_SYSTEM_ID
from skyrange.scenario.model.links import endpoint_names, find_matches, link_names
from skyrange.scenario.model.manual_acts import find_manual_problems
from skyrange.scenario.model.operators import Operator

_NONE: tuple[Any, ...] = (None, (), [])


def cross_check(scenario: Any) -> list[Problem]:
    """All problems between the parts of a Scenario, or of the table from which it is built.

    In a table, only the checks run that do not depend on validated values.
    """
    problems: list[Problem] = []
    operators = _list(scenario, "operators")
    if operators is not None:
        if not operators:
            problems.append(Problem("operators", "none", "at least one operator", "Add a table [[operators]]."))
        problems += _twice("operators", operators, "id", "an id that no other operator has")
        for index, operator in enumerate(operators):
            problems += _find_fleet_problems(f"operators.{index}", operator)
    attacks = _list(scenario, "attacks") or ()
    problems += _twice("attacks", attacks, "id", "an id that no other attack has")
    problems += _find_shared_ids(attacks, _list(scenario, "faults") or ())
    constraints = _list(scenario, "constraints") or ()
    problems += _twice("constraints", constraints, "id", "an id that no other constraint has")
    detectors = _list(scenario, "detectors") or ()
    problems += _twice("detectors", detectors, "id", "an id that no other detector has")
    problems += _defence_ids(scenario, detectors)
    if not isinstance(scenario, Mapping):
        problems += _find_rule_problems(scenario)
        problems += _find_processing_problems(scenario)
        problems += _find_authentication_problems(scenario)
        problems += _find_signing_problems(scenario)
        vehicles = [vehicle_id(o.id, v.id) for o, v in scenario.fleet]
        problems += check_act_vehicles("attacks", scenario.attacks, vehicles)
        problems += check_act_vehicles("faults", scenario.faults, vehicles)
        problems += find_manual_problems(scenario.manual_acts, scenario.acting)
    return problems


def _find_shared_ids(attacks: Sequence[Any], declared: Sequence[Any]) -> Iterator[Problem]:
    """Ids of benign faults that another fault or an attack has."""
    yield from _twice("faults", declared, "id", "an id that no other fault has")
    taken = [_get(attack, "id") for attack in attacks]
    for index, fault in enumerate(declared):
        id_ = _get(fault, "id")
        if isinstance(id_, str) and id_ and id_ in taken:
            hint = f"attacks.{taken.index(id_)} already has it."
            yield Problem(f"faults.{index}.id", id_, "an id that no attack has", hint)


def _defence_ids(scenario: Any, detectors: Sequence[Any]) -> Iterator[Problem]:
    """Ids of defences that another defence, an attack, a fault or a detector has: all of them share tables."""
    declared = _list(scenario, "defences") or ()
    yield from _twice("defences", declared, "id", "an id that no other defence has")
    others = {"attacks": _list(scenario, "attacks") or (), "faults": _list(scenario, "faults") or ()}
    for where, parts in (*others.items(), ("detectors", detectors)):
        taken = [_get(part, "id") for part in parts]
        for index, defence in enumerate(declared):
            id_ = _get(defence, "id")
            if isinstance(id_, str) and id_ and id_ in taken:
                expected = "an id that no attack, fault or detector has"
                yield Problem(f"defences.{index}.id", id_, expected, f"{where}.{taken.index(id_)} already has it.")


def _find_fleet_problems(where: str, operator: Any) -> Iterator[Problem]:
    here = f"{where}.vehicles"
    if isinstance(operator, (Mapping, Operator)) and all(
        _get(operator, key) in _NONE for key in ("vehicles", "fleets")
    ):
        yield Problem(here, "none", "at least one vehicle or fleet", "Add a table [[operators.vehicles]].")
    vehicles = _list(operator, "vehicles") or ()
    yield from _twice(here, vehicles, "id", "an id that no other vehicle of this operator has")
    yield from _addressed_twice(here, vehicles)
    for index, vehicle in enumerate(vehicles):
        sensors = _list(vehicle, "sensors") or ()
        yield from _twice(f"{here}.{index}.sensors", sensors, "id", "an id that no other sensor of this aircraft has")
        if _get(vehicle, "placing") == "clear" and _get(_get(vehicle, "plan"), "anchor") == "file":
            yield Problem(
                f"{here}.{index}.placing",
                "clear",
                "exact, because the mission file is anchored at its own coordinates",
                'Set plan.anchor = "start", so that the mission can be shifted.',
            )


def _addressed_twice(where: str, vehicles: Sequence[Any]) -> Iterator[Problem]:
    """Networks with two aircraft of one system id, and networks with more aircraft than there are system ids."""
    seen: dict[tuple[int, int], int] = {}
    full: set[int] = set()
    for index, vehicle in enumerate(vehicles):
        network, system_id = _get(vehicle, "network"), _get(vehicle, "system_id")
        network = network if isinstance(network, int) else 0
        if not isinstance(system_id, int) or system_id <= 0:
            continue
        if system_id > MAX_SYSTEM_ID:
            if network not in full and not isinstance(vehicle, Mapping):  # in a table, the model reports it
                expected = f"at most {MAX_SYSTEM_ID} aircraft in a network, because a MAVLink system id has 8 bits"
                hint = "Omit network; skyrange then adds networks as needed."
                yield Problem(f"{where}.{index}.network", f"{network}, which is full", expected, hint)
            full.add(network)
            continue
        first = seen.setdefault((network, system_id), index)
        if first != index:
            yield Problem(
                f"{where}.{index}.system_id",
                repr(system_id),
                f"a system id that no other vehicle of this operator has in network {network}",
                f"{where}.{first} already has it.",
            )


def _find_rule_problems(scenario: Any) -> Iterator[Problem]:
    names = link_names(scenario.operators, radio=scenario.radio is not None)
    for index, rule in enumerate(scenario.links):
        if not any(fnmatchcase(name, rule.match) for name in names):
            hint = nearest(rule.match, names) or f"An example of a link's name is {names[-1]!r}." if names else ""
            yield Problem(
                f"links.{index}.match", rule.match, "the name of a link, or a pattern that matches a link", hint
            )


def _find_processing_problems(scenario: Any) -> Iterator[Problem]:
    """Tables that match no endpoint, and endpoints that two tables match."""
    names = list(endpoint_names(scenario.operators)) if scenario.processing else []
    taken: dict[str, int] = {}
    for index, table in enumerate(scenario.processing):
        where, matches = f"processing.{index}.match", find_matches(table, names)
        if not matches:
            hint = nearest(table.match, names) or f"An example of an endpoint is {names[-1]!r}."
            yield Problem(where, table.match, "the name of an endpoint, or a pattern that matches an endpoint", hint)
        twice = next((name for name in matches if name in taken), None)
        if twice is not None:
            hint = f"processing.{taken[twice]} already limits {twice}."
            yield Problem(where, table.match, "endpoints that no other table matches", hint)
        for name in matches:
            taken.setdefault(name, index)


_FIRST_SIGNING = datetime(2019, 1, 2, tzinfo=UTC)
_LAST_SIGNING = datetime(2154, 1, 1, tzinfo=UTC)
"""Times in signatures count seconds from 2019 in 32 bits; endorsements begin an hour before the run."""


def _find_authentication_problems(scenario: Any) -> Iterator[Problem]:
    """Aircraft that sign or verify Remote ID without a radio medium, or at a time that signatures cannot have."""
    needs = False
    for row, operator in enumerate(scenario.operators):
        for place, vehicle in enumerate(operator.vehicles):
            remote_id = vehicle.remote_id
            if remote_id is None or (remote_id.auth == "none" and remote_id.verify is None):
                continue
            needs = True
            if scenario.radio is None:
                key, given = ("auth", remote_id.auth) if remote_id.auth != "none" else ("verify", "drip")
                where = f"operators.{row}.vehicles.{place}.remote_id.{key}"
                yield Problem(where, given, "a radio medium, which carries Remote ID", "Add a table [radio].")
    if scenario.radio is not None:
        needs |= any(receiver.verify is not None for receiver in scenario.radio.receivers)
    verifying = [
        (row, defence.settings) for row, defence in enumerate(scenario.defences) if defence.kind == "remote_id.drip"
    ]
    needs |= bool(verifying)
    settings = {vehicle_id(o.id, v.id) for o, v in scenario.fleet if v.remote_id is not None and v.remote_id.verify}
    for row, params in verifying:
        twice = sorted(settings.intersection(params.vehicles or settings))
        if twice and not scenario.defences[row].muted:
            expected = "aircraft without remote_id.verify, which verifies too"
            hint = "Remove verify from remote_id, or name other aircraft."
            yield Problem(f"defences.{row}.params.vehicles", ", ".join(twice), expected, hint)
    if needs and not _FIRST_SIGNING <= scenario.start_utc <= _LAST_SIGNING:
        value = scenario.start_utc.isoformat()
        yield Problem("start_utc", value, "a time from 2019-01-02 to 2154, because DRIP's times start in 2019")


_FIRST_TIMESTAMP = datetime(2015, 1, 1, tzinfo=UTC)
"""Timestamps of MAVLink signatures count from here (https://mavlink.io/en/guide/message_signing.html)."""


def _find_signing_problems(scenario: Any) -> Iterator[Problem]:
    """A problem for MAVLink signatures at a time before their first timestamp, where all would have the same."""
    signs = any(operator.signing != "off" for operator in scenario.operators)
    signs |= any(table.kind == "mavlink.signing" for table in scenario.defences)
    if signs and scenario.start_utc < _FIRST_TIMESTAMP:
        value = scenario.start_utc.isoformat()
        yield Problem("start_utc", value, "2015-01-01 or later, because timestamps of MAVLink signatures start there")


def _twice(where: str, parts: Sequence[Any], key: str, expected: str) -> Iterator[Problem]:
    seen: dict[Any, int] = {}
    for index, part in enumerate(parts):
        value = _get(part, key)
        if not isinstance(value, (str, int)) or value in ("", 0):
            continue
        first = seen.setdefault(value, index)
        if first != index:
            shown = value if isinstance(value, str) else repr(value)
            yield Problem(f"{where}.{index}.{key}", shown, expected, f"{where}.{first} already has it.")


def _list(part: Any, key: str) -> Sequence[Any] | None:
    value = _get(part, key)
    return value if isinstance(value, (list, tuple)) else None


def _get(part: Any, key: str) -> Any:
    return part.get(key) if isinstance(part, Mapping) else getattr(part, key, None)
