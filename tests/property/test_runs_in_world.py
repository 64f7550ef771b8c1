"""Is each run of a batch, in one world and one engine, to the byte what it is alone?"""

from __future__ import annotations

import copy
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache
from itertools import chain
from typing import Any

import numpy as np
import pytest
import shapely

from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.codec.mavlink import Packer, dialect
from skyrange.contracts.components import Sensors
from skyrange.contracts.mailboxes import Arrival, Inbox, Note
from skyrange.contracts.tick_batches import TickProgress
from skyrange.core.errors import InputError
from skyrange.core.ids import FrameId, Port, qualify, split_run
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.vehicle.builtin.engine import BuiltinFleet
from skyrange.vehicle.builtin.tick_batch import FleetTickBatch
from skyrange.vehicle.builtin.utc_clocks import UtcClocks
from skyrange.vehicle.contract import VehicleSpec
from skyrange.world import Body, SensorSpec, Wind, World
from skyrange.world.sensing.geomagnetism import magnetic_field_at
from tests.integration.flight_harness import EPOCH, ORIGIN

QUANTUM_NS = 2_500_000
SENSORS = [entry.name for entry in fields(Sensors)]
CITY = City(
    [
        Building("wall", 60.0, shapely.box(6.0, -30.0, 8.0, 30.0)),
        Building("roof", 10.0, shapely.box(-30.0, 10.0, 4.0, 30.0)),
    ],
    "test",
)
RUNS = 4
RESTING = 2
"""The run in which nothing moves."""
VELOCITIES = {"blue/b1": (2.0, 0.5, 0.5), "blue/a2": (-2.0, 0.0, 0.5), "green/g1": (8.0, 0.0, 1.0)}


def bodies_of(run: int) -> list[Body]:
    """Two that meet in the air, and one that flies into a wall; the last run has one more, over a roof."""
    up_m = 0.0 if run == RESTING else 1.2
    made = [
        Body("blue/b1", "iris", 0.0, 0.0, up_m),
        Body("blue/a2", "iris", 1.6, 0.1, up_m),
        Body("green/g1", "iris", 3.0, 3.0, up_m, 90.0, charge=0.4),
    ]
    if run == RUNS - 1:
        made.append(Body("green/a", "hummingbird", -5.0, 20.0, 10.5))
    return [replace(body, run=run, seed=100 + 7 * run - 300 * (run == 1)) for body in made]


def make_worlds(city: City | None, wind: Wind, noise: float) -> list[World]:
    """A world for each run, and at the end one for all."""
    sensors = SensorSpec(noise, magnetic_field_at(ORIGIN), 10.0 * noise, noise)
    batch = [bodies_of(run) for run in range(RUNS)]
    lists = [[replace(body, run=0) for body in bodies] for bodies in batch]
    worlds = [
        World(bodies, wind=wind, city=city, sensors=sensors) for bodies in [*lists, [*chain.from_iterable(batch)]]
    ]
    for world in worlds:
        for row, vehicle in enumerate(world.vehicles):
            if world._bodies.position[row, 2] > 0.0:
                world._bodies.velocity[row] = VELOCITIES.get(vehicle, (0.0, 0.0, 0.0))
    return worlds


def state_of(world: Any) -> dict[str, bytes]:
    """Everything that can be read of a world, or of one run of it."""
    sensors = world.sensors(slice(None))
    found = {name: np.ascontiguousarray(getattr(sensors, name)).tobytes() for name in SENSORS}
    found |= {f"truth {name}": column.tobytes() for name, column in world.truth().items()}
    found["motion"] = b"".join(array.tobytes() for array in world.motion())
    found["motors"] = repr([world.lost_motors(vehicle) for vehicle in world.vehicles]).encode()
    return found


@pytest.mark.parametrize("city", [None, CITY], ids=["field", "city"])
@pytest.mark.parametrize(("turbulence", "noise"), [(0.0, 0.0), (12.0, 1.0)], ids=["calm", "gusty"])
def test_a_run_moves_as_in_a_world_of_its_own(city: City | None, turbulence: float, noise: float) -> None:
    """Bodies of all runs start at the same places; motors, faults and gusts differ by run."""
    *alone, world = make_worlds(city, Wind((2.0, -1.0, 0.0), turbulence), noise)
    chance = np.random.default_rng(7)
    views = [world.of_run(run) for run in range(RUNS)]
    kinds: Counter[str] = Counter()
    for tick in range(360):
        said: list[list[Note]] = [[] for _ in alone]
        for run, note in world.advance_runs(tick * QUANTUM_NS):
            said[run].append(note)
        for run, (one, view) in enumerate(zip(alone, views, strict=True)):
            notes = one.advance(tick * QUANTUM_NS)
            assert said[run] == notes, (run, tick)
            kinds.update(note.kind + ("" if "with" not in note.data else str(note.data["with"])[0]) for note in notes)
            if tick % 3 == 0:
                assert state_of(view) == state_of(one), (run, tick)
            if run == RESTING:
                continue
            if chance.random() < 0.1:
                commands = chance.uniform(0.2, 0.9, (len(one.vehicles), 4)) * (tick < 150)
                for each in (one, view):
                    each.actuate(slice(None), commands)
            if chance.random() < 0.02:
                rows = chance.permutation(len(one.vehicles))[:2]
                share, gust = chance.uniform(0.3, 1.0, (2, 4)), chance.uniform(-4.0, 4.0, (2, 3)) * (run != 0)
                for each in (one, view):
                    each.disturb(rows, share, gust)
        if tick == 180:
            world, *alone = copy.deepcopy((world, *alone))
            views = [world.of_run(run) for run in range(RUNS)]
    assert kinds["event.collisionb"] > 4
    assert kinds["event.contact"] + kinds["event.crash"] > 4
    assert world._bodies.impact_mps[world.rows_of(RESTING)].max() == 0.0


def test_runs_at_one_place_do_not_see_each_other() -> None:
    """Two hundred runs of two aircraft: no pair is near but that of a run, however many there are."""
    bodies = [Body(f"blue/b{k}", "iris", float(k), 0.0, 20.0, run=run) for run in range(200) for k in (0, 3)]
    world = World(bodies)
    world._bodies.velocity[:, 0] = 1.0
    for tick in range(3):
        assert not world.advance(tick * QUANTUM_NS)
    pairs = world._contact_tracker._pairs
    assert pairs.tolist() == [[2 * run, 2 * run + 1] for run in range(200)]


def test_a_view_is_the_world_of_a_run() -> None:
    *alone, world = make_worlds(None, Wind(), 0.0)
    world.advance(0)
    view = world.of_run(3)
    assert world.runs == RUNS
    assert [world.rows_of(run) for run in range(RUNS)] == [slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 13)]
    assert view.vehicles == alone[3].vehicles
    assert view.airframes == alone[3].airframes
    assert view.sources == alone[3].sources
    assert view.present is None
    assert view.city is None
    reading = view.sensors(slice(1, None)).gyro_radps
    assert np.shares_memory(reading, world._bodies.rates)
    assert view.sensors(slice(1, None)).gyro_radps is reading
    assert view.sensors(slice(None, None, -1)).baro_up_m.tolist() == world.sensors(slice(12, 8, -1)).baro_up_m.tolist()
    assert world.of_run(0).sensors(slice(None, None, -1)).baro_up_m.tolist() == [1.2, 1.2, 1.2]
    assert view.sensors(np.array([3, 0])).baro_up_m.tolist() == [10.5, 1.2]
    inputs = view.body_inputs(np.array([3]))
    assert inputs.world_position_enu_m.tolist() == world.motion()[0][9:].tolist()
    kept = view.truth()["throttle"]
    view.actuate(slice(3, 4), np.full((1, 4), 0.5))
    assert kept.tolist() == [0.0, 0.0, 0.0, 0.0]
    assert view.truth()["throttle"].tolist() == [0.0, 0.0, 0.0, 0.5]
    assert view.truth()["up_m"].base is view.truth()["up_m"].base
    with pytest.raises(ValueError, match="read-only"):
        view.truth()["up_m"][0] = 1.0
    with pytest.raises(ValueError, match="with the others"):
        view.advance(QUANTUM_NS)
    with pytest.raises(ValueError, match="not in tuple"):
        world.of_run(0).lost_motors("green/a")
    with pytest.raises(IndexError, match="run 4"):
        world.of_run(4)


@pytest.mark.parametrize("runs", [[1], [0, 2], [0, 1, 0], [-1]])
def test_runs_are_numbered_from_0_side_by_side(runs: Sequence[int]) -> None:
    with pytest.raises(InputError, match="side by side"):
        World([Body(f"blue/b{k}", "iris", 0.0, 9.0 * k, run=run) for k, run in enumerate(runs)])


def test_names_are_unique_within_a_run() -> None:
    bodies = [Body("blue/b1", "iris", 0.0, 0.0, run=run) for run in (0, 1, 1)]
    World(bodies[:2])
    with pytest.raises(InputError, match="not used by another vehicle"):
        World(bodies)


def test_names_with_their_runs_are_split_again() -> None:
    for run, name in ((0, "blue/b1"), (1, "blue/b1"), (12, "blue/b1.autopilot"), (3, "gcs:blue/b1")):
        assert split_run(qualify(run, name)) == (run, name)
    assert qualify(0, "blue/b1") == "blue/b1"
    assert Port("blue/b1.autopilot", "autopilot:blue/b1") == Port("blue/b1.autopilot", "autopilot:blue/b1", 0)


FLEET = ("blue/b1", "blue/b2")
FLOWN = 3
"""Runs of a batch of fleets."""
UNTIL_NS = 5 * NS_PER_S
SERVICE_NS = BuiltinFleet.service_ns


@dataclass
class Flown:
    """What one run's links and record get."""

    sent: dict[Port, list[tuple[Time, bytes, Any]]] = field(default_factory=dict)
    notes: list[tuple[Time, Note]] = field(default_factory=list)
    states: list[bytes] = field(default_factory=list)


def specs_of(run: int, number: int) -> list[VehicleSpec]:
    """The aircraft of a run, as run `number` of a batch; one run has other parameters, and one signs."""
    params = {"MOT_SPOOL_TIME": 0.6} if run == 1 else {}
    return [
        VehicleSpec(
            vehicle,
            system,
            home_enu_m=(20.0 * system, 5.0, 0.0),
            params=params | ({"FS_GCS_TIMEOUT": 2.0} if run == 2 else {}),
            run=number,
            seed=5 + run,
        )
        for system, vehicle in enumerate(FLEET, 1)
    ]


def orders_of(run: int) -> list[tuple[Time, str, bytes]]:
    """What arrives at the aircraft of a run: (service, vehicle, payload), in order of time."""
    chance = np.random.default_rng(40 + run)
    orders: list[tuple[Time, str, bytes]] = []
    for system, vehicle in enumerate(FLEET, 1):
        packer = Packer(255, 190)

        def command(number: int, *params: float, system: int = system) -> Any:
            seven = [*params, *([0.0] * (7 - len(params)))]
            return dialect.MAVLink_command_long_message(system, 1, number, 0, *seven)

        odd = [
            dialect.MAVLink_param_request_list_message(system, 1),
            dialect.MAVLink_param_set_message(system, 1, b"WPNAV_SPEED", 300.0 + 50 * run, 9),
            dialect.MAVLink_mission_count_message(system, 1, 3 + run, 0),
            dialect.MAVLink_timesync_message(0, 77),
            dialect.MAVLink_log_request_list_message(system, 1, 0, 0xFFFF),
            dialect.MAVLink_file_transfer_protocol_message(0, system, 1, bytes([0, 0, 0, 3]) + bytes(247)),
            command(dialect.MAV_CMD_REQUEST_MESSAGE, float(dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION)),
            command(dialect.MAV_CMD_RUN_PREARM_CHECKS),
        ]
        messages = [(k * 0.5, dialect.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3)) for k in range(2 if run == 2 else 8)]
        messages.append((0.05 * run, dialect.MAVLink_request_data_stream_message(system, 1, 0, 4 + run, 1)))
        if run != 1 or system == 1:
            messages += [
                (0.3, command(dialect.MAV_CMD_DO_SET_MODE, 1.0, 4.0)),
                (0.4 + 0.1 * run, command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)),
                (0.6 + 0.1 * run, command(dialect.MAV_CMD_NAV_TAKEOFF, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0 + run)),
                (4.45, command(dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0.0, 21196.0 * (run != 1))),
            ]
        else:
            messages += [
                (2.0, command(dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1.0)),
                (2.5, dialect.MAVLink_setup_signing_message(system, 1, bytes(range(32)), 5_000_000)),
            ]
        messages += [(float(chance.uniform(0.0, 4.9)), odd[k]) for k in chance.integers(0, len(odd), 8)]
        if system == 2:
            messages.append((3.0, command(dialect.MAV_CMD_DO_SET_MODE, 1.0, (0.0, 2.0, 5.0)[run])))
        for at_s, message in messages:
            at = round(at_s * NS_PER_S) // SERVICE_NS * SERVICE_NS
            frame = packer.pack(message)
            if chance.random() < 0.1:
                frame = frame[:-1] + bytes([frame[-1] ^ 1])
            orders.append((at, vehicle, frame))
    return sorted(orders, key=lambda order: order[0])


class Driver:
    """A world and a fleet of some runs, whose results it keeps by the numbers of these."""

    def __init__(self, runs: Sequence[int]) -> None:
        specs = [spec for number, run in enumerate(runs) for spec in specs_of(run, number)]
        bodies = [Body(s.vehicle, s.airframe, *s.home_enu_m, run=s.run, seed=s.seed) for s in specs]
        self.world = World(bodies, wind=Wind((1.0, 0.0, 0.0), 5.0), sensors=SensorSpec(1.0, magnetic_field_at(ORIGIN)))
        self.engine = BuiltinFleet("builtin", specs, ORIGIN, EPOCH)
        self.flown = [Flown() for _ in runs]
        mail = [
            (at, vehicle, payload, number) for number, run in enumerate(runs) for at, vehicle, payload in orders_of(run)
        ]
        self.mail = sorted(mail, key=lambda order: order[0])

    def inbox(self, now: Time) -> Inbox:
        arrivals = []
        while now % SERVICE_NS == 0 and self.mail and self.mail[0][0] <= now:
            at, vehicle, payload, run = self.mail.pop(0)
            port = Port(f"{vehicle}.autopilot", f"autopilot:{vehicle}", run)
            ref = FrameId(port.link, "fwd", f"{vehicle}.proxy", at)
            arrivals.append(Arrival(port, at, payload, f"{vehicle}.proxy", ref))
        return Inbox(arrivals)

    def note(self, now: Time, notes: Sequence[tuple[int, Note]]) -> None:
        for run, note in notes:
            self.flown[run].notes.append((now, note))

    def fly_engine(self, now: Time) -> None:
        self.engine.begin(now, self.world.sensors(slice(None)), self.inbox(now))
        self.finish(now)

    def finish(self, now: Time) -> None:
        finished = self.engine.finish(now, 0.0)
        self.world.actuate(slice(None), finished.actuators)
        for port, payload, causes in finished.outbox.each(self.engine.ports):
            sent = self.flown[port.run].sent.setdefault(port._replace(run=0), [])
            sent.append((now, payload, causes))
        for note in finished.outbox.notes:
            run, about = split_run(note.about)
            assert "|" not in repr(note.data)
            self.flown[run].notes.append((now, note._replace(about=about)))
        if now % (100 * NS_PER_MS) == 0:
            for run, flown in enumerate(self.flown):
                flown.states.append(b"".join(column.tobytes() for column in self.world.of_run(run).truth().values()))

    def fly(self) -> list[Flown]:
        for now in range(0, UNTIL_NS + QUANTUM_NS, QUANTUM_NS):
            self.note(now, self.world.advance_runs(now))
            self.fly_engine(now)
        return self.flown

    def fly_batches(self, stops: Counter[TickProgress]) -> list[Flown]:
        """The same in batches of ticks, as a kernel runs them."""
        batch = self.engine.batch_ticks(self.world, slice(None))
        assert isinstance(batch, FleetTickBatch)
        at = 0
        while at <= UNTIL_NS:
            left = -(at // QUANTUM_NS) % 4
            begun, stop = batch.run(at, left, service=True) if left else (0, TickProgress.COMPLETE)
            if not begun:
                self.note(at, self.world.advance_runs(at))
                self.fly_engine(at)
                at += QUANTUM_NS
                continue
            stops[stop] += 1
            at += begun * QUANTUM_NS
            now = at - QUANTUM_NS
            if stop is TickProgress.MOVED:
                self.note(now, batch.complete_world_tick_runs())
                self.fly_engine(now)
            elif stop is TickProgress.WORLD_ADVANCED:
                self.fly_engine(now)
            elif stop is TickProgress.ENGINE_BEGUN:
                self.finish(now)
        return self.flown


@cache
def flown_alone() -> list[Flown]:
    return [flown for run in range(FLOWN) for flown in Driver([run]).fly_batches(Counter())]


def check_flown(flown: Sequence[Flown]) -> None:
    for run, (one, own) in enumerate(zip(flown_alone(), flown, strict=True)):
        assert own.sent == one.sent, run
        assert own.notes == one.notes, run
        assert own.states == one.states, run


def test_a_fleet_flies_as_in_an_engine_of_its_own() -> None:
    check_flown(Driver(range(FLOWN)).fly())
    kinds = {note.kind for flown in flown_alone() for _, note in flown.notes}
    assert {"event.takeoff", "event.bad_frame", "event.reboot", "event.signing_key", "event.contact"} <= kinds
    assert min(len(sent) for flown in flown_alone() for sent in flown.sent.values()) > 100


def test_a_fleet_flies_as_in_an_engine_of_its_own_in_batches_of_ticks() -> None:
    stops: Counter[TickProgress] = Counter()
    check_flown(Driver(range(FLOWN)).fly_batches(stops))
    assert min(stops[stop] for stop in (TickProgress.MOVED, TickProgress.ENGINE_BEGUN)) > 0


def test_a_clock_that_is_behind_is_set_whoever_else_has_an_error() -> None:
    """The receiver of the first showed a time in the past when it was switched on, and shows the true one since."""
    fixed, disarmed = np.array([3, 3]), np.array([0, 0])
    found = []
    for other in (0, 50):
        clocks = UtcClocks(2, EPOCH)
        for first in (-1000, 0, 0):
            clocks.update(np.array([first, other]), fixed, disarmed)
        found.append(int(clocks.error_ns[0]))
    assert found == [0, 0]
