"""ArduPilot as an engine: one SITL process per aircraft, in lockstep with our world.

Every tick each process gets the tick's sensors, all compute side by side, and the tick ends when all have answered. No
clock of the machine takes part: the same inputs give the same bytes. The serial port 0 of each is the link
`autopilot`; port 1 is private and carries GNSS.
"""

from __future__ import annotations

from collections.abc import Sequence
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
from skyrange.core.errors import ComponentError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import Port, endpoint, link_name
from skyrange.core.time import NS_PER_MS, NS_PER_S, Epoch, Time
from skyrange.io.sitl import Sitl, wall_s
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
START_S = 30.0
"""Wall seconds in which a process has to have come up."""


class Options(Params):
    """How the ArduPilot processes of a scenario are run."""

    keep_logs: bool = Field(default=False, description="Write DataFlash logs, and keep them in the run's folder.")


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
        self._specs = tuple(specs)
        self._origin, self._epoch = origin, epoch
        self._home_up_m = np.array([spec.home_enu_m[2] for spec in specs])
        self.ports = [Port(endpoint(v, "autopilot"), link_name("autopilot", v)) for v in self.vehicles]
        self._places = {port: place for place, port in enumerate(self.ports)}
        self._receivers = Receivers(len(specs), origin, epoch)
        for spec in specs:  # before anything starts
            parameters.start_values(spec.vehicle, AIRFRAMES[spec.airframe], spec.params, self._listed, 0)
        self._folder: TemporaryDirectory[str] | None = None
        self._instances: list[_Instance] = []
        self._tick: Time = 0
        self._before: Motion | None = None
        self._now: Motion | None = None
        self._commands = np.zeros((len(specs), MOTORS))
        self.manifest = {"version": self.binary.version, "sha256": self.binary.sha256, "binary": str(self.binary.path)}

    def __deepcopy__(self, memo: dict[int, Any]) -> ArduPilotFleet:
        raise ComponentError(f"engine {self.name}", "its programs cannot be copied", "Fork a run of builtin autopilots")

    # ---------------------------------------------------------------- the processes

    def _start(self, tick: Time, sensors: Sensors) -> None:
        """Start all processes at once, then wait until the last of them has spoken."""
        self._folder = TemporaryDirectory(prefix="skyrange-")
        for row, spec in enumerate(self._specs):
            lag_ms = int(tick - sensors.gnss_time_ns[row]) // NS_PER_MS
            values = parameters.start_values(spec.vehicle, AIRFRAMES[spec.airframe], spec.params, self._listed, lag_ms)
            per_tick, ticks = parameters.steps_of(values, self._listed, QUANTUM_NS / NS_PER_S)
            packer = Packer(spec.system_id, dialect.MAV_COMP_ID_GPS)
            self._instances.append(_Instance(spec, values, per_tick, ticks, packer))
        for one in self._instances:
            folder = Path(self._folder.name) / one.spec.vehicle.replace("/", "-")
            folder.mkdir()
            east_m, north_m, up_m = one.spec.home_enu_m
            lat_deg, lon_deg = self._origin.geodetic_of(east_m, north_m)
            one.sitl = Sitl(
                f"arducopter of {one.spec.vehicle}",
                self.binary.path,
                folder,
                home=(lat_deg, lon_deg, self._origin.alt_msl_m + up_m, one.spec.heading_deg % 360.0),
                system_id=one.spec.system_id,
                start_unix_s=(self._epoch.unix_ns + tick) // NS_PER_S,
                parameters=parameters.text_of(one.values),
            )
        deadline = wall_s() + START_S
        for one in self._instances:
            assert one.sitl is not None
            if one.sitl.servos(deadline) is None:
                raise one.sitl.lost(f"did not come up within {START_S:g} s")

    def close(self) -> None:
        """End the processes. Again does nothing."""
        for one in self._instances:
            if one.sitl is not None:
                one.sitl.close()
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    # ---------------------------------------------------------------- a tick

    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        """Hand everyone its mail, its fix and the first step of the tick."""
        if not self._instances:
            self._start(tick, sensors)
        self._tick = tick
        for arrival in inbox:
            one = self._instances[self._places[arrival.port]]
            if one.alive and one.sitl is not None:
                one.sitl.write(0, arrival.payload)
                one.witness.uploaded(arrival.payload)
        for row in self._receivers.fresh(sensors, QUANTUM_NS):
            one = self._instances[row]
            if one.alive and one.sitl is not None:
                one.sitl.write(1, one.onboard.pack(self._receivers.message(sensors, row)))
        after = motion_of(sensors, self._home_up_m)
        self._before, self._now = (self._now if self._now is not None else after), after
        self._send(0)

    def _send(self, turn: int) -> None:
        """Give each process that has more than `turn` steps in this tick that one."""
        assert self._before is not None
        assert self._now is not None
        due = [
            row
            for row, one in enumerate(self._instances)
            if one.alive and turn < one.per_tick and (self._tick // QUANTUM_NS) % one.ticks == 0
        ]
        stamps = [stamp_s(one.steps + 1, one.step_ns) for one in self._instances]
        for per_tick in {self._instances[row].per_tick for row in due}:
            told = lines(stamps, between(self._before, self._now, (turn + 1) / per_tick))
            for row in due:
                one = self._instances[row]
                if one.per_tick == per_tick:
                    assert one.sitl is not None
                    one.sitl.send(told[row])
                    one.steps += 1

    def finish(self, tick: Time, wall_deadline_s: float) -> Finished:
        """Motor commands, and what was said; whoever has not answered by the deadline is given up."""
        deadline = wall_s() + wall_deadline_s
        outbox = Outbox()
        most = max(one.per_tick for one in self._instances)
        for turn in range(most):
            if turn:
                self._send(turn)
            for row, one in enumerate(self._instances):
                if one.alive and turn < one.per_tick and not (tick // QUANTUM_NS) % one.ticks:
                    self._collect(row, one, deadline)
        for row, one in enumerate(self._instances):
            if one.alive:
                self._hear(tick, row, one, outbox)
        return Finished(self._commands, outbox, [one.status for one in self._instances])

    def _collect(self, row: int, one: _Instance, deadline: float) -> None:
        assert one.sitl is not None
        widths = one.sitl.servos(deadline)
        if widths is not None:
            self._commands[row] = commands_of(widths)
            return
        one.status = InstanceStatus.SILENT if one.sitl.program.running else InstanceStatus.DEAD
        self._commands[row] = 0.0  # speed controllers without a signal stop

    def _hear(self, tick: Time, row: int, one: _Instance, outbox: Outbox) -> None:
        """Take what it has said; before time 0 nobody listens."""
        sitl = one.sitl
        assert sitl is not None
        if not sitl.accept():
            return
        for piece in one.private.feed(sitl.read(1)):
            if not piece.garbage:
                for kind, data in one.witness.reported(tick, decode(piece.data)):
                    if tick >= 0:
                        outbox.note(kind, one.spec.vehicle, data)
        for piece in one.deframer.feed(sitl.read(0)):
            if tick >= 0:
                outbox.send(self.ports[row], piece.data)
                for kind, data in one.witness.said(piece.data) if not piece.garbage else ():
                    outbox.note(kind, one.spec.vehicle, data)
        if one.status is InstanceStatus.BOOTING:
            if one.witness.mode >= 0 and one.asked < len(REPORTS):
                self._ask(one)
            if one.witness.flags & POSITIONED:
                one.status = InstanceStatus.READY

    def _ask(self, one: _Instance) -> None:
        """Ask the private port for its next report."""
        number, rate_hz = list(REPORTS.items())[one.asked]
        ask = dialect.MAVLink_command_long_message(
            one.spec.system_id, 1, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0, number, 1e6 / rate_hz, 0, 0, 0, 0, 0
        )
        assert one.sitl is not None
        one.asked += one.sitl.write(1, one.onboard.pack(ask))
