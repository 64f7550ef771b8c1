"""Engine of the builtin autopilot: one instance for a fleet of any operators.

`begin` takes the sensors of a tick and, every 10 ms, the inbox; `finish` returns motor commands and outgoing messages.
Everything that an aircraft does depends on its own row, its own object and its own messages: a fleet in one engine and
the same fleet in four engines send the same bytes. So one engine may also fly the fleets of several runs of a batch
(`VehicleSpec.run`), each as if alone. `vehicles`, and what notes are about, are then named by `qualify`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from skyrange.codec.mavlink import decode, dialect
from skyrange.codec.mavlink.message_columns import FleetPacker
from skyrange.codec.mavlink.signing import SignedConnection, SignedConnections, SigningKey, signing_timestamp
from skyrange.contracts.components import EngineBase, Finished, Floats, Sensors, World
from skyrange.contracts.mailboxes import Arrival, Inbox, Outbox
from skyrange.contracts.plugins.registry import NoParams
from skyrange.contracts.tick_batches import TickBatch
from skyrange.core.chance import Chance
from skyrange.core.errors import DecodeError, InputError, Problem, nearest
from skyrange.core.geodesy import Origin
from skyrange.core.ids import Port, endpoint, hash64, link_name, qualify
from skyrange.core.time import NEVER, NS_PER_S, NS_PER_US, Epoch, Time
from skyrange.core.whole_numbers import worth_noting
from skyrange.vehicle.builtin import commands, fence, loop, messages, parameter_protocol, pilot
from skyrange.vehicle.builtin.arming import prearm
from skyrange.vehicle.builtin.arming.arming import auto_disarm_time, disarm
from skyrange.vehicle.builtin.commands import flight as flight_commands
from skyrange.vehicle.builtin.control.gains import GainSets
from skyrange.vehicle.builtin.estimation import resets
from skyrange.vehicle.builtin.estimation.estimator import Estimator
from skyrange.vehicle.builtin.failsafes import checks, crash, ground_station
from skyrange.vehicle.builtin.file_transfer import server as file_server
from skyrange.vehicle.builtin.fleet import COMPONENT_ID, Causes, Fleet, Timer, Vehicle
from skyrange.vehicle.builtin.flight_modes import guided, rtl
from skyrange.vehicle.builtin.layout import ESTIMATE, FLIGHT, FlightEvent, Records, new_records
from skyrange.vehicle.builtin.messages import consume_heartbeats
from skyrange.vehicle.builtin.mission import (
    do_commands,
    execution,
)
from skyrange.vehicle.builtin.mission.items import decode_item
from skyrange.vehicle.builtin.mission_protocol import server as mission_protocol
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.builtin.parameters.table import PARAMETERS, SETTINGS, fill_settings
from skyrange.vehicle.builtin.range_sensing import sensors as range_sensors
from skyrange.vehicle.builtin.range_sensing.avoidance import avoid_obstacles
from skyrange.vehicle.builtin.telemetry import radio_status, schedule
from skyrange.vehicle.builtin.telemetry.schedule import SERVICE_NS, Schedule
from skyrange.vehicle.builtin.tick_batch import FleetTickBatch
from skyrange.vehicle.contract import AutopilotContext, AutopilotPlugin, VehicleSpec
from skyrange.world.airframes import AIRFRAMES, MOTORS
from skyrange.world.world import World as BuiltinWorld

QUANTUM_S = 0.0025
"""Length of the first step. Later steps are the time between ticks (2.5 ms is ArduCopter's 400 Hz)."""
PHASE_STREAM = "vehicle.boot_phase"
LINK_ID = 1
"""Link id in signatures: the number of its telemetry port.

Channel 0 is USB, which ArduPilot lets anybody command unsigned (GCS_Signing.cpp). No link of the range is that, unless
the scenario makes the link of an operator's aircraft exempt.
"""


Handler = Callable[[Fleet, Vehicle, Any, tuple[int, int], Causes], None]
_ID = dialect
_HANDLERS: dict[int, Handler] = {
    _ID.MAVLINK_MSG_ID_HEARTBEAT: ground_station.on_heartbeat,
    _ID.MAVLINK_MSG_ID_MISSION_COUNT: mission_protocol.on_count,
    _ID.MAVLINK_MSG_ID_MISSION_ITEM_INT: mission_protocol.on_item,
    _ID.MAVLINK_MSG_ID_MISSION_ITEM: mission_protocol.on_item,
    _ID.MAVLINK_MSG_ID_MISSION_REQUEST_LIST: mission_protocol.on_request_list,
    _ID.MAVLINK_MSG_ID_MISSION_REQUEST_INT: mission_protocol.on_request,
    _ID.MAVLINK_MSG_ID_MISSION_REQUEST: mission_protocol.on_request,
    _ID.MAVLINK_MSG_ID_MISSION_CLEAR_ALL: mission_protocol.on_clear_all,
    _ID.MAVLINK_MSG_ID_MISSION_SET_CURRENT: mission_protocol.on_set_current,
    _ID.MAVLINK_MSG_ID_MISSION_WRITE_PARTIAL_LIST: mission_protocol.on_write_partial,
    _ID.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: guided.on_position_target_local,
    _ID.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT: guided.on_position_target_global,
    _ID.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET: guided.on_attitude_target,
    _ID.MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE: messages.on_override,
    _ID.MAVLINK_MSG_ID_MANUAL_CONTROL: messages.on_manual_control,
    _ID.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: parameter_protocol.on_request_list,
    _ID.MAVLINK_MSG_ID_PARAM_REQUEST_READ: parameter_protocol.on_request_read,
    _ID.MAVLINK_MSG_ID_PARAM_SET: parameter_protocol.on_set,
    _ID.MAVLINK_MSG_ID_DISTANCE_SENSOR: range_sensors.on_distance_sensor,
    _ID.MAVLINK_MSG_ID_OBSTACLE_DISTANCE: range_sensors.on_obstacle_distance,
    _ID.MAVLINK_MSG_ID_TIMESYNC: messages.on_timesync,
    _ID.MAVLINK_MSG_ID_FILE_TRANSFER_PROTOCOL: file_server.on_file_transfer,
    _ID.MAVLINK_MSG_ID_LOG_REQUEST_LIST: messages.on_log_request_list,
    _ID.MAVLINK_MSG_ID_SETUP_SIGNING: messages.on_setup_signing,
    _ID.MAVLINK_MSG_ID_RADIO: radio_status.on_radio_status,
    _ID.MAVLINK_MSG_ID_RADIO_STATUS: radio_status.on_radio_status,
    _ID.MAVLINK_MSG_ID_OPEN_DRONE_ID_ARM_STATUS: prearm.on_arm_status,
    _ID.MAVLINK_MSG_ID_OPEN_DRONE_ID_BASIC_ID: prearm.on_basic_id,
    _ID.MAVLINK_MSG_ID_OPEN_DRONE_ID_SYSTEM: prearm.on_system,
    _ID.MAVLINK_MSG_ID_OPEN_DRONE_ID_SYSTEM_UPDATE: prearm.on_system_update,
}
_COMMANDS = (_ID.MAVLINK_MSG_ID_COMMAND_LONG, _ID.MAVLINK_MSG_ID_COMMAND_INT)
_RADIO = (_ID.MAVLINK_MSG_ID_RADIO, _ID.MAVLINK_MSG_ID_RADIO_STATUS)
_EVENTS = tuple(FlightEvent)


class BuiltinFleet(EngineBase):
    """The engine (contract: `contracts.components.Engine`). A deep copy continues identically."""

    service_ns: Time = SERVICE_NS
    clock: Literal["lockstep", "wall"] = "lockstep"
    repeatable: Literal["bytes", "outcome"] = "bytes"
    preroll_ns: Time = 0
    moves: Sequence[str] = ()

    def __init__(self, name: str, specs: Sequence[VehicleSpec], origin: Origin, epoch: Epoch) -> None:
        """Build the fleet, disarmed in STABILIZE. A spec's seed only sets the phase of the aircraft's reports in a
        second.

        Raises `InputError` for an empty fleet, a system id outside 1…250, an unknown airframe or bad parameters.
        """
        self.name = name
        self.vehicles: Sequence[str] = [qualify(spec.run, spec.vehicle) for spec in specs]
        _check_specs(name, specs)
        count = len(specs)
        estimate, flight = new_records(ESTIMATE, count), new_records(FLIGHT, count)
        settings = np.zeros(count, dtype=SETTINGS)
        vehicles = []
        sequences, stored = np.zeros(count, dtype=np.int64), np.zeros((count, len(PARAMETERS)))
        for row, (id_, spec) in enumerate(zip(self.vehicles, specs, strict=True)):
            airframe = AIRFRAMES[spec.airframe]
            stored[row] = fill_settings(settings, row, spec.vehicle, airframe, spec.system_id, spec.params)
            port = Port(endpoint(spec.vehicle, "autopilot"), link_name("autopilot", spec.vehicle), spec.run)
            packer = FleetPacker(spec.system_id, COMPONENT_ID, sequences, row)
            lat, lon = origin.geodetic_of(*spec.home_enu_m[:2])
            on_at = round(lat * 1e7), round(lon * 1e7)
            vehicles.append(
                Vehicle(id_, row, spec.system_id, port, packer, spec.home_enu_m, on_at, spec.telemetry_radio)
            )
            estimate["pos"][row] = spec.home_enu_m
            estimate["yaw"][row] = math.radians(90.0 - spec.heading_deg)
        flight["landed"] = 1
        self.ports: Sequence[Port] = [vehicle.port for vehicle in vehicles]
        self._rows_by_port = {vehicle.port: vehicle.row for vehicle in vehicles}
        self._exempt = frozenset(
            vehicle.id for vehicle, spec in zip(vehicles, specs, strict=True) if spec.signing_exempt
        )
        signed = [
            SignedConnection(
                vehicle.id, spec.signing_key, vehicle.port, vehicle.port, spec.signing_exempt, spec.signing_time
            )
            for vehicle, spec in zip(vehicles, specs, strict=True)
            if spec.signing_key is not None
        ]
        self._signed = SignedConnections(self.ports, signed, LINK_ID, "event.signature_refused") if signed else None
        self._fleet = Fleet(vehicles, origin, epoch, estimate, flight, settings)
        self._estimator = Estimator(count, origin)
        self._fleet.stored_params[:] = stored
        self._gain_sets = GainSets([spec.airframe for spec in specs], settings)
        for vehicle in vehicles:
            pilot.update_sticks(self._fleet, vehicle)
        self._fleet.report_phases_ns[:] = [_report_phase_ns(spec) for spec in specs]
        self._schedule = Schedule(self._fleet.report_phases_ns)
        for vehicle in vehicles:
            schedule.start_boot_streams(self._schedule, self._fleet, vehicle)
            checks.reset_state(self._fleet, vehicle)
            range_sensors.start_sensors(self._fleet, vehicle)
        self._actuators = np.zeros((count, MOTORS))
        self._fleet.actuators = self._actuators
        self._last_tick: Time | None = None

    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        """Process the sensors and the messages of a tick; `finish` returns the result."""
        fleet = self._fleet
        fleet.now = tick
        fleet.outbox = Outbox()
        fleet.rotor_speeds = sensors.rotor_radps
        dt_s = (
            (tick - self._last_tick) / NS_PER_S if self._last_tick is not None and tick > self._last_tick else QUANTUM_S
        )
        self._last_tick = tick
        gain_sets = self._gain_sets
        gain_sets.update(tick, dt_s)
        if self._estimator.update(
            tick,
            dt_s,
            sensors,
            fleet.estimate,
            armed=fleet.flight["armed"],
            set_index=gain_sets.set_index,
            settings=gain_sets.parameter_sets,
        ):
            resets.report_events(fleet, self._estimator.filters)
        if tick % SERVICE_NS == 0:
            self._set_clocks(tick, sensors)
        if len(inbox):
            mail = inbox.columns(self._rows_by_port)
            if self._signed is not None:
                mail = self._signed.verify_inbox(tick, inbox, mail, fleet.outbox)
            for arrival in inbox.arrivals(mail.order[consume_heartbeats(fleet, mail)]):
                self._receive(arrival)
        if fleet.range_sensors and tick % SERVICE_NS == 0:
            avoid_obstacles(fleet)
        if loop.run_loop(*self._loop_arguments(dt_s)):
            self._handle_events()
        if tick % SERVICE_NS == 0:
            self._handle_timers(tick)
            checks.run_checks(fleet, self._actuators)
            self._schedule.send_due(fleet)
        self._end_tick(tick)

    def _end_tick(self, tick: Time) -> None:
        """What a tick ends with, once its events are handled."""
        fleet = self._fleet
        if fleet.aux_pending:
            flight_commands.run_pending(fleet)
        if fleet.new_keys:
            self._set_keys(tick)
        if self._signed is not None:
            for vehicle in fleet.rebooted:
                self._signed.start(tick, vehicle)
            self._signed.sign_outbox(tick, fleet.outbox)
        fleet.rebooted.clear()

    def _set_keys(self, tick: Time) -> None:
        """Give aircraft the keys that SETUP_SIGNING brought, or take theirs."""
        fleet = self._fleet
        if self._signed is None:
            self._signed = SignedConnections(self.ports, [], LINK_ID, "event.signature_refused")
        for row, key in fleet.new_keys:
            vehicle = fleet.vehicles[row]
            if key is None:
                self._signed.remove_key(vehicle.id)
                continue
            secret, timestamp = key
            signing_key = SigningKey(secret, signing_timestamp(fleet.clocks.epoch.unix_ns))
            connection = SignedConnection(
                vehicle.id, signing_key, vehicle.port, vehicle.port, vehicle.id in self._exempt
            )
            self._signed.set_key(tick, connection, timestamp)
            utc_us = fleet.clocks.utc_us(np.array([row]), tick).item()
            if utc_us:  # the next fix, 0.2 s later at most, sets the clock, and the clock the timestamp
                self._signed.set_clock(tick, vehicle.id, utc_us * NS_PER_US)
        fleet.new_keys.clear()

    def finish(self, tick: Time, wall_deadline_s: float) -> Finished:
        """Return motor commands (n, 4) and the messages of this tick. Never waits."""
        return Finished(self._actuators, self._fleet.outbox)

    def batch_ticks(self, world: World, rows: slice | NDArray[np.int64]) -> TickBatch | None:
        """Its ticks with a world of which it flies every body, in order."""
        if not isinstance(world, BuiltinWorld) or not isinstance(rows, slice):
            return None
        count = len(world.vehicles)
        if rows.indices(count) != (0, count, 1) or len(self.vehicles) != count:
            return None
        if world.quantum_ns / NS_PER_S != QUANTUM_S:
            return None
        return FleetTickBatch(world, self, rows)

    @property
    def only_flies(self) -> bool:
        """Whether the next tick, if it comes when due, has nothing but estimator and control loops to run."""
        return not self._fleet.aux_pending and self._gain_sets.computed_for(QUANTUM_S)

    @property
    def gains(self) -> Records:
        """The gains of the control loops; another object where they were computed anew."""
        return self._gain_sets.gains

    def batch_state(self, sensors: Sensors) -> tuple[tuple[Any, ...], tuple[Any, ...], Floats]:
        """The arguments of `step_strapdown` and of `run_loop`, and of these the motor commands."""
        inertial = sensors.gyro_radps, sensors.accel_mps2
        navigation = (*inertial, QUANTUM_S, self._fleet.estimate, self._estimator.filters)
        return navigation, self._loop_arguments(QUANTUM_S), self._actuators

    def _loop_arguments(self, dt_s: float) -> tuple[Any, ...]:
        fleet, gain_sets = self._fleet, self._gain_sets
        return (
            fleet.estimate,
            fleet.flight,
            fleet.legs,
            gain_sets.set_index,
            gain_sets.gains,
            gain_sets.parameter_sets,
            self._actuators,
            dt_s,
        )

    def end_batch(self, last: Time, *, flagged: bool) -> None:
        """Take over complete ticks of a batch, the last at `last`; `flagged` if its loop raised an event."""
        fleet = self._fleet
        fleet.now = self._last_tick = last
        fleet.outbox = Outbox()
        if flagged:
            self._handle_events()
            self._end_tick(last)

    def _set_clocks(self, now: Time, sensors: Sensors) -> None:
        """Set clocks by the receivers. A clock that is set sets the timestamps of signatures (`set_utc_usec`)."""
        fleet, clocks = self._fleet, self._fleet.clocks
        rows = clocks.update(sensors.gnss_utc_error_ns, fleet.estimate["gnss_fix"], fleet.flight["armed"])
        if self._signed is not None and len(rows):
            for row, utc_us in zip(rows.tolist(), clocks.utc_us(rows, now).tolist(), strict=True):
                self._signed.set_clock(now, fleet.vehicles[row].id, utc_us * NS_PER_US)

    def _receive(self, arrival: Arrival) -> None:
        """Process one frame, by ArduPilot's routing rules (MAVLink_routing.cpp)."""
        fleet = self._fleet
        vehicle = fleet.vehicles[self._rows_by_port[arrival.port]]
        try:
            message = decode(arrival.payload)
        except DecodeError as error:
            count = vehicle.bad_frames = vehicle.bad_frames + 1
            if worth_noting(count):
                fleet.note("event.bad_frame", vehicle, {"count": count, "error": str(error)[:200]}, (arrival.ref,))
            return
        peer = (message.get_srcSystem(), message.get_srcComponent())
        if peer == (vehicle.system_id, COMPONENT_ID):
            return  # an echo of its own frame
        if _rejects_sender(fleet, vehicle, message, peer[0]):
            vehicle.ignored_frames += 1
            return
        # there is no other component on board, so target_component is not checked
        addressee = getattr(message, "target_system", getattr(message, "target", vehicle.system_id))
        if addressee not in (0, vehicle.system_id):
            vehicle.ignored_frames += 1
            return
        if vehicle.paused:
            execution.restore_targets(fleet, vehicle)
        self._dispatch(vehicle, message, peer, (arrival.ref,))
        if vehicle.paused:
            execution.suspend_targets(fleet, vehicle)

    def _dispatch(self, vehicle: Vehicle, message: Any, peer: tuple[int, int], causes: Causes) -> None:
        """Pass a message to its handler."""
        fleet = self._fleet
        number = message.get_msgId()
        handler = _HANDLERS.get(number)
        if handler is not None:
            handler(fleet, vehicle, message, peer, causes)
        elif number in _COMMANDS:
            commands.on_command(fleet, self._schedule, vehicle, message, peer, causes)
        elif number == _ID.MAVLINK_MSG_ID_SET_MODE:
            flight_commands.handle_set_mode(
                fleet, vehicle, message.base_mode, message.custom_mode, causes
            )  # never acknowledged
        elif number == _ID.MAVLINK_MSG_ID_REQUEST_DATA_STREAM:
            schedule.on_request_data_stream(fleet, self._schedule, vehicle, message)

    def _handle_events(self) -> None:
        """Report the events of the loop to modes and missions."""
        fleet = self._fleet
        flight = fleet.flight
        for row in np.flatnonzero(flight["flags"] & ~flight["handled_flags"]).tolist():
            vehicle = fleet.vehicles[row]
            fresh = int(flight["flags"][row] & ~flight["handled_flags"][row])
            flight["handled_flags"][row] = flight["flags"][row]
            for flag in _EVENTS:
                if fresh & flag:
                    _on_event(fleet, vehicle, flag)

    def _handle_timers(self, now: Time) -> None:
        fleet = self._fleet
        if fleet.next_timer > now:
            return
        fleet.next_timer = NEVER  # handlers may set timers meanwhile; the earliest of the rest is found below
        for row, column in np.argwhere(fleet.timers <= now).tolist():
            vehicle = fleet.vehicles[row]
            if fleet.timers[row, column] <= now:  # an earlier one may have cleared it
                fleet.timers[row, column] = NEVER
                if vehicle.paused:
                    execution.restore_targets(fleet, vehicle)
                _TIMERS[Timer(column)](fleet, vehicle)
                if vehicle.paused:
                    execution.suspend_targets(fleet, vehicle)
        fleet.next_timer = min(fleet.next_timer, int(fleet.timers.min()))


def _report_phase_ns(spec: VehicleSpec) -> Time:
    return int(Chance(spec.seed).uniform4(PHASE_STREAM, hash64(spec.vehicle), 0)[0] * NS_PER_S)


def _rejects_sender(fleet: Fleet, vehicle: Vehicle, message: Any, system: int) -> bool:
    """Whether SYSID_ENFORCE rejects this sender (`accept_packet`): only its own components and ground station pass."""
    if fleet.param(vehicle, "SYSID_ENFORCE") == 0.0 or message.get_msgId() in _RADIO:
        return False
    return system not in (vehicle.system_id, int(fleet.param(vehicle, "SYSID_MYGCS")))


def _on_event(fleet: Fleet, vehicle: Vehicle, flag: FlightEvent) -> None:
    if flag is FlightEvent.TAKEOFF_COMPLETE:
        fence.auto_enable_after_takeoff(fleet, vehicle)
    if flag is FlightEvent.LIFT_OFF:
        fleet.note("event.takeoff", vehicle, {}, vehicle.target_causes)
    elif flag is FlightEvent.LAND_COMPLETE:
        fleet.note("event.landed", vehicle, {}, vehicle.mode_causes)
        settles = vehicle.mode in (Mode.LAND, Mode.RTL, Mode.AUTO)
        spool_ns = int(fleet.param(vehicle, "MOT_SPOOL_TIME") * NS_PER_S)
        fleet.set_timer(vehicle, Timer.LANDED, fleet.now + spool_ns if settles else NEVER)
        fleet.set_timer(vehicle, Timer.DISARM_DELAY, auto_disarm_time(fleet, vehicle))
    elif flag is FlightEvent.CRASH:
        crash.check_crash(fleet, vehicle)
    elif vehicle.mode == Mode.AUTO:
        execution.on_event(fleet, vehicle, flag)
    elif vehicle.mode == Mode.RTL and flag is FlightEvent.DESTINATION_REACHED:
        rtl.on_destination_reached(fleet, vehicle)


def _on_hold_timer(fleet: Fleet, vehicle: Vehicle) -> None:
    if vehicle.mode == Mode.AUTO:
        execution.on_timer(fleet, vehicle)
    elif vehicle.mode == Mode.RTL:
        rtl.on_timer(fleet, vehicle)


def _on_landed_timer(fleet: Fleet, vehicle: Vehicle) -> None:
    if vehicle.mode == Mode.AUTO:
        execution.on_landed(fleet, vehicle)
    elif vehicle.mode in (Mode.LAND, Mode.RTL):
        disarm(fleet, vehicle, "landed", vehicle.mode_causes)


def _on_disarm_timer(fleet: Fleet, vehicle: Vehicle) -> None:
    if not (fleet.armed(vehicle) and fleet.landed(vehicle)):
        return
    if pilot.throttle_input(fleet, vehicle) > 0.0:  # a raised throttle postpones it (auto_disarm_check)
        fleet.set_timer(vehicle, Timer.DISARM_DELAY, auto_disarm_time(fleet, vehicle))
    else:
        disarm(fleet, vehicle, "disarm_delay", ())


_TIMERS: dict[Timer, Callable[[Fleet, Vehicle], None]] = {
    Timer.UPLOAD: mission_protocol.on_timer,
    Timer.HOLD: _on_hold_timer,
    Timer.LANDED: _on_landed_timer,
    Timer.DISARM_DELAY: _on_disarm_timer,
    Timer.GUIDED_TIMEOUT: guided.on_timeout,
    Timer.PARAM_LIST: parameter_protocol.on_timer,
    Timer.RC_OVERRIDE: messages.on_timer,
    Timer.CONDITION: do_commands.on_timer,
    Timer.FILE_BURST: file_server.on_burst_timer,
    Timer.FILE_IDLE: file_server.on_idle_timer,
}


def _check_specs(name: str, specs: Sequence[VehicleSpec]) -> None:
    """Raise `InputError` with everything that is wrong with the specs."""
    problems = []
    if not specs:
        problems.append(Problem("vehicles", "none", "at least one vehicle"))
    for spec in specs:
        if spec.airframe not in AIRFRAMES:
            problems.append(
                Problem(
                    f"{spec.vehicle} airframe", spec.airframe, "a known airframe", nearest(spec.airframe, AIRFRAMES)
                )
            )
        if not 1 <= spec.system_id <= 250:
            problems.append(Problem(f"{spec.vehicle} system_id", str(spec.system_id), "1 to 250"))
        if not all(math.isfinite(part) for part in (*spec.home_enu_m, spec.heading_deg)):
            problems.append(Problem(f"{spec.vehicle} home", str((spec.home_enu_m, spec.heading_deg)), "finite numbers"))
    if problems:
        raise InputError(f"builtin autopilot {name}", problems)


def _make(params: NoParams, context: AutopilotContext) -> BuiltinFleet:
    return BuiltinFleet(context.name, context.specs, context.origin, context.epoch)


def _mission_result(item: Any) -> int:
    return int(decode_item(item, ())[0])


BUILTIN = AutopilotPlugin(
    NoParams,
    _make,
    "Models ArduCopter in skyrange's own code.",
    signs=True,
    exempts=True,
    mission_result=_mission_result,
)
"""The autopilot `builtin`. Raises `InputError` as `BuiltinFleet` does."""
