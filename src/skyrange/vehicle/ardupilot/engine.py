"""ArduPilot as an engine: one SITL process per aircraft, in lockstep with our world.

Every tick each process gets the tick's sensors, all compute side by side, and the tick ends when all have answered. No
clock of the machine takes part: the same inputs give the same bytes. The serial port 0 of each is the link
`autopilot`; port 1 is private and carries GNSS.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
from pydantic import Field

from skyrange.agent.contracts import Finished, InstanceStatus, Sensors
from skyrange.agent.messages import Inbox, Outbox
from skyrange.agent.settings import Params
from skyrange.codec.mavlink import Deframer, Packer, decode, dialect
from skyrange.core.chance import Chance
from skyrange.core.errors import ComponentError, Fault, InputError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import Port, endpoint, link_name
from skyrange.core.time import NS_PER_MS, NS_PER_S, Epoch, Time
from skyrange.io.programs import make_room
from skyrange.io.sitl import FILES, Sitl, Switchboard, check_free, wall_s
from skyrange.vehicle.ardupilot import parameters
from skyrange.vehicle.ardupilot.binary import find
from skyrange.vehicle.ardupilot.gnss import Receivers
from skyrange.vehicle.ardupilot.inventory import parameters_of
from skyrange.vehicle.ardupilot.packets import Motion, between, commands_of, lines, motion_of, stamp_s
from skyrange.vehicle.ardupilot.witness import POSITIONED, REPORTS, Witness
from skyrange.vehicle.spec import VehicleSpec
from skyrange.world.airframes import AIRFRAMES, MOTORS

QUANTUM_NS: Time = 2_500_000
"""The world's tick; the first exchange tells whether it is."""
PREROLL_NS: Time = 45 * NS_PER_S
"""Until an ArduPilot that stands still may be armed: so long its estimator looks at compass and GNSS."""
_TRIES = 5
PRIVATE = 1
"""The serial port that no ground station hears."""
START_S = 60.0
"""Wall seconds in which a process has to have come up, and in which it has to answer while it boots."""
PORT_STEP = 10
"""Between the open ports of two processes, as between two instances of SITL."""
OPEN = 2
"""The serial port that they are."""


class Options(Params):
    """How the ArduPilot processes of a scenario are run."""

    keep_logs: bool = Field(default=False, description="Write DataFlash logs, and keep them in the run's folder.")
    open_port: int = Field(
        default=0,
        ge=0,
        le=65_535,
        description="A TCP port, on all interfaces, where the first ArduPilot obeys a ground station; each next one's "
        "is 10 higher. 0: none.",
    )

    def opened(self, count: int) -> list[int]:
        """The ports where `count` processes let ground stations in themselves; none unless it is asked for."""
        return [self.open_port + PORT_STEP * place for place in range(count)] if self.open_port else []


@dataclass(slots=True)
class _Instance:
    """One aircraft's process and what is known of it."""

    spec: VehicleSpec
    values: dict[str, float]
    per_tick: int
    ticks: int
    """Exchanges per tick, ticks per exchange: one of them is 1."""
    onboard: Packer
    """Ours on the private port."""
    sitl: Sitl | None = None
    steps: int = 0
    status: InstanceStatus = InstanceStatus.BOOTING
    deframer: Deframer = field(default_factory=Deframer)
    private: Deframer = field(default_factory=Deframer)
    witness: Witness = field(default_factory=Witness)
    asked: int = 0
    """How many of `witness.REPORTS` the private port has been asked for."""

    @property
    def step_ns(self) -> Time:
        """Between two exchanges."""
        return QUANTUM_NS * self.ticks // self.per_tick

    @property
    def alive(self) -> bool:
        return self.status in (InstanceStatus.BOOTING, InstanceStatus.READY)


class ArduPilotFleet:
    """The engine (contract: `agent.contracts.Engine`). Its processes start with its first tick and end with `close`."""

    options = Options
    service_ns: Time = QUANTUM_NS
    clock: Literal["lockstep", "wall"] = "lockstep"
    repeatable: Literal["bytes", "outcome"] = "bytes"
    preroll_ns: Time = PREROLL_NS
    moves: Sequence[str] = ()

    def __init__(
        self,
        name: str,
        specs: Sequence[VehicleSpec],
        origin: Origin,
        epoch: Epoch,
        chance: Chance,
        options: Options | None = None,
    ) -> None:
        """Find the binary and check all parameters against its list; nothing keeps running.

        Raises `InputError` where there is no binary or a parameter is wrong.
        """
        self.name = name
        self.vehicles = [spec.vehicle for spec in specs]
        self.binary = find()
        self._options = options or Options()
        self._listed = parameters_of(self.binary.path, self.binary.sha256)
        check_free(self._options.opened(len(specs)), "options.ardupilot.open_port")
        if self._options.open_port:
            self.repeatable = "outcome"  # who connects, and when, no seed says
        self._specs = tuple(specs)
        self._origin, self._epoch = origin, epoch
        self._home_up_m = np.array([spec.home_enu_m[2] for spec in specs])
        self.ports = [Port(endpoint(v, "autopilot"), link_name("autopilot", v)) for v in self.vehicles]
        self._places = {port: place for place, port in enumerate(self.ports)}
        self._receivers = Receivers(len(specs), origin, epoch)
        _check(name, specs, self._listed)
        self._folder: TemporaryDirectory[str] | None = None
        self._instances: list[_Instance] = []
        self._switchboard = Switchboard()
        self._motion: Motion | None = None
        """At the last tick."""
        self._lines: dict[tuple[int, int], list[bytes]] = {}
        """What each is sent in this tick, by exchanges per tick and which of them."""
        self._due: list[int] = []
        self._commands = np.zeros((len(specs), MOTORS))
        self.manifest = {"version": self.binary.version, "sha256": self.binary.sha256, "binary": str(self.binary.path)}

    def __deepcopy__(self, memo: dict[int, Any]) -> ArduPilotFleet:
        raise ComponentError(f"engine {self.name}", "its programs cannot be copied", "Fork a run of builtin autopilots")

    # ---------------------------------------------------------------- the processes

    def _start(self, tick: Time, sensors: Sensors) -> None:
        """Start all processes at once, then wait until the last of them has spoken."""
        make_room(FILES * len(self._specs), f"engine {self.name}")
        self._folder = TemporaryDirectory(prefix="skyrange-")
        for row, spec in enumerate(self._specs):
            lag_ms = int(tick - sensors.gnss_time_ns[row]) // NS_PER_MS
            values = parameters.start_values(spec.vehicle, AIRFRAMES[spec.airframe], spec.params, self._listed, lag_ms)
            if self._options.keep_logs:
                values["LOG_BACKEND_TYPE"] = 1.0
            per_tick, ticks = parameters.steps_of(values, self._listed, QUANTUM_NS / NS_PER_S)
            packer = Packer(spec.system_id, dialect.MAV_COMP_ID_GPS)
            self._instances.append(_Instance(spec, values, per_tick, ticks, packer))
        for row, one in enumerate(self._instances):
            one.sitl = self._launch(row, tick, "")
        deadline = wall_s() + START_S
        taken: set[int] = set()
        for row, one in enumerate(self._instances):
            for again in range(_TRIES):
                assert one.sitl is not None
                if one.sitl.servos(deadline) is None:
                    raise one.sitl.lost(f"did not come up within {START_S:g} s")
                if one.sitl.port not in taken:
                    break
                one.sitl.close()  # it shares its port with another, and one of them would not hear us
                one.sitl = self._launch(row, tick, f"-{again + 2}")
            assert one.sitl is not None
            taken.add(one.sitl.port)

    def _launch(self, row: int, tick: Time, suffix: str) -> Sitl:
        assert self._folder is not None
        one, opened = self._instances[row], self._options.opened(len(self._instances))
        folder = Path(self._folder.name) / (one.spec.vehicle.replace("/", "-") + suffix)
        folder.mkdir()
        east_m, north_m, up_m = one.spec.home_enu_m
        lat_deg, lon_deg = self._origin.geodetic_of(east_m, north_m)
        return Sitl(
            f"arducopter of {one.spec.vehicle}",
            self.binary.path,
            folder,
            home=(lat_deg, lon_deg, self._origin.alt_msl_m + up_m, one.spec.heading_deg % 360.0),
            system_id=one.spec.system_id,
            start_unix_s=(self._epoch.unix_ns + tick) // NS_PER_S,
            parameters=parameters.text_of(one.values),
            options=(f"--serial{OPEN}", f"tcp:{opened[row]}") if opened else (),
        )

    def leaves(self) -> Mapping[str, Path]:
        """The DataFlash logs to be kept, by their names in the run's folder; they are there until `close`."""
        if not self._options.keep_logs or self._folder is None:
            return {}
        return {
            f"dataflash/{one.spec.vehicle.replace('/', '-')}{'' if number == 0 else f'-{number + 1}'}.bin": log
            for one in self._instances
            if one.sitl is not None
            for number, log in enumerate(sorted((one.sitl.folder / "logs").glob("*.BIN")))
        }

    def close(self) -> None:
        """End the processes. Again does nothing."""
        for one in self._instances:
            if one.sitl is not None:
                one.sitl.close()
        self._switchboard.close()
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    @property
    def cpu_s(self) -> float:
        """Processor time that the processes have taken so far, in seconds."""
        return sum(one.sitl.program.cpu_s for one in self._instances if one.sitl is not None)

    # ---------------------------------------------------------------- a tick

    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        """Hand everyone its mail, its fix and the first step of the tick."""
        if not self._instances:
            self._start(tick, sensors)
        for arrival in inbox:
            one = self._instances[self._places[arrival.port]]
            if one.alive and one.sitl is not None:
                one.sitl.write(0, arrival.payload)
                one.witness.uploaded(arrival.payload)
        for row in self._receivers.fresh(sensors):
            one = self._instances[row]
            if one.alive and one.sitl is not None:
                one.sitl.write(1, one.onboard.pack(self._receivers.message(sensors, row)))
        after = motion_of(sensors, self._home_up_m)
        before, self._motion = (self._motion if self._motion is not None else after), after
        due = [row for row, one in enumerate(self._instances) if one.alive and (tick // QUANTUM_NS) % one.ticks == 0]
        self._lines = {}
        for per_tick in {self._instances[row].per_tick for row in due}:
            for turn in range(per_tick):
                stamps = [stamp_s(one.steps + turn + 1, one.step_ns) for one in self._instances]
                self._lines[per_tick, turn] = lines(stamps, between(before, after, (turn + 1) / per_tick))
        self._due = due
        for row in due:
            self._send(row, 0)

    def _send(self, row: int, turn: int) -> None:
        """Let a process compute a step of the tick."""
        one = self._instances[row]
        assert one.sitl is not None
        one.sitl.send(self._lines[one.per_tick, turn][row])
        one.steps += 1

    def finish(self, tick: Time, wall_deadline_s: float) -> Finished:
        """Motor commands, and what was said; whoever has not answered by the deadline is given up."""
        booting = any(one.status is InstanceStatus.BOOTING for one in self._instances)
        deadline = wall_s() + (max(START_S, wall_deadline_s) if booting else wall_deadline_s)
        outbox = Outbox()
        answers: dict[int, bytes] = {}
        due, turn = self._due, 0
        while due:
            for row in due:
                answer = self._answer(row, deadline, outbox)
                if answer is not None:
                    answers[row] = answer
                    if turn + 1 < self._instances[row].per_tick:
                        self._send(row, turn + 1)
            turn += 1
            due = [row for row in due if row in answers and turn < self._instances[row].per_tick]
        if answers:
            self._commands[[*answers]] = commands_of([*answers.values()])
        for row, one in enumerate(self._instances):
            if not one.alive:
                self._commands[row] = 0.0  # speed controllers without a signal stop
        self._hear(tick, outbox)
        return Finished(self._commands, outbox, [one.status for one in self._instances])

    def _answer(self, row: int, deadline: float, outbox: Outbox) -> bytes | None:
        one = self._instances[row]
        assert one.sitl is not None
        restarts, program = one.sitl.restarts, one.sitl.program
        answer = one.sitl.servos(deadline)
        if answer is None:
            one.status = InstanceStatus.SILENT if program.running else InstanceStatus.DEAD
            how = {"ended": program.ended, "said": program.last_words()}
            outbox.note("event.autopilot_lost", one.spec.vehicle, how)
            program.kill()  # should it wake up, its time has passed
        elif one.sitl.restarts > restarts:
            one.steps, one.asked, one.witness = 0, 0, Witness()
            outbox.note("event.reboot", one.spec.vehicle, {"system_id": one.spec.system_id})
        return answer

    def _hear(self, tick: Time, outbox: Outbox) -> None:
        """Take what they have said; before time 0 nobody listens."""
        for row, one in enumerate(self._instances):
            if one.alive and one.sitl is not None and not one.sitl.connected:
                for place in one.sitl.accept():
                    self._switchboard.add(row, place, one.sitl)
        for row, place in self._switchboard.speaking():
            one = self._instances[row]
            assert one.sitl is not None
            data = one.sitl.read(place)
            if place == PRIVATE:
                self._learn(tick, one, data, outbox)
            else:
                self._pass_on(tick, row, one, data, outbox)

    def _learn(self, tick: Time, one: _Instance, data: bytes, outbox: Outbox) -> None:
        """Its private port tells how it is."""
        for piece in one.private.feed(data):
            if piece.garbage:
                continue
            for kind, told in one.witness.reported(tick, decode(piece.data)):
                if tick >= 0:
                    outbox.note(kind, one.spec.vehicle, told)
        if one.witness.mode >= 0 and one.asked < len(REPORTS):
            self._ask(one)
        if one.status is InstanceStatus.BOOTING and one.witness.flags & POSITIONED:
            one.status = InstanceStatus.READY

    def _pass_on(self, tick: Time, row: int, one: _Instance, data: bytes, outbox: Outbox) -> None:
        """Its public port is the link `autopilot`."""
        for piece in one.deframer.feed(data):
            if tick < 0:
                continue
            outbox.send(self.ports[row], piece.data)
            if not piece.garbage:
                for kind, told in one.witness.said(piece.data):
                    outbox.note(kind, one.spec.vehicle, told)

    def _ask(self, one: _Instance) -> None:
        """Ask the private port for its next report."""
        number, rate_hz = list(REPORTS.items())[one.asked]
        ask = dialect.MAVLink_command_long_message(
            one.spec.system_id, 1, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0, number, 1e6 / rate_hz, 0, 0, 0, 0, 0
        )
        assert one.sitl is not None
        one.asked += one.sitl.write(1, one.onboard.pack(ask))


def _check(name: str, specs: Sequence[VehicleSpec], listed: Mapping[str, float]) -> None:
    """Raise `InputError` with every parameter of every aircraft that is wrong."""
    faults = []
    for spec in specs:
        try:
            parameters.start_values(spec.vehicle, AIRFRAMES[spec.airframe], spec.params, listed, 0)
        except InputError as error:
            faults += [Fault(f"{spec.vehicle}.params.{f.where}", f.value, f.expected, f.hint) for f in error.faults]
    if faults:
        raise InputError(f"autopilot {name}", faults)
