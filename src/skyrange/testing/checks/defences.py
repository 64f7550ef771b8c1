"""Conformance checks of defences, by flights: without the defence, muted, nominal, under attack, and forked."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from skyrange.assembly.build import build
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S, from_seconds
from skyrange.defence.contract import DefencePlugin
from skyrange.kernel import Kernel
from skyrange.record import MemoryObserver
from skyrange.scenario.model.attacks import AttackTable
from skyrange.scenario.model.defences import DefenceTable
from skyrange.scenario.model.scenario import Scenario
from skyrange.testing.checks.attacks import Flight as AttackFlight
from skyrange.testing.checks.attacks import Row, SharedScenario, Trunk, fly_nominal, two_squares
from skyrange.testing.rules import Broken, RuleBook, need, same

ID = "checked"
"""The defence's id while it is checked."""

DEFENCE: RuleBook[DefenceCase] = RuleBook("defence")


@dataclass
class Flight(AttackFlight):
    """What one run showed, the events of the kernel included."""

    def notes(self) -> list[Row]:
        """What was noted."""
        return [(n.time_ns, n.source, n.note.kind, n.note.about, str(n.note.data)) for n in self.seen.notes]

    def acts(self) -> list[str]:
        """The actions of the defence, in order."""
        return [str(n.note.data["action"]) for n in self.seen.notes if n.note.kind == "event.defence_act"]

    def alerts(self) -> list[Row]:
        """Every alert."""
        return [(row.time_ns, row.detector, *row.alert) for row in self.seen.alerts]

    def same_as(self, other: Flight, what: str) -> None:
        """`Broken` where two flights differ in a byte."""
        for name in ("frames", "truth", "notes", "alerts"):
            same(getattr(self, name)(), getattr(other, name)(), f"{name} of {what}", "the same to the byte")


@dataclass
class DefenceCase:
    """A defence to be checked: its kind and parameters, on which scenario, and the attack that it is to notice."""

    kind: DefencePlugin
    name: str
    params: Mapping[str, Any]
    scenario: Scenario
    attack: Mapping[str, Any]
    acts: bool | Collection[str]
    alerts: bool
    _flown: dict[str, Flight] = field(default_factory=dict)

    def declared(self, *, attacked: bool = True, present: bool = True, muted: bool = False) -> Scenario:
        """The scenario with or without the attack and the defence."""
        table = DefenceTable(id=ID, kind=self.name, muted=muted, params=dict(self.params))
        attack = AttackTable.model_validate({"id": "foe", **self.attack})
        update = {"defences": (table,) if present else (), "attacks": (attack,) if attacked else ()}
        return self.scenario.model_copy(update=update)

    def kernel(self, **how: bool) -> tuple[Kernel, Flight]:
        """A run before its first instant."""
        observer = MemoryObserver()
        try:
            wiring = build(self.declared(**how)).wiring
        except InputError:
            raise
        except Exception as error:
            raise Broken(f"raised {error!r} when it was made", "a Defence", "makes") from error
        return Kernel(wiring, [observer]), Flight(observer, frozenset())

    @property
    def nominal(self) -> Flight:
        """The run without attack and defence, which all cases on one scenario share."""
        return Flight(fly_nominal(SharedScenario(self.scenario)).seen, frozenset())

    @cached_property
    def trunk(self) -> Trunk:
        """A fresh run under attack, which is forked half way."""
        kernel, flight = self.kernel()
        until = from_seconds(self.scenario.duration_s)
        return Trunk.fly(kernel, flight, until // 2 + NS_PER_S // 7, until)

    def fly(self, **how: bool) -> Flight:
        """A whole run; each kind is flown once."""
        name = str(sorted(how.items()))
        if name not in self._flown:
            kernel, flight = self.kernel(**how)
            kernel.advance(from_seconds(self.scenario.duration_s))
            kernel.finish()
            self._flown[name] = flight
        return self._flown[name]


def check_defence(
    name: str,
    params: Mapping[str, Any],
    attack: Mapping[str, Any],
    *,
    scenario: Callable[[float], Scenario] = two_squares,
    duration_s: float = 12.0,
    acts: bool | Collection[str] = True,
    alerts: bool = True,
) -> None:
    """Check that defences of the kind `name`, which is registered, keep every rule of `DEFENCE` with `params`.

    It is run on `scenario(duration_s)`, by default two aircraft, `blue/b1` and `green/g1`, which arm about 3 s after
    the start and then fly squares; with `attack`, a table of `[[attacks]]` without its id, and without. `acts` says
    what the defence does about the attack: something (True), perhaps nothing (False), or exactly these of drop, delay,
    replace, inject, sensor, channel, scan and hop. `alerts` says whether it raises an alarm.

    Raises `NonConformance` at the first broken rule.
    """
    kind = DefencePlugin.find(name)
    case = DefenceCase(kind, name, params, scenario(duration_s), attack, acts, alerts)
    DEFENCE.check(f"defence {name}", case)


@DEFENCE.rule(
    "described", "Describes each parameter, its place, effect, evasion and cost, and in one sentence what it does."
)
def _described(case: DefenceCase) -> None:
    for name, info in case.kind.params.model_fields.items():
        need(bool(info.description), f"says nothing about its parameter {name}", "a description of each")
    need(case.kind.about.endswith("."), f"says {case.kind.about!r}", "a sentence")
    for what in ("surface", "place", "effect", "against", "evasion", "cost"):
        need(bool(getattr(case.kind, what)), f"does not say its {what}", "a phrase")


@DEFENCE.rule("defaults", "Can be declared with default parameters, or the given ones, alone.")
def _defaults(case: DefenceCase) -> None:
    missing = [name for name, info in case.kind.params.model_fields.items() if info.is_required()]
    need(not missing, f"requires {', '.join(missing)}", "a default of each parameter")


@DEFENCE.rule("muted", "If muted, changes no frame, note, truth or alert, attacked or not.")
def _muted(case: DefenceCase) -> None:
    for attacked in (False, True):
        without = case.fly(present=False) if attacked else case.nominal
        without.same_as(case.fly(attacked=attacked, muted=True), "the run without it and of that with it muted")


@DEFENCE.rule("nominal", "Without an attack, does only what it declares as `nominal`, and raises no alarm.")
def _nominal(case: DefenceCase) -> None:
    flight = case.fly(attacked=False)
    same([], [row[3:5] for row in flight.alerts()], "alerts without an attack", "none")
    others = sorted(set(flight.acts()) - set(case.kind.nominal))
    need(not others, f"did {', '.join(others)} without an attack", "what its kind declares as nominal")
    if not flight.acts():
        without = case.nominal
        same(without.frames(), flight.frames(), "frames without it and with it, nominal", "the same to the byte")
        same(without.truth(), flight.truth(), "truth without it and with it, nominal", "the same to the byte")


@DEFENCE.rule("acts", "Acts and raises alarms when it is attacked, as the case says, and writes no label.")
def _acts(case: DefenceCase) -> None:
    flight = case.fly()
    acts = set(flight.acts()) - set(case.kind.nominal)
    need(bool(acts) or not case.acts, "did nothing about the attack", "an act")
    if not isinstance(case.acts, bool):
        need(acts == set(case.acts), f"did {', '.join(sorted(acts))}", ", ".join(sorted(case.acts)))
    alerts = flight.alerts()
    need(bool(alerts) or not case.alerts, "raised no alarm", "an alert")
    for alert in alerts:
        need(alert[1] == ID, f"raised an alert in the name of {alert[1]}", "its own id")
        need(alert[4] in case.kind.alerts, f"raised {alert[4]!r}", f"one of {', '.join(case.kind.alerts)}")
    labels = [label for label in flight.seen.labels if label.attack == ID]
    need(not labels, f"has {len(labels)} labels", "none: labels are of attacks and faults")


@DEFENCE.rule("repeatable", "Does the same in two new runs of one process, one of them beside a fork of it.")
def _repeatable(case: DefenceCase) -> None:
    case.fly().same_as(Flight(case.trunk.flight.seen, frozenset()), "a run alone and one beside another")


@DEFENCE.rule("copies", "A copy or fork made midway continues like the original, and shares no state with it.")
def _copies(case: DefenceCase) -> None:
    case.fly().same_as(Flight(case.trunk.fork().seen, frozenset()), "the straight run and the fork")
