"""A live range: what was asked for, checked before anything starts, and the state of every node while it flies.

Where a ground station is outside the range, aircraft send telemetry from boot on, without a request. ArduCopter's rates
at boot are 0, and MAVSDK requests nothing by itself: it would wait for a position for ever.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Final, Literal

from skyrange.assembly.build import BuiltScenario, build
from skyrange.contracts.links import Act, Channel
from skyrange.core.errors import InputError, Problem
from skyrange.core.ids import endpoint, vehicle_id
from skyrange.core.time import NS_PER_S
from skyrange.gcs.telemetry_streams import OPERATOR
from skyrange.io.zeromq.curve_keys import Keys
from skyrange.record import Recorder
from skyrange.record.schema import FULL
from skyrange.runtime.event_reports import EventReport
from skyrange.runtime.live.deployment import LOOPBACK, Deployment, Group, assign_components, component_of
from skyrange.runtime.live.node.viewers import Watched, assign_viewer_ports
from skyrange.runtime.live.supervisor.act_requests import ActRequests
from skyrange.runtime.live.supervisor.namespaces import Namespaces, namespaces
from skyrange.runtime.live.system import Process, RealSystem, System
from skyrange.runtime.live.transport.addresses import Crossing, crossings
from skyrange.runtime.live.transport.control import Message
from skyrange.runtime.run import open_record
from skyrange.runtime.viewers import FIRST_PORT
from skyrange.scenario.model.operators import Operator
from skyrange.scenario.model.scenario import OnDeath, Scenario
from skyrange.vehicle.builtin.parameters.renames import canonical_name
from skyrange.vehicle.builtin.telemetry.schedule import STREAMS

_KINDS: Final = frozenset(("builtin", "ardupilot"))
"""Autopilots with ArduPilot's stream rates as parameters."""
BOOT_RATES: Final = {STREAMS[stream][0]: float(rate_hz) for stream, rate_hz in OPERATOR.streams}
"""Parameters (`SR0_…`, Hz) that start the streams which QGroundControl would request."""


def set_boot_rates(scenario: Scenario, outside: Collection[str]) -> Scenario:
    """The scenario with `BOOT_RATES` for the aircraft of ground stations in `outside`; parameters that it sets stay."""
    operators = tuple(
        _with_rates(operator) if endpoint(operator.id, "gcs") in outside else operator
        for operator in scenario.operators
    )
    return scenario.model_copy(update={"operators": operators})


def _with_rates(operator: Operator) -> Operator:
    vehicles = []
    for vehicle in operator.vehicles:
        set_names = {canonical_name(name) for name in vehicle.params}
        more = {name: rate_hz for name, rate_hz in BOOT_RATES.items() if name not in set_names}
        chosen = vehicle.model_copy(update={"params": {**more, **vehicle.params}})
        vehicles.append(chosen if vehicle.autopilot in _KINDS else vehicle)
    return operator.model_copy(update={"vehicles": tuple(vehicles)})


State = Literal["starting", "here", "bound", "ready", "flying", "done", "dead"]
MAX_STARTS = 4
"""Of a node: what dies so often is not mended by one more start."""


@dataclass(slots=True)
class SupervisedNode:
    """A node as the supervisor knows it."""

    name: str
    host: str
    state: State = "starting"
    process: Process | None = None
    """Its process, if that runs on this machine."""
    status: Message = field(default_factory=dict)
    """Its last report: counts, `now_ns`, `lag_ns`, `cpu_s`."""
    ended: str = ""
    """How it ended, with its last words; "" while it has not, or for one that ended as it should."""
    gone: bool = False
    """Whether its process on another machine has ended."""
    deaths: list[str] = field(default_factory=list)
    """How the processes of this name ended that were started before it."""

    @property
    def starts(self) -> int:
        """Number of times that it was started."""
        return len(self.deaths) + 1

    @property
    def running(self) -> bool:
        """Whether its process has not ended yet."""
        return self.process.running if self.process is not None else not self.gone


@dataclass(slots=True)
class LiveRange:
    """A live range: what was asked for, and the state of everything."""

    built: BuiltScenario
    deployment: Deployment
    crossings: list[Crossing]
    recorder: Recorder
    """Of the whole range; it is told everything at the end."""
    on_death: OnDeath
    keys: Keys | None = None
    """The range's own keys and those of the machines that may join; `None` for a range of one machine."""
    control_port: int = 0
    spaces: Namespaces | None = None
    """The networks of operators and aircraft, if they have their own on this machine."""
    motion: bool = False
    """Whether vehicles outside the range may be moved, where the scenario allows it too."""
    watched: Watched = ()
    """Aircraft that viewers see, and at which port."""
    system: System = field(default_factory=RealSystem)
    """Clock, sockets and processes of this machine."""
    port_offset: int = 0
    """What was added to every port."""
    requests: ActRequests = field(default_factory=ActRequests)
    """What is to be started and stopped by hand."""
    members: dict[str, SupervisedNode] = field(default_factory=dict)
    waits_for: list[str] = field(default_factory=list)
    """Addresses of machines that have not joined yet."""
    clocks: dict[str, Any] = field(default_factory=dict)
    """What is known of the other machines' clocks, for the manifest."""
    refused: int = 0
    """Connections to the control socket without a key of the range's."""
    zero_ns: int = 0
    """Time 0 on this machine's monotonic clock; 0 before it is set."""
    reports_events: bool = False
    """Whether the nodes report what happens; set before the start, by who takes the reports."""
    reports: list[EventReport] = field(default_factory=list)
    """What the nodes reported since somebody took it."""
    took_s: float = 0.0
    """Wall seconds from time 0 to the end."""

    @property
    def folder(self) -> Path:
        """The run's folder."""
        return self.recorder.path

    @property
    def joining(self) -> tuple[str, ...]:
        """The addresses of the machines that have to join."""
        return tuple(
            address for address in self.deployment.others if self.spaces is None or address not in self.spaces.names
        )

    @property
    def now_s(self) -> float:
        """The range's time; negative before its start."""
        return (self.system.clock.monotonic_ns() - self.zero_ns) / NS_PER_S if self.zero_ns else -1.0


OnUpdate = Callable[[LiveRange], None]
CONTROL_PORT = 14500
"""Where other machines join, + the port offset."""
OFFSETS: Final = tuple(range(0, 10_000, 1000))
"""Port offsets that are tried, where none is asked for: the links of 100 aircraft have their ports within 1,000."""


def prepare_range(
    scenario: Scenario,
    out: Path | None = None,
    *,
    group: Group | None = None,
    outside: tuple[str, ...] = (),
    port_offset: int | None = 0,
    on_death: OnDeath | None = None,
    keys: Keys | None = None,
    netns: bool = False,
    motion: bool = False,
    watched: bool = False,
    viewer_port: int | None = None,
    viewer_host: str = LOOPBACK,
    system: System | None = None,
) -> LiveRange:
    """Plan and check everything, and open the run folder `out`, or one that is free; nothing is started.

    `on_death` stands over the scenario's. All ports are moved by `port_offset`; if that is `None`, by the first of
    `OFFSETS` with which they are free, but by none where others have to know the ports. If it is `watched`, ground
    stations can watch at the address `viewer_host`, from `viewer_port` on, which no offset moves, or else from the
    usual port with the offset, as `runtime.viewers` has it. `system` is this machine unless another is given.
    Raises `InputError` with all that is wrong, before anything is written.
    """
    machine = system or RealSystem()
    if scenario.record.level != FULL:
        hint = "The records of its processes are matched by their frames. Add --set record.level=full."
        raise InputError.one("live", "record.level", scenario.record.level, FULL, hint)
    built = build(set_boot_rates(scenario, outside), motion=motion)
    built.close()  # its radio engine, which could be started, is started again by the world's process
    links = built.wiring.links
    if netns and scenario.hosts:
        raise InputError.one("live", "--netns", "with hosts in the scenario", "one of the two")
    components = {component_of(end) for spec in links for end in (spec.a, spec.b)}
    spaces = namespaces(sorted(components)) if netns else None
    planned = assign_components(links, group, outside, scenario.hosts if spaces is None else spaces.hosts)
    _check_shared_state(built, planned)
    _check_defended_ends(built, planned)
    _check_links_over_air(built, planned)
    _check_processing(built, planned)
    private = not outside and not planned.others and spaces is None
    offsets = (port_offset,) if port_offset is not None else OFFSETS if private else OFFSETS[:1]
    if planned.others and keys is None and spaces is None:
        hint = "Make some with `skyrange keys FOLDER`, and give FOLDER with --keys."
        raise InputError.one("live", "keys", f"none, and hosts {', '.join(planned.others)}", "keys to join with", hint)
    if spaces is None:
        machine.check_own_addresses(planned.base)
    fleet = [vehicle_id(operator.id, vehicle.id) for operator, vehicle in built.scenario.fleet]
    refused: InputError | None = None
    for offset in offsets:
        places = crossings(links, planned, offset)
        try:
            if spaces is None:  # in networks that are not there yet nothing is taken
                machine.check_free([crossing for crossing in places if _is_here(crossing, planned)])
            first = FIRST_PORT + offset if viewer_port is None else viewer_port
            viewers = assign_viewer_ports(fleet, first, viewer_host) if watched else ()
        except InputError as error:
            refused = refused or error
        else:
            break
    else:
        assert refused is not None
        raise refused
    control_port = CONTROL_PORT + offset if planned.others else 0
    death = on_death or scenario.live.on_death
    record = open_record(built, out)
    record.attach_files(built.files)
    return LiveRange(
        built, planned, places, record, death, keys, control_port, spaces, motion, viewers, machine, port_offset=offset
    )


def _is_here(crossing: Crossing, planned: Deployment) -> bool:
    """Whether a process of the range listens there, on the machine where the range is started."""
    return bool(planned.home(crossing.listener)) and planned.host(crossing.listener) == planned.base


def _check_links_over_air(built: BuiltScenario, planned: Deployment) -> None:
    """Raises `InputError` for a link over the air whose ends are not both in the world's process."""
    for spec in built.wiring.links:
        if isinstance(spec.channel, Channel):
            continue
        away = sorted({planned.home(end) or end for end in (spec.a, spec.b)} - {planned.nodes[0].name})
        if away:
            raise InputError.one(
                "live",
                spec.name,
                f"a channel over the air, with ends in {', '.join(away)}",
                f"both ends in the process {planned.nodes[0].name}, which knows where the aircraft are",
                "Choose --group one.",
            )


def _check_processing(built: BuiltScenario, planned: Deployment) -> None:
    """Raises `InputError` for limits of endpoints outside the range, where no process of the range has their queue."""
    away = [
        Problem(
            f"processing of {limit.endpoint}",
            f"a component outside the range, {component_of(limit.endpoint)}",
            "an endpoint of a process of the range",
            "Leave it out of the limits: the program outside has limits of its own.",
        )
        for limit in built.wiring.processing
        if not planned.home(limit.endpoint)
    ]
    if away:
        raise InputError("live", away)


def _check_shared_state(built: BuiltScenario, planned: Deployment) -> None:
    """Raises `InputError` for an attack or a defence whose parts share state and are in several processes."""
    world = planned.nodes[0].name
    for plan in built.wiring.acts:
        if not plan.one_process:
            continue
        homes = {planned.home(end) or end for end in _tapped_ends(built, plan)}
        if not plan.is_defence or plan.agents or plan.sensor_hooks:
            homes.add(world)
        if len(homes) > 1:
            away = ", ".join(sorted(homes - {world}))
            raise InputError.one(
                "live",
                f"{'defences' if plan.is_defence else 'attacks'}.{plan.id}",
                f"parts in the processes {f'{world} and {away}' if world in homes else away}",
                f"one process, because they share what the {'defence' if plan.is_defence else 'adversary'} observes",
                "Choose --group one.",
            )


def _check_defended_ends(built: BuiltScenario, planned: Deployment) -> None:
    """Raises `InputError` for a defence with a part at an endpoint outside the range, where nothing would run it."""
    problems = [
        Problem(
            f"defences.{plan.id}",
            f"a part at {end}, a component outside the range",
            "ends of links in processes of the range",
            "Mute or remove the defence: what is outside cannot be defended there.",
        )
        for plan in built.wiring.acts
        if plan.is_defence and not plan.muted
        for end in sorted(_tapped_ends(built, plan))
        if not planned.home(end)
    ]
    if problems:
        raise InputError("live", problems)


def _tapped_ends(built: BuiltScenario, plan: Act) -> set[str]:
    """The endpoints at which an attack or a defence has taps."""
    return {
        end
        for tap in built.wiring.taps
        if tap.attack == plan.id
        for spec in built.wiring.links
        if fnmatchcase(spec.name, tap.match)
        for end in (spec.a, spec.b)
        if end.rpartition(".")[2] == tap.side
    }
