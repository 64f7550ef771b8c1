"""Conformance checks of attacks and faults, by flights: without the attack, muted, live, as a sham, and forked."""

from __future__ import annotations

import copy
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import Any

from skyrange.assembly.acts.attacks import make_attack_context
from skyrange.assembly.build import Additions, build
from skyrange.attack.contract import Attack, AttackPlugin
from skyrange.attack.declaration import Acting
from skyrange.contracts.links import Act, Schedule
from skyrange.contracts.plugins.form import plugin_of
from skyrange.core.errors import SkyrangeError
from skyrange.core.time import NEVER, NS_PER_S, Time, from_seconds
from skyrange.fault.contract import FaultPlugin
from skyrange.kernel import Kernel
from skyrange.record import MemoryObserver
from skyrange.scenario.model.scenario import Operator as Owner
from skyrange.scenario.model.scenario import Origin, Scenario, Start, Vehicle, square
from skyrange.testing.rules import Broken, RuleBook, need, same, short

ID = "checked"
"""The attack's id while it is checked."""
TURN_NS = NS_PER_S // 2
"""How long a run and its fork fly by turns."""
Row = tuple[Any, ...]
ACTIONS = frozenset({"drop", "delay", "replace", "inject", "send", "sensor", "body", "scan"})
"""Kinds of acts, as in the table `labels`."""

ATTACK: RuleBook[AttackCase] = RuleBook("attack")
FAULT: RuleBook[AttackCase] = RuleBook("fault")
"""The same rules without that of the sham, which faults do not have, and one about the name."""


def two_squares(duration_s: float) -> Scenario:
    """Two aircraft of two operators that fly squares: what an attack is checked on, unless told otherwise."""
    fleets = {"blue": ("b1", Start()), "green": ("g1", Start(east_m=40.0))}
    operators = tuple(
        Owner(id=name, vehicles=(Vehicle(id=vehicle, start=start, plan=square(10, 8)),))
        for name, (vehicle, start) in fleets.items()
    )
    origin = Origin(lat=-35.363328, lon=149.1652241)
    return Scenario(name="checked", seed=7, duration_s=duration_s, origin=origin, operators=operators)


@dataclass
class Flight:
    """What one run showed, and whose links were the attack's own."""

    seen: MemoryObserver
    own: frozenset[str]

    def frames(self, *, include_own: bool = True) -> list[Row]:
        """Every frame in canonical order; without those on the attack's links where `include_own` is false."""
        return self._frames if include_own else [row for row in self._frames if row[1] not in self.own]

    @cached_property
    def _frames(self) -> list[Row]:
        rows = [
            (f.sent_ns, *f.id, f.src, f.dst, f.arrived_ns, str(f.fate), f.payload, f.parent, f.causes)
            for f in self.seen.frames
        ]
        return sorted(rows, key=lambda row: row[:5])

    def truth(self) -> list[Row]:
        """Every tick with the bits of its columns."""
        return self._truth

    @cached_property
    def _truth(self) -> list[Row]:
        return [(t.time_ns, *((name, values.tobytes()) for name, values in t.columns.items())) for t in self.seen.truth]

    def notes(self) -> list[Row]:
        """What was noted, but for the attack's beginning and end."""
        rows = [(n.time_ns, n.source, n.note.kind, n.note.about, str(n.note.data)) for n in self.seen.notes]
        return [row for row in rows if row[1] != "kernel"]

    def announced(self) -> list[str]:
        """The kinds of the notes about the attack's beginning and end."""
        return [n.note.kind for n in self.seen.notes if n.source == "kernel" and n.note.about == ID]

    def inputs(self, links: Collection[str]) -> list[Row]:
        """What others sent on some links, in canonical order: all that the attack can react to there."""
        acts = [label for label in self.seen.labels if label.action in ("inject", "send", "replace")]
        acted_on = {label.frame if label.child is None else label.child for label in acts}
        rows = [(f.sent_ns, *f.id, f.payload) for f in self.seen.frames if f.link in links and f.id not in acted_on]
        return sorted(rows)

    def labels(self) -> list[Row]:
        """Every act."""
        return [tuple(label) for label in self.seen.labels]


@dataclass
class AttackCase:
    """An attack to be checked: its kind and parameters, on which scenario, from when until when it acts."""

    kind: AttackPlugin | FaultPlugin
    params: Mapping[str, Any]
    scenario: Scenario
    start_ns: Time
    stop_ns: Time
    acts: bool | Collection[str]
    _flown: dict[str, Flight] = field(default_factory=dict)

    def made(self, *, sham: bool = False, honest: bool = False) -> tuple[Attack, Schedule]:
        """A fresh attack and its schedule."""
        built = build(self.scenario)
        schedule = Schedule()
        attack_context = make_attack_context(built.scenario, built.wiring.links, built.city)
        context = replace(attack_context, id=ID, schedule=schedule, sham=sham, honest=honest)
        try:
            attack = self.kind(self.kind.params.model_validate(dict(self.params)), context)
        except SkyrangeError:
            raise
        except Exception as error:
            raise Broken(f"raised {error!r} when it was made", "an Attack", "makes") from error
        need(isinstance(attack, Attack), f"made {short(attack)}", "an Attack")
        return attack, schedule

    def kernel(self, *, muted: bool = False, sham: bool = False) -> tuple[Kernel, Flight]:
        """A run before its first instant."""
        attack, schedule = self.made(sham=sham)
        plan = Act(
            ID, self.start_ns, self.stop_ns, muted, sham, attack.agents, attack.sensor_hooks, schedule=schedule,
            role="fault" if isinstance(self.kind, FaultPlugin) else "attack", body_hooks=attack.body_hooks,
            scan_hooks=attack.scan_hooks,
        )  # fmt: skip
        taps = [replace(tap, attack=ID) for tap in attack.taps]
        wiring = build(self.scenario, Additions(taps, [plan])).wiring
        wiring = replace(wiring, links=[*wiring.links, *attack.links])
        observer = MemoryObserver()
        return Kernel(wiring, [observer]), Flight(observer, frozenset(spec.name for spec in attack.links))

    def fly(self, **how: bool) -> Flight:
        """A whole run; each kind is flown once."""
        name = str(sorted(how.items()))
        if name not in self._flown:
            kernel, flight = self.kernel(**how)
            kernel.advance(from_seconds(self.scenario.duration_s))
            kernel.finish()
            self._flown[name] = flight
        return self._flown[name]

    @property
    def nominal(self) -> Flight:
        """The run without it, which all cases on one scenario share."""
        return fly_nominal(SharedScenario(self.scenario))

    @cached_property
    def trunk(self) -> Trunk:
        """A fresh run, which is forked half way between start and stop."""
        kernel, flight = self.kernel()
        fork_ns = (self.start_ns + self.stop_ns) // 2 + NS_PER_S // 7
        return Trunk.fly(kernel, flight, fork_ns, from_seconds(self.scenario.duration_s))


@dataclass(frozen=True)
class SharedScenario:
    """A scenario, equal to those that are written alike."""

    scenario: Scenario = field(compare=False)
    text: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "text", self.scenario.model_dump_json())


@lru_cache(maxsize=4)
def fly_nominal(shared: SharedScenario) -> Flight:
    """A whole run of a scenario as it is; the last few are kept."""
    flight = Flight(MemoryObserver(), frozenset())
    kernel = Kernel(build(shared.scenario).wiring, [flight.seen])
    kernel.advance(from_seconds(shared.scenario.duration_s))
    kernel.finish()
    return flight


@dataclass
class Trunk:
    """A run that was forked while it went on, and its fork, or the error of forking."""

    flight: Flight
    error: Exception | None
    _twin: tuple[Kernel, MemoryObserver] | None
    _until: Time

    @classmethod
    def fly(cls, kernel: Kernel, flight: Flight, fork_ns: Time, until: Time) -> Trunk:
        """Fork a run at `fork_ns`, and fly it and its fork by turns until `until`, each in the company of the other."""
        kernel.advance(fork_ns)
        twin, problem = None, None
        try:
            observer = copy.deepcopy(flight.seen)
            twin = kernel.fork([observer]), observer
        except Exception as error:
            problem = error
        for now in (*range(fork_ns, until, TURN_NS), until):
            kernel.advance(now)
            if twin is not None and now < until:
                twin[0].advance(now)
        kernel.finish()
        return cls(flight, problem, twin, until)

    def fork(self) -> Flight:
        """What the fork shows, whose last turn comes after the end of the run. Raises `Broken`."""
        if self._twin is None:
            expected = "state without generators, closures and handles"
            raise Broken(f"cannot be deep-copied: {self.error!r}", expected) from self.error
        kernel, observer = self._twin
        kernel.advance(self._until)
        kernel.finish()
        return Flight(observer, self.flight.own)


def check_attack(
    kind: type[Acting] | AttackPlugin,
    params: Mapping[str, Any],
    *,
    scenario: Callable[[float], Scenario] = two_squares,
    start_s: float = 3.0,
    stop_s: float = 7.0,
    duration_s: float | None = None,
    acts: bool | Collection[str] = True,
) -> None:
    """Check that attacks of `kind` with `params` keep every rule of `ATTACK`.

    The attack is active from `start_s` until `stop_s`, in seconds of simulated time. It is run on
    `scenario(duration_s)`, a scenario without attacks; by default two aircraft, `blue/b1` and `green/g1`, which arm
    about 3 s after the start and then fly squares. `duration_s` is by default 2 s longer than `stop_s`. `acts` says
    what the attack is expected to do in that time: something (True), perhaps nothing (False), or acts of exactly these
    kinds, of drop, delay, replace, inject, send, sensor, body and scan.

    Raises `NonConformance` at the first broken rule, and `ValueError` for times that are not in order and for an
    unknown kind of act.
    """
    plugin = plugin_of(kind)
    case = _case(
        "check_attack",
        plugin,
        params,
        scenario=scenario,
        start_s=start_s,
        stop_s=stop_s,
        duration_s=duration_s,
        acts=acts,
    )
    ATTACK.check(f"attack {plugin.params.__name__}", case)


def check_fault(
    kind: type[Acting] | FaultPlugin,
    params: Mapping[str, Any],
    *,
    scenario: Callable[[float], Scenario] = two_squares,
    start_s: float = 3.0,
    stop_s: float = 7.0,
    duration_s: float | None = None,
    acts: bool | Collection[str] = True,
) -> None:
    """Check that benign faults of `kind` with `params` keep every rule of `FAULT`.

    The arguments and errors are those of `check_attack`.
    """
    plugin = plugin_of(kind)
    case = _case(
        "check_fault",
        plugin,
        params,
        scenario=scenario,
        start_s=start_s,
        stop_s=stop_s,
        duration_s=duration_s,
        acts=acts,
    )
    FAULT.check(f"fault {plugin.params.__name__}", case)


def _case(
    who: str,
    kind: AttackPlugin | FaultPlugin,
    params: Mapping[str, Any],
    *,
    scenario: Callable[[float], Scenario],
    start_s: float,
    stop_s: float,
    duration_s: float | None,
    acts: bool | Collection[str],
) -> AttackCase:
    duration_s = stop_s + 2.0 if duration_s is None else duration_s
    if not 0.0 <= start_s < stop_s <= duration_s:
        given = f"start_s {start_s}, stop_s {stop_s}, duration_s {duration_s}"
        raise ValueError(f"{who}: {given}: expected 0 <= start_s < stop_s <= duration_s")
    if not isinstance(acts, bool) and (isinstance(acts, str) or not set(acts) <= ACTIONS):
        raise ValueError(f"{who}: acts {acts!r}: expected True, False or some of {', '.join(sorted(ACTIONS))}")
    times = from_seconds(start_s), from_seconds(stop_s)
    return AttackCase(kind, params, scenario(duration_s), *times, acts)


@ATTACK.rule("described", "Describes each of its parameters, and in one sentence what it does.")
def _described(case: AttackCase) -> None:
    for name, info in case.kind.params.model_fields.items():
        need(bool(info.description), f"says nothing about its parameter {name}", "a description of each")
    need(case.kind.about.endswith("."), f"says {case.kind.about!r}", "a sentence")


@ATTACK.rule("makes", "Makes an Attack from its parameters and a setting. Two attacks share nothing.")
def _makes(case: AttackCase) -> None:
    (first, _), (second, _) = case.made(), case.made()
    for first_agent, second_agent in zip(first.agents, second.agents, strict=True):
        need(first_agent is not second_agent, f"gave {first_agent.name} to two attacks", "agents of its own for each")


@ATTACK.rule("named", "Names its agents and links after its id.")
def _named(case: AttackCase) -> None:
    attack, _ = case.made()
    names = [agent.name for agent in attack.agents]
    names += [fault.name for faults in (attack.sensor_hooks, attack.body_hooks, attack.scan_hooks) for fault in faults]
    names += [spec.name.partition(":")[2] for spec in attack.links]
    for name in names:
        need(name == ID or name.startswith(f"{ID}."), f"is called {name!r}", f"{ID!r} or {ID + '.'!r} and more")


@ATTACK.rule("forces", "Has no body faults.")
def _forces(case: AttackCase) -> None:
    need(not case.made()[0].body_hooks, "has body faults", "agents, taps, sensor faults, links and radios")


@ATTACK.rule("muted", "If muted, changes no frame, note or truth, except on its own links.")
def _muted(case: AttackCase) -> None:
    nominal, muted = case.nominal, case.fly(muted=True)
    expected = "a run that is the same to the byte"
    same(nominal.frames(), muted.frames(include_own=False), "frames without it and with it muted", expected)
    same(nominal.truth(), muted.truth(), "truth without it and with it muted", expected)
    same(nominal.notes(), muted.notes(), "notes without it and with it muted", expected)
    same([], muted.labels(), "labels while it is muted", "none")


@ATTACK.rule("onset", "Before its start, changes nothing beyond what its muted twin does.")
def _onset(case: AttackCase) -> None:
    live, muted = case.fly(), case.fly(muted=True)
    for table, rows, muted_rows in (
        ("frames", live.frames(), muted.frames()),
        ("truth", live.truth(), muted.truth()),
        ("notes", live.notes(), muted.notes()),
    ):
        before, twin = ([row for row in table_rows if row[0] < case.start_ns] for table_rows in (rows, muted_rows))
        if table == "frames":  # fates may be met later
            before, twin = ([row[:7] + row[9:] for row in table_rows] for table_rows in (before, twin))
        same(twin, before, f"{table} before the onset, of the twin and of the attacked run", "the same to the byte")


@ATTACK.rule("acts", "Acts between its start and its stop, and not outside.")
def _acts(case: AttackCase) -> None:
    labels = case.fly().labels()
    need(bool(labels) or not case.acts, "did nothing", "an act between its start and its stop")
    if not isinstance(case.acts, bool):
        kinds = {str(label.action) for label in case.fly().seen.labels}
        need(kinds == set(case.acts), f"did {', '.join(sorted(kinds))}", ", ".join(sorted(case.acts)))
    for label in labels:
        need(case.start_ns <= label[0] < case.stop_ns, f"acted at {label[0]}", f"{case.start_ns}…{case.stop_ns}")


@ATTACK.rule("repeatable", "Does the same in two new runs of one process, one of them beside a fork of it.")
def _repeatable(case: AttackCase) -> None:
    _alike(case.fly(), case.trunk.flight, "a run alone and one beside another")


@ATTACK.rule("copies", "A copy or fork made midway continues like the original, and shares no state with it.")
def _copies(case: AttackCase) -> None:
    _alike(case.fly(), case.trunk.fork(), "the straight run and the fork")


@ATTACK.rule(
    "sham",
    "Its sham acts as often, at the same times, on the same links, with as many bytes, if it sees the same frames.",
)
def _sham(case: AttackCase) -> None:
    live, sham = case.fly(), case.fly(sham=True)
    until = _departure(live, sham)
    expected = "the same times, links and sizes as the attack itself"
    live_rows, sham_rows = ([row for row in _acted(table_rows) if row[0] < until] for table_rows in (live, sham))
    same(live_rows, sham_rows, "acts of the attack and of its sham", expected)


@ATTACK.rule(
    "silent",
    "If it alters sensor readings alone and its counterfactual is muted, its sham changes no frame and no truth.",
)
def _silent(case: AttackCase) -> None:
    assert isinstance(case.kind, AttackPlugin)
    attack, _ = case.made()
    silent = (attack.sensor_hooks or attack.scan_hooks) and not (attack.taps or attack.agents or attack.radios)
    if case.kind.counterfactual != "mute" or not silent:
        return
    nominal, sham = case.nominal, case.fly(sham=True)
    expected = "a run that is the same to the byte"
    same(nominal.frames(), sham.frames(), "frames without it and with its sham", expected)
    same(nominal.truth(), sham.truth(), "truth without it and with its sham", expected)


@ATTACK.rule(
    "honest",
    "An honest kind names the aircraft that it claims (`claims`; none if it is on somebody's link), with "
    "a radio for each in its honest arm. Other kinds name none.",
)
def _honest(case: AttackCase) -> None:
    assert isinstance(case.kind, AttackPlugin)
    claims = case.made()[0].claims
    if not case.kind.honest:
        need(not claims, f"claims {len(claims)} aircraft", "none, or AttackPlugin.honest = True")
        return
    attack, _ = case.made(honest=True)
    need(bool(claims) or bool(attack.taps), "claims no aircraft", "a ClaimedTrack for each that is not there")
    need(len(attack.claims) == len(claims), f"claims {len(attack.claims)}", f"{len(claims)}, as without the arm")
    tracks = [(claim.start_enu_m, claim.velocity_mps) for claim in attack.claims]
    same([(claim.start_enu_m, claim.velocity_mps) for claim in claims], tracks, "claimed tracks", "the same")
    radios = [claim.radio for claim in attack.claims]
    known = {radio.endpoint for radio in attack.radios}
    need(len(set(radios)) == len(radios) and set(radios) <= known, f"claims for {short(radios)}", "one radio for each")


def _departure(live: Flight, sham: Flight) -> Time:
    """When others first send something else on the links on which the attack acts, as a consequence of it."""
    links = {label.frame.link for flight in (live, sham) for label in flight.seen.labels} | live.own
    live_rows, sham_rows = live.inputs(links), sham.inputs(links)
    for row, sham_row in zip(live_rows, sham_rows, strict=False):
        if row != sham_row:
            return int(min(row[0], sham_row[0]))
    rest = (live_rows if len(live_rows) > len(sham_rows) else sham_rows)[min(len(live_rows), len(sham_rows)) :]
    return int(rest[0][0]) if rest else NEVER


def _acted(flight: Flight) -> list[Row]:
    """When each act was, what, on which link, and how many bytes it put there."""
    sizes = {frame.id: len(frame.payload) for frame in flight.seen.frames}
    return [(la.at_ns, la.action, la.frame.link, sizes.get(la.child or la.frame)) for la in flight.seen.labels]


def _alike(first: Flight, second: Flight, what: str) -> None:
    for name in ("frames", "truth", "notes", "labels"):
        rows: Sequence[Row] = getattr(first, name)()
        same(rows, getattr(second, name)(), f"{name} of {what}", "the same to the byte")


FAULT.rule("described", "Describes each of its parameters, and in one sentence what it does.")(_described)
FAULT.rule("makes", "Makes FaultParts from its parameters and a setting. Two faults share nothing.")(_makes)
FAULT.rule("named", "Names its agents and links after its id.")(_named)
FAULT.rule("muted", "If muted, changes no frame, note or truth, except on its own links.")(_muted)
FAULT.rule("onset", "Before its start, changes nothing beyond what its muted twin does.")(_onset)
FAULT.rule("acts", "Acts between its start and its stop, and not outside.")(_acts)
FAULT.rule("repeatable", "Does the same in two new runs of one process, one of them beside a fork of it.")(_repeatable)
FAULT.rule("copies", "A copy or fork made midway continues like the original, and shares no state with it.")(_copies)


@FAULT.rule("benign", "Is a fault in every label and event, never an attack, and has no radio.")
def _benign(case: AttackCase) -> None:
    parts, _ = case.made()
    need(not parts.radios, "has a radio", "taps, agents, sensor faults, body faults and links")
    flight = case.fly()
    for label in flight.seen.labels:
        need(label.fault and not label.benign, f"did an act that is labelled {short(label)}", "a label of a fault")
    for kind in flight.announced():
        need(kind in ("event.fault_start", "event.fault_stop"), f"was announced as {kind}", "event.fault_…")
