"""The builtin autopilot as an engine: one for a whole fleet, of any operators.

`begin` takes the tick's sensors and, every 10 ms, the mail; `finish` hands back motor commands and what was said.
Everything an aircraft does depends on its own row, its own craft and its own mail: a fleet in one engine and the same
fleet in four say the same bytes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np

from skyrange.agent.contracts import EngineBase, Finished, Sensors
from skyrange.agent.messages import Arrival, Inbox, Outbox
from skyrange.agent.plugins import NoParams
from skyrange.codec.mavlink import decode, dialect
from skyrange.codec.numbering import RowPacker
from skyrange.codec.signed_mail import Connection, SignedMail
from skyrange.core.chance import Chance
from skyrange.core.errors import DecodeError, Fault, InputError, nearest
from skyrange.core.geodesy import Origin
from skyrange.core.ids import Port, endpoint, hash64, link_name
from skyrange.core.time import NEVER, NS_PER_S, Epoch, Time
from skyrange.vehicle.builtin import (
    commands,
    do_items,
    fence,
    loop,
    mission_protocol,
    navigator,
    parameter_protocol,
    pausing,
    piloting,
    remote_id,
    returning,
    sticks_in,
    targets,
)
from skyrange.vehicle.builtin.arming import disarm, idle_end
from skyrange.vehicle.builtin.commands import flying
from skyrange.vehicle.builtin.estimation import resets
from skyrange.vehicle.builtin.estimation.estimator import Estimator
from skyrange.vehicle.builtin.failsafes import crash, ground_station, service
from skyrange.vehicle.builtin.fleet import COMPONENT, Causes, Craft, Fleet, Timer
from skyrange.vehicle.builtin.layout import ESTIMATE, FLIGHT, Flag, zeros
from skyrange.vehicle.builtin.mail import take_heartbeats
from skyrange.vehicle.builtin.modes import Mode
from skyrange.vehicle.builtin.parameters import PARAMETERS, SETTINGS, fill
from skyrange.vehicle.builtin.telemetry import streams, timesync
from skyrange.vehicle.builtin.telemetry.schedule import SERVICE_NS, Schedule
from skyrange.vehicle.builtin.tuning import Tuning
from skyrange.vehicle.spec import AutopilotContext, AutopilotPlugin, VehicleSpec
from skyrange.world.airframes import AIRFRAMES, MOTORS

QUANTUM_S = 0.0025
"""The first step; later ones are as long as the time between ticks (2.5 ms is ArduCopter's 400 Hz)."""
PHASE_STREAM = "vehicle.boot_phase"
LINK_ID = 1
"""In signatures, the number of its telemetry port: channel 0 is USB, which ArduPilot lets anybody command unsigned
(GCS_Signing.cpp), and which no link of the range is."""


Handler = Callable[[Fleet, Craft, Any, tuple[int, int], Causes], None]
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
    _ID.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED: targets.on_local,
    _ID.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT: targets.on_global,
    _ID.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET: targets.on_attitude,
    _ID.MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE: piloting.on_override,
    _ID.MAVLINK_MSG_ID_MANUAL_CONTROL: piloting.on_manual_control,
    _ID.MAVLINK_MSG_ID_PARAM_REQUEST_LIST: parameter_protocol.on_list,
    _ID.MAVLINK_MSG_ID_PARAM_REQUEST_READ: parameter_protocol.on_read,
    _ID.MAVLINK_MSG_ID_PARAM_SET: parameter_protocol.on_set,
    _ID.MAVLINK_MSG_ID_TIMESYNC: timesync.on_timesync,
    _ID.MAVLINK_MSG_ID_OPEN_DRONE_ID_ARM_STATUS: remote_id.on_arm_status,
    _ID.MAVLINK_MSG_ID_OPEN_DRONE_ID_BASIC_ID: remote_id.on_basic_id,
    _ID.MAVLINK_MSG_ID_OPEN_DRONE_ID_SYSTEM: remote_id.on_system,
    _ID.MAVLINK_MSG_ID_OPEN_DRONE_ID_SYSTEM_UPDATE: remote_id.on_system_update,
}
_COMMANDS = (_ID.MAVLINK_MSG_ID_COMMAND_LONG, _ID.MAVLINK_MSG_ID_COMMAND_INT)
_RADIO = (_ID.MAVLINK_MSG_ID_RADIO, _ID.MAVLINK_MSG_ID_RADIO_STATUS)
_FLAGS = tuple(Flag)


class BuiltinFleet(EngineBase):
    """The engine (contract: `agent.contracts.Engine`). Deep copies of it go on alike."""

    service_ns: Time = SERVICE_NS
    clock: Literal["lockstep", "wall"] = "lockstep"
    repeatable: Literal["bytes", "outcome"] = "bytes"
    preroll_ns: Time = 0
    moves: Sequence[str] = ()

    def __init__(self, name: str, specs: Sequence[VehicleSpec], origin: Origin, epoch: Epoch, chance: Chance) -> None:
        """Build the fleet, standing disarmed in STABILIZE. Chance only sets when within a second each one reports.

        Raises `InputError` for an empty fleet, a system id outside 1…250, an unknown airframe or bad parameters.
        """
        self.name = name
        self.vehicles: Sequence[str] = [spec.vehicle for spec in specs]
        _check(name, specs)
        count = len(specs)
        estimate, flight = zeros(ESTIMATE, count), zeros(FLIGHT, count)
        settings = np.zeros(count, dtype=SETTINGS)
        crafts = []
        sequences, stored = np.zeros(count, dtype=np.int64), np.zeros((count, len(PARAMETERS)))
        for row, spec in enumerate(specs):
            airframe = AIRFRAMES[spec.airframe]
            stored[row] = fill(settings, row, spec.vehicle, airframe, spec.system_id, spec.params)
            port = Port(endpoint(spec.vehicle, "autopilot"), link_name("autopilot", spec.vehicle))
            packer = RowPacker(spec.system_id, COMPONENT, sequences, row)
            crafts.append(Craft(spec.vehicle, row, spec.system_id, port, packer, spec.home_enu_m))
            estimate["pos"][row] = spec.home_enu_m
            estimate["yaw"][row] = math.radians(90.0 - spec.heading_deg)
        flight["landed"] = 1
        self.ports: Sequence[Port] = [craft.port for craft in crafts]
        self._places = {craft.port: craft.row for craft in crafts}
        signed = [
            Connection(craft.id, spec.signing_key, craft.port, craft.port)
            for craft, spec in zip(crafts, specs, strict=True)
            if spec.signing_key is not None
        ]
        self._signed = SignedMail(self.ports, signed, LINK_ID, "event.signature_refused") if signed else None
        self._fleet = Fleet(crafts, origin, epoch, estimate, flight, settings)
        self._estimator = Estimator(count, origin)
        self._fleet.stored[:] = stored
        self._tuning = Tuning([spec.airframe for spec in specs], settings)
        for craft in crafts:
            sticks_in.place(self._fleet, craft)
        phases = [int(chance.uniform4(PHASE_STREAM, hash64(spec.vehicle), 0)[0] * NS_PER_S) for spec in specs]
        self._schedule = Schedule(np.array(phases, dtype=np.int64))
        for craft in crafts:
            streams.boot_rates(self._schedule, self._fleet, craft)
            service.boot(self._fleet, craft)
        self._actuators = np.zeros((count, MOTORS))
        self._fleet.actuators = self._actuators
        self._last: Time | None = None

    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        """Take the sensors and the mail of a tick, and act on both; the answer waits for `finish`."""
        fleet = self._fleet
        fleet.now = tick
        fleet.outbox = Outbox()
        fleet.rotors = sensors.rotor_radps
        dt_s = (tick - self._last) / NS_PER_S if self._last is not None and tick > self._last else QUANTUM_S
        self._last = tick
        tuning = self._tuning
        tuning.renew(tick, dt_s)
        if self._estimator.update(
            tick, dt_s, sensors, fleet.estimate, fleet.flight["armed"], tuning.which, tuning.sets
        ):
            resets.tell(fleet, self._estimator.filters)
        if len(inbox):
            mail = inbox.columns(self._places)
            if self._signed is not None:
                mail = self._signed.open(tick, inbox, mail, fleet.outbox)
            for row in take_heartbeats(fleet, mail):
                self._receive(inbox.arrival(mail.order.item(row)))
        if loop.turn(
            fleet.estimate, fleet.flight, fleet.legs, tuning.which, tuning.gains, tuning.sets, self._actuators, dt_s
        ):
            self._act_on_flags()
        if tick % SERVICE_NS == 0:
            self._act_on_timers(tick)
            service.serve(fleet, self._actuators)
            self._schedule.send_due(fleet)
        if self._signed is not None:
            for vehicle in fleet.rebooted:
                self._signed.start(tick, vehicle)
            self._signed.seal(tick, fleet.outbox)
        fleet.rebooted.clear()

    def finish(self, tick: Time, wall_deadline_s: float) -> Finished:
        """Motor commands (n, 4), and what was said in this tick. Never waits."""
        return Finished(self._actuators, self._fleet.outbox)

    def _receive(self, arrival: Arrival) -> None:
        """Act on one frame, as ArduPilot's routing lets it through (MAVLink_routing.cpp)."""
        fleet = self._fleet
        craft = fleet.crafts[self._places[arrival.port]]
        try:
            message = decode(arrival.payload)
        except DecodeError as error:
            craft.bad_frames += 1
            fleet.note("event.bad_frame", craft, {"error": str(error)[:200]}, (arrival.ref,))
            return
        partner = (message.get_srcSystem(), message.get_srcComponent())
        if partner == (craft.system_id, COMPONENT):
            return  # an echo of our own
        if _refuses(fleet, craft, message, partner[0]):
            craft.ignored += 1
            return
        # no other component is on board, so one that is named but unknown is taken as this one
        addressee = getattr(message, "target_system", getattr(message, "target", craft.system_id))
        if addressee not in (0, craft.system_id):
            craft.ignored += 1
            return
        if craft.paused:
            pausing.lift(fleet, craft)
        self._obey(craft, message, partner, (arrival.ref,))
        if craft.paused:
            pausing.settle(fleet, craft)

    def _obey(self, craft: Craft, message: Any, partner: tuple[int, int], causes: Causes) -> None:
        """Hand a message to what acts on it."""
        fleet = self._fleet
        number = message.get_msgId()
        handler = _HANDLERS.get(number)
        if handler is not None:
            handler(fleet, craft, message, partner, causes)
        elif number in _COMMANDS:
            commands.on_command(fleet, self._schedule, craft, message, partner, causes)
        elif number == _ID.MAVLINK_MSG_ID_SET_MODE:
            flying.choose_mode(fleet, craft, message.base_mode, message.custom_mode, causes)  # never acknowledged
        elif number == _ID.MAVLINK_MSG_ID_REQUEST_DATA_STREAM:
            streams.on_request(fleet, self._schedule, craft, message)

    def _act_on_flags(self) -> None:
        """Let modes and missions know what the loop has seen."""
        fleet = self._fleet
        flight = fleet.flight
        for row in np.flatnonzero(flight["flags"] & ~flight["seen"]).tolist():
            craft = fleet.crafts[row]
            fresh = int(flight["flags"][row] & ~flight["seen"][row])
            flight["seen"][row] = flight["flags"][row]
            for flag in _FLAGS:
                if fresh & flag:
                    _on_flag(fleet, craft, flag)

    def _act_on_timers(self, now: Time) -> None:
        fleet = self._fleet
        if fleet.next_timer > now:
            return
        fleet.next_timer = NEVER  # what is set meanwhile counts; of the rest the soonest is found below
        for row, column in np.argwhere(fleet.timers <= now).tolist():
            craft = fleet.crafts[row]
            if fleet.timers[row, column] <= now:  # an earlier one may have cleared it
                fleet.timers[row, column] = NEVER
                if craft.paused:
                    pausing.lift(fleet, craft)
                _TIMERS[Timer(column)](fleet, craft)
                if craft.paused:
                    pausing.settle(fleet, craft)
        fleet.next_timer = min(fleet.next_timer, int(fleet.timers.min()))


def _refuses(fleet: Fleet, craft: Craft, message: Any, system: int) -> bool:
    """Whether SYSID_ENFORCE keeps this sender out (`accept_packet`): all but its own components and ground station."""
    if fleet.param(craft, "SYSID_ENFORCE") == 0.0 or message.get_msgId() in _RADIO:
        return False
    return system not in (craft.system_id, int(fleet.param(craft, "SYSID_MYGCS")))


def _on_flag(fleet: Fleet, craft: Craft, flag: Flag) -> None:
    if flag is Flag.CLIMBED:
        fence.after_takeoff(fleet, craft)
    if flag is Flag.LIFTED:
        fleet.note("event.takeoff", craft, {}, craft.target_causes)
    elif flag is Flag.LANDED:
        fleet.note("event.landed", craft, {}, craft.mode_causes)
        settles = craft.mode in (Mode.LAND, Mode.RTL, Mode.AUTO)
        spool_ns = int(fleet.param(craft, "MOT_SPOOL_TIME") * NS_PER_S)
        fleet.timer(craft, Timer.LANDED, fleet.now + spool_ns if settles else NEVER)
        fleet.timer(craft, Timer.IDLE, idle_end(fleet, craft))
    elif flag is Flag.CRASHED:
        crash.crashed(fleet, craft)
    elif craft.mode == Mode.AUTO:
        navigator.on_flag(fleet, craft, flag)
    elif craft.mode == Mode.RTL and flag is Flag.ARRIVED:
        returning.arrived(fleet, craft)


def _on_hold(fleet: Fleet, craft: Craft) -> None:
    if craft.mode == Mode.AUTO:
        navigator.waited(fleet, craft)
    elif craft.mode == Mode.RTL:
        returning.waited(fleet, craft)


def _on_landed(fleet: Fleet, craft: Craft) -> None:
    if craft.mode == Mode.AUTO:
        navigator.settled(fleet, craft)
    elif craft.mode in (Mode.LAND, Mode.RTL):
        disarm(fleet, craft, "landed", craft.mode_causes)


def _on_idle(fleet: Fleet, craft: Craft) -> None:
    if not (fleet.armed(craft) and fleet.landed(craft)):
        return
    if sticks_in.throttle(fleet, craft) > 0.0:  # a raised throttle puts it off (auto_disarm_check)
        fleet.timer(craft, Timer.IDLE, idle_end(fleet, craft))
    else:
        disarm(fleet, craft, "disarm_delay", ())


_TIMERS: dict[Timer, Callable[[Fleet, Craft], None]] = {
    Timer.UPLOAD: mission_protocol.on_timer,
    Timer.HOLD: _on_hold,
    Timer.LANDED: _on_landed,
    Timer.IDLE: _on_idle,
    Timer.STALE: targets.stale,
    Timer.PARAMS: parameter_protocol.on_timer,
    Timer.STICKS: piloting.on_timer,
    Timer.CONDITION: do_items.look,
}


def _check(name: str, specs: Sequence[VehicleSpec]) -> None:
    """Raise `InputError` with everything that is wrong with the specs."""
    faults = []
    if not specs:
        faults.append(Fault("vehicles", "none", "at least one vehicle"))
    for spec in specs:
        if spec.airframe not in AIRFRAMES:
            faults.append(
                Fault(f"{spec.vehicle} airframe", spec.airframe, "a known airframe", nearest(spec.airframe, AIRFRAMES))
            )
        if not 1 <= spec.system_id <= 250:
            faults.append(Fault(f"{spec.vehicle} system_id", str(spec.system_id), "1 to 250"))
        if not all(math.isfinite(part) for part in (*spec.home_enu_m, spec.heading_deg)):
            faults.append(Fault(f"{spec.vehicle} home", str((spec.home_enu_m, spec.heading_deg)), "finite numbers"))
    if faults:
        raise InputError(f"builtin autopilot {name}", faults)


def _make(params: NoParams, context: AutopilotContext) -> BuiltinFleet:
    return BuiltinFleet(context.name, context.specs, context.origin, context.epoch, context.chance)


BUILTIN = AutopilotPlugin(NoParams, _make, "Flies as ArduCopter does, by the range's own code.", signs=True)
"""The autopilot `builtin`. Raises `InputError` as `BuiltinFleet` does."""
