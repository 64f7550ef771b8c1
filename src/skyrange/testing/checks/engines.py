"""Conformance check of autopilot engines (`skyrange.contracts.components.Engine`)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from skyrange.contracts.components import (
    ENGINE_MEMBERS,
    Engine,
    Finished,
    InstanceStatus,
    SimulatorEngine,
    Source,
    World,
)
from skyrange.core.chance import Chance
from skyrange.core.errors import ComponentError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import Port, owner_of
from skyrange.core.time import NS_PER_MS, NS_PER_S, Epoch, Time
from skyrange.testing.drivers.agent_driver import copied
from skyrange.testing.drivers.engine_driver import CHANCE, EPOCH, FLEET, ORIGIN, Factory, Flight, open_field, take_off
from skyrange.testing.drivers.hostile_input import (
    Volume,
    address_to_ports,
    check_modest,
    forged,
    garbage,
    short_garbage,
    spoiled,
)
from skyrange.testing.drivers.messages import InputMessage, make_arrivals
from skyrange.testing.drivers.outbox_form import Said, check_causes, check_departures, check_notes
from skyrange.testing.drivers.purity import watched
from skyrange.testing.rules import Broken, RuleBook, need, same, short
from skyrange.vehicle.contract import AutopilotContext, AutopilotPlugin, VehicleSpec

ENGINE: RuleBook[EngineCase] = RuleBook("engine")


@dataclass
class EngineCase:
    """An engine to be checked: its factory, its aircraft, their world and mail, how long it is flown."""

    factory: Factory
    specs: Sequence[VehicleSpec]
    world: Callable[[Sequence[VehicleSpec]], World]
    messages: Sequence[InputMessage] | None
    until: Time
    _cut: dict[int, Flight] = field(default_factory=dict)

    def make(self, specs: Sequence[VehicleSpec] | None = None, name: str = "checked") -> Engine:
        """A fresh engine for some of the aircraft, or for all."""
        return self.factory(name, list(self.specs if specs is None else specs), ORIGIN, EPOCH, CHANCE)

    @cached_property
    def friendly(self) -> list[InputMessage]:
        """The friendly mail."""
        return take_off(self.make().ports, self.specs) if self.messages is None else list(self.messages)

    @cached_property
    def repeats(self) -> bool:
        """Whether the engine says that it repeats to the byte."""
        return self.make().repeatable == "bytes"

    @cached_property
    def runs_programs(self) -> bool:
        """Whether it starts programs: these need sockets and files, and cannot be copied."""
        return self.make().runs_programs

    def flight(self, cut: int = 0, hostile: Sequence[InputMessage] = ()) -> Flight:
        """A fresh engine (two, if the fleet is `cut` before that row) before its first tick."""
        parts = [self.specs[:cut], self.specs[cut:]] if cut else [self.specs]
        engines = [self.make(part, f"checked {number}") for number, part in enumerate(parts)]
        return Flight(engines, self.world(self.specs), make_arrivals([*self.friendly, *hostile]))

    @cached_property
    def plain(self) -> PlainFlight:
        """The flight with friendly mail alone, which most rules look at."""
        return PlainFlight.fly(self)

    def flown(self, cut: int = 0) -> Flight:
        """A whole flight with friendly mail alone; one for each cut, read only."""
        if cut not in self._cut:
            self._cut[cut] = _ended(self.flight(cut).fly(self.until)) if cut else self.plain.flight
        return self._cut[cut]

    def fly_with_payloads(self, payloads: Sequence[bytes]) -> Flight:
        """A flight with hostile payloads on every port."""
        begin = self.until // 10
        spacing = max(NS_PER_MS, (self.until - 2 * begin) // (len(payloads) // 16 + 1))
        return self.flight(hostile=address_to_ports(payloads, self.make().ports, begin, spacing, 16))


@dataclass
class PlainFlight:
    """A flight with friendly mail alone, and what is wrong with what the engine handed back, by rule."""

    flight: Flight
    shapes: set[tuple[int, ...]] = field(default_factory=set)
    """Of the actuators."""
    broken: dict[str, Broken] = field(default_factory=dict)
    """The first of each rule."""

    @classmethod
    def fly(cls, case: EngineCase) -> PlainFlight:
        """Fly a case's aircraft. Raises `Broken` for what ends the flight."""
        made = cls(case.flight())
        made.flight.fly(case.until, look=made._look)
        _ended(made.flight)
        return made

    def keeps(self, rule: str) -> None:
        """Raise `Broken` if it broke the rule."""
        if rule in self.broken:
            raise self.broken[rule]

    def _look(self, engine: Engine, finished: Finished, contents: Said) -> None:
        self.shapes.add(finished.actuators.shape)
        checks: dict[str, Callable[[], None]] = {
            "departures": lambda: check_departures(contents, tuple(engine.ports)),
            "notes": lambda: _check_notes(engine, finished, contents),
            "causes": lambda: check_causes(contents, self.flight.received),
        }
        for rule, check in checks.items():
            try:
                check()
            except Broken as broken:
                self.broken.setdefault(rule if broken.rule is None else broken.rule, broken)


def _ended(flight: Flight) -> Flight:
    """A flight that is only read from now on: its engines are closed, so that others can have what they held."""
    for engine in flight.engines:
        engine.close()
    return flight


def check_engine(
    engine: AutopilotPlugin | Factory,
    params: Mapping[str, Any] | None = None,
    *,
    specs: Sequence[VehicleSpec] = FLEET,
    world: Callable[[Sequence[VehicleSpec]], World] = open_field,
    mail: Sequence[InputMessage] | None = None,
    until: Time = 5 * NS_PER_S,
    name: str | None = None,
) -> None:
    """Check that the engines of a plugin with `params`, or those that a function makes, keep every rule of `ENGINE`.

    Engines are made for some or all of `specs` (two or more, or `split` shows nothing); a function is called with a
    name, specs, an origin, an epoch and chance. `world(specs)` makes the world they fly in, for `until` ns. `mail` is
    what a friendly peer would send; by default that of `take_off`. Of an engine that does not repeat to the byte,
    nothing is asked that compares two runs, nor `pure`. Raises `NonConformance` at the first broken rule; `name`
    stands in it for the engine's class.
    """
    if not isinstance(engine, AutopilotPlugin):
        who = name or getattr(engine, "__name__", type(engine).__name__)
        ENGINE.check(f"engine {who}", EngineCase(engine, specs, world, mail, until))
        return
    plugin, settings = engine, engine.params.model_validate(dict(params or {}))

    def make(name: str, specs: Sequence[VehicleSpec], origin: Origin, epoch: Epoch, chance: Chance) -> Engine:
        return plugin(settings, AutopilotContext(name, specs, origin, epoch, chance))

    case = EngineCase(make, specs, world, mail, until)
    ENGINE.check(f"engine {name or type(case.make()).__name__}", case)


@ENGINE.rule(
    "declares",
    "Has every member of Engine: a name, a clock (and a pace, if that is the wall's), a repeatability, "
    "and a pre-roll of at least 0 ns. Moves its own vehicles alone.",
)
def _declares(case: EngineCase) -> None:
    engine = case.make()
    for member in ENGINE_MEMBERS:
        need(hasattr(engine, member), f"has no {member}", "every member of Engine; EngineBase has most of them")
    need(isinstance(engine.name, str) and bool(engine.name), f"name is {engine.name!r}", "text")
    need(engine.clock in ("lockstep", "wall"), f"clock is {engine.clock!r}", "lockstep or wall")
    need(engine.repeatable in ("bytes", "outcome"), f"repeatable is {engine.repeatable!r}", "bytes or outcome")
    preroll = engine.preroll_ns
    need(isinstance(preroll, int) and preroll >= 0, f"preroll_ns is {preroll!r}", "an int of 0 or more nanoseconds")
    if engine.clock == "wall":
        pace = engine.pace if hasattr(engine, "pace") else None
        need(isinstance(pace, float) and pace > 0.0, f"pace is {pace!r}", "a float above 0, as its clock is wall")
    simulator = engine.source is Source.SIMULATOR
    need(
        simulator == isinstance(engine, SimulatorEngine),
        f"source is {str(engine.source)!r}, with{'' if hasattr(engine, 'set_body_inputs') else 'out'} set_body_inputs",
        "set_body_inputs where the source is simulator, and only there",
    )
    strange = [vehicle for vehicle in engine.moves if vehicle not in engine.vehicles]
    need(not strange, f"moves {strange}", "vehicles of its own")


@ENGINE.rule("vehicles", "Lists the vehicles that it was made for, in that order, and each of their ports once.")
def _vehicles(case: EngineCase) -> None:
    for specs in filter(None, (case.specs, case.specs[1:], case.specs[:1])):
        engine = case.make(specs)
        vehicles, ports = list(engine.vehicles), tuple(engine.ports)
        wanted = [spec.vehicle for spec in specs]
        need(vehicles == wanted, f"vehicles are {vehicles}", f"{wanted}")
        need(all(isinstance(port, Port) for port in ports), f"ports are {short(ports)}", "a sequence of Port")
        need(len(set(ports)) == len(ports), f"ports are {short(ports)}", "each port once")
        owners = {owner_of(port.endpoint) for port in ports}
        need(owners == set(wanted), f"ports belong to {sorted(owners)}", "at least one port of each vehicle, no other")


@ENGINE.rule("service", "Serves its ports at a whole multiple of the world's quantum.")
def _service(case: EngineCase) -> None:
    service, quantum = case.make().service_ns, case.world(case.specs).quantum_ns
    whole = isinstance(service, int) and service > 0 and service % quantum == 0
    need(whole, f"service_ns is {service!r}", f"a multiple of the quantum, {quantum} ns")


@ENGINE.rule("finishes", "Answers every tick with a Finished that has an Outbox.")
def _finishes(case: EngineCase) -> None:
    _ = case.plain


@ENGINE.rule("outbox", "Gives departures and notes as lists, never as a generator.")
def _outbox(case: EngineCase) -> None:
    case.plain.keeps("outbox")


@ENGINE.rule(
    "actuators", "Commands motors by a float64 row per vehicle, of constant length, with finite numbers from 0 to 1."
)
def _actuators(case: EngineCase) -> None:
    shapes = case.plain.shapes
    need(len(shapes) == 1, f"actuators had the shapes {sorted(shapes)}", "one shape")


@ENGINE.rule("poses", "Imposes possible poses only, and only on vehicles that it declares to move.")
def _poses(case: EngineCase) -> None:
    case.plain.keeps("poses")


@ENGINE.rule(
    "status",
    "Reports the state of each vehicle (booting, ready, silent, dead). All are ready after its pre-roll.",
)
def _status(case: EngineCase) -> None:
    flight = case.flight().fly(0)
    lost = (InstanceStatus.SILENT, InstanceStatus.DEAD)
    for vehicle, ticks in flight.ticks.items():
        lost_ticks = [tick for tick in ticks if tick.status in lost]
        need(
            not lost_ticks,
            f"{vehicle} is {lost_ticks[0].status if lost_ticks else None} in fair weather",
            "an answer at every tick",
        )
        need(
            ticks[-1].status is InstanceStatus.READY,
            f"{vehicle} is {ticks[-1].status} at 0",
            "ready after the pre-roll",
        )


@ENGINE.rule("departures", "Sends bytes, at most 1 MiB in a frame, from its declared ports.")
def _departures(case: EngineCase) -> None:
    case.plain.keeps("departures")


@ENGINE.rule(
    "notes",
    "Notes `decision.…` or `event.…` about its vehicles, with finite scalars and texts of at most 4096 characters.",
)
def _notes(case: EngineCase) -> None:
    case.plain.keeps("notes")


@ENGINE.rule("causes", "Names as causes only frames that it received.")
def _causes(case: EngineCase) -> None:
    case.plain.keeps("causes")


@ENGINE.rule("repeatable", "If declared: the same mail and sensor readings give the same bytes.")
def _repeatable(case: EngineCase) -> None:
    if case.repeats:
        _same(case.flown(), case.flight().fly(case.until), "two instances differ", "the same from the same inputs")


@ENGINE.rule("split", "Does the same for each aircraft whether one engine or two have the fleet.")
def _split(case: EngineCase) -> None:
    if case.repeats:
        for cut in sorted({1, len(case.specs) // 2} - {0, len(case.specs)}):
            _same(
                case.flown(),
                case.flown(cut),
                f"in one engine and split before row {cut}",
                "the same bytes for each aircraft",
            )


@ENGINE.rule("order", "Separates begin and finish: engines may finish in any order after all have begun.")
def _order(case: EngineCase) -> None:
    cut = len(case.specs) // 2
    forward, backward = case.flown(cut), case.flight(cut).fly(case.until, backwards=True)
    if case.repeats:
        _same(forward, backward, "finishing in the other order changes it", "engines that share nothing")


@ENGINE.rule("sensors", "Reads the sensors of a tick only until it has finished the tick, and never writes to them.")
def _sensors(case: EngineCase) -> None:
    kept, spoilt = case.flown(), case.flight().fly(case.until, scramble=True)
    if case.repeats:
        _same(kept, spoilt, "what it does depends on sensors of an earlier tick", "copies of what is to be kept")


@ENGINE.rule(
    "pure",
    "Reads no clock, draws no random numbers of its own, never sleeps, and opens no file, socket or "
    "thread. Not checked of engines that run programs.",
)
def _pure(case: EngineCase) -> None:
    if case.repeats and not case.runs_programs:
        case.flown()  # what is imported or compiled at first use was so before it is watched
        case.flight().fly(case.until, call=watched)


@ENGINE.rule(
    "copies",
    "A deep copy made midway continues like the original, and shares no state with it. An engine that "
    "runs programs refuses to be copied.",
)
def _copies(case: EngineCase) -> None:
    if case.runs_programs:
        _refuses_copies(case.make())
        return
    if not case.repeats:
        return
    straight = case.flown()
    trunk = case.flight().fly(case.until // 2)
    branch = copied(trunk)
    expected = "a copy that goes on alike, and an original that does not notice"
    _same(straight, branch.fly(case.until), "the straight run and the copy differ", expected)
    _same(straight, trunk.fly(case.until), "the copy's life shows in the original", expected)


@ENGINE.rule("hostile", "Survives any bytes on any port, and keeps its form.")
def _hostile(case: EngineCase) -> None:
    systems = sorted({0, *(spec.system_id for spec in case.specs)})
    for payloads in ([*garbage(), *spoiled(case.friendly)], list(forged(systems))):
        flight = case.fly_with_payloads(payloads)

        def look(engine: Engine, finished: Finished, contents: Said, flight: Flight = flight) -> None:
            check_departures(contents, tuple(engine.ports))
            _check_notes(engine, finished, contents)
            check_causes(contents, flight.received)

        flight.fly(case.until, look=look)


@ENGINE.rule("modest", "Answers each frame of garbage with at most 1 departure, at most 2 KiB longer, and 1 note.")
def _modest(case: EngineCase) -> None:
    payloads, ports = short_garbage(), case.make().ports
    quiet, loud = case.flown(), case.fly_with_payloads(payloads).fly(case.until)
    check_modest(_volume(quiet), _volume(loud), payloads, len(ports))


def _refuses_copies(engine: Engine) -> None:
    try:
        deepcopy(engine)
    except ComponentError:
        return
    raise Broken("its copy was made", "a ComponentError: what runs outside cannot be copied")


def _check_notes(engine: Engine, finished: Finished, contents: Said) -> None:
    check_notes(contents)
    for note in contents[1]:
        need(note.about in engine.vehicles, f"{note.kind} is about {note.about!r}", "one of its vehicles")


def _same(first: Flight, second: Flight, what: str, expected: str) -> None:
    for vehicle, ticks in first.ticks.items():
        same(ticks, second.ticks[vehicle], f"{vehicle}: {what}", expected)


def _volume(flight: Flight) -> Volume:
    """Departures, notes, bytes."""
    ticks = [tick for some in flight.ticks.values() for tick in some]
    departures = [departure for tick in ticks for departure in tick.departures]
    return len(departures), sum(len(tick.notes) for tick in ticks), sum(len(d.payload) for d in departures)
