"""Common base of fleets of ArduPilot processes: parameters, start, arriving frames, GNSS fixes, reports, and shutdown.

`lockstep_fleet` and `native_fleet` differ in whose physics moves the aircraft, and so in how time passes. In both,
serial port 0 of each process is the link `autopilot`; port 1 is private: GNSS fixes go in, and reports about its state
come out. If MAVLink is signed or may become so, the ports are swapped (`parameters.swap_serial_ports`).

Clock offsets of processes: how far their clocks are from the run's, and from one another.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np

from skyrange.codec.mavlink import Deframer, Message, Packer, decode, dialect
from skyrange.codec.mavlink.signing import is_signed
from skyrange.contracts.components import EngineBase, Finished, InstanceStatus, Sensors
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.core.errors import ComponentError, InputError, Problem
from skyrange.core.geodesy import Origin
from skyrange.core.ids import Port, endpoint, link_name
from skyrange.core.time import NS_PER_MS, NS_PER_S, Epoch, Time
from skyrange.io.ardupilot.sitl import FILES, SerialPoller, Sitl, check_free
from skyrange.io.processes.program import raise_file_limit
from skyrange.vehicle.ardupilot import parameters
from skyrange.vehicle.ardupilot.arducopter_binary import find_binary
from skyrange.vehicle.ardupilot.gps_input import GnssReceivers
from skyrange.vehicle.ardupilot.options import ProcessOptions
from skyrange.vehicle.ardupilot.parameters import list_parameters
from skyrange.vehicle.contract import VehicleSpec
from skyrange.vehicle.event_detection import POSITION_VALID_FLAG, REPORTS, EventDetector
from skyrange.world.airframes import MOTORS


class ClockOffsets:
    """Statistics of each process's clock against the run's; positive is ahead."""

    def __init__(self) -> None:
        self._last: dict[int, Time] = {}
        self._count = 0
        self._total = 0
        self._max = 0
        self._between = 0

    def record(self, row: int, ahead_ns: Time) -> None:
        """A report of process `row` was this far ahead of the tick in which it was read."""
        self._last[row] = ahead_ns
        self._count += 1
        self._total += abs(ahead_ns)
        self._max = max(self._max, abs(ahead_ns))
        self._between = max(self._between, max(self._last.values()) - min(self._last.values()))

    def forget(self, row: int) -> None:
        """Forget a process that was restarted or has ended."""
        self._last.pop(row, None)

    @property
    def summary(self) -> dict[str, float]:
        """`mean` and `max` distance from the run's clock, and the largest distance `between` two processes, ms; {}
        without data.
        """
        if not self._count:
            return {}
        parts = {"mean": self._total / self._count, "max": self._max, "between": self._between}
        return {name: round(part / NS_PER_MS, 3) for name, part in parts.items()}


QUANTUM_NS: Time = 2_500_000
"""The world's tick; in lockstep any other is refused."""
WARM_UP_NS: Time = 45 * NS_PER_S
"""Time until an ArduPilot at rest may be armed: its estimator observes compass and GNSS for that long."""
PRIVATE = 1
"""Index of the serial port that no ground station receives."""
START_S = 60.0
"""Wall seconds in which a process has to start, and in which it has to answer while it boots."""
OPEN = 2
"""Index of the serial port on which a ground station may connect."""


@dataclass(slots=True)
class Instance:
    """One aircraft's process and what is known of it."""

    spec: VehicleSpec
    values: Mapping[str, float]
    """Its parameters that differ from the firmware's defaults."""
    arguments: Mapping[str, Any]
    """The arguments its process was started with."""
    sitl: Sitl
    onboard: Packer
    """Packs our frames on the private port."""
    events: EventDetector
    status: InstanceStatus = InstanceStatus.BOOTING
    deframer: Deframer = field(default_factory=Deframer)
    private: Deframer = field(default_factory=Deframer)
    asked: int = 0
    """How many reports were requested on the private port."""
    signs: bool = False
    """Whether the frames on its public port are signed."""

    @property
    def alive(self) -> bool:
        """Whether it is booting or ready."""
        return self.status in (InstanceStatus.BOOTING, InstanceStatus.READY)

    def restarted(self, outbox: Outbox) -> None:
        """It has rebooted: forget what was known of it."""
        self.asked, self.events = 0, self.events.renew()
        outbox.note("event.reboot", self.spec.vehicle, {"system_id": self.spec.system_id})

    def lose(self, status: InstanceStatus, outbox: Outbox) -> None:
        """It has ended or is silent: end it, because it could not catch up."""
        self.status = status
        program = self.sitl.program
        outbox.note("event.autopilot_lost", self.spec.vehicle, {"ended": program.ended, "said": program.last_words()})
        program.kill()


class ProcessFleet(EngineBase, ABC):
    """An engine (contract: `contracts.components.Engine`). Its processes start with its first tick and end with
    `close`.
    """

    physics: Literal["shared", "native"]
    service_ns: Time = QUANTUM_NS
    clock: Literal["lockstep", "wall"]
    repeatable: Literal["bytes", "outcome"]
    preroll_ns: Time
    moves: Sequence[str] = ()
    runs_programs = True
    reports: Mapping[int, float] = REPORTS
    """The reports requested on the private port, in Hz."""

    def __init__(
        self, name: str, specs: Sequence[VehicleSpec], origin: Origin, epoch: Epoch, options: ProcessOptions
    ) -> None:
        """Find the binary and check all parameters against its list; no process is left running.

        Raises `InputError` if there is no binary or a parameter is wrong.
        """
        self.name = name
        self.vehicles: Sequence[str] = [spec.vehicle for spec in specs]
        self.binary = find_binary()
        self._options = options
        self._listed = list_parameters(self.binary.path, self.binary.sha256)
        check_free(options.opened(len(specs)), f"options.{name}.open_port")
        if options.open_port:
            self.repeatable = "outcome"  # no seed determines who connects, and when
        self._specs = tuple(specs)
        self._origin, self._epoch = origin, epoch
        self.ports: Sequence[Port] = [Port(endpoint(v, "autopilot"), link_name("autopilot", v)) for v in self.vehicles]
        self._places = {port: place for place, port in enumerate(self.ports)}
        self._receivers = GnssReceivers(len(specs), origin, epoch)
        self._check()
        self._folder: TemporaryDirectory[str] | None = None
        self._instances: list[Instance] = []
        self._poller = SerialPoller()
        self._unconnected: set[int] = set(range(len(specs)))
        """Rows of which not all serial ports are connected."""
        self._commands = np.zeros((len(specs), MOTORS))
        self._clock_offsets = ClockOffsets()

    def __deepcopy__(self, memo: dict[int, Any]) -> ProcessFleet:
        raise ComponentError(f"engine {self.name}", "its programs cannot be copied", "Fork a run of builtin autopilots")

    @property
    def manifest(self) -> dict[str, Any]:
        """Its entry in the record; after a flight also how far the processes' clocks were from the run's, in ms."""
        entry = {
            "version": self.binary.version,
            "sha256": self.binary.sha256,
            "binary": str(self.binary.path),
            "physics": self.physics,
        }
        return entry | ({"skew_ms": self._clock_offsets.summary} if self._clock_offsets.summary else {})

    # ---------------------------------------------------------------- the processes

    @abstractmethod
    def _values(self, spec: VehicleSpec, gnss_lag_ms: int) -> dict[str, float]:
        """The parameters of one aircraft. Raises `InputError` with everything that is wrong with the given ones."""

    @abstractmethod
    def _start_process(self, **arguments: Any) -> Sitl:
        """Start a process; `arguments` are those that every `Sitl` takes."""

    def _check(self) -> None:
        """Raise `InputError` with every parameter of every aircraft that is wrong, or that the firmware refuses."""
        problems = []
        for spec in self._specs:
            try:
                text = parameters.defaults_text(self._values(spec, 0))
                spec_problems = [*self._refused(spec, text)] if spec.params else []
            except InputError as error:
                spec_problems = list(error.problems)
            problems += [
                Problem(f"{spec.vehicle}.params.{f.where}", f.value, f.expected, f.hint) for f in spec_problems
            ]
        if problems:
            raise InputError(f"autopilot {self.name}", problems)

    def _refused(self, spec: VehicleSpec, text: str) -> Iterator[Problem]:
        reported = list_parameters(self.binary.path, self.binary.sha256, text)
        return parameters.changed_by_firmware(spec.params, self._listed, reported)

    def _start(self, tick: Time, sensors: Sensors) -> None:
        """Start all processes, whose own time begins at `tick`, without waiting for any."""
        raise_file_limit(FILES * len(self._specs), f"engine {self.name}")
        self._folder = TemporaryDirectory(prefix="skyrange-")
        opened = self._options.opened(len(self._specs))
        for row, spec in enumerate(self._specs):
            values = self._values(spec, int(tick - sensors.gnss_time_ns[row]) // NS_PER_MS)
            crossed = spec.signing_key is not None or self._options.first_channel == "private"
            if crossed:
                values = parameters.swap_serial_ports(values, self._listed)
            if self._options.keep_logs:
                values["LOG_BACKEND_TYPE"] = 1.0
            east_m, north_m, up_m = spec.home_enu_m
            lat_deg, lon_deg = self._origin.geodetic_of(east_m, north_m)
            arguments = {
                "name": f"arducopter of {spec.vehicle}",
                "binary": self.binary.path,
                "folder": self._own_folder(spec.vehicle),
                "home": (lat_deg, lon_deg, self._origin.alt_msl_m + up_m, spec.heading_deg % 360.0),
                "system_id": spec.system_id,
                "start_unix_s": (self._epoch.unix_ns + tick - (WARM_UP_NS - self.preroll_ns)) // NS_PER_S,
                "parameters": parameters.defaults_text(values),
                "crossed": crossed,
                "options": (f"--serial{OPEN}", f"tcp:{opened[row]}") if opened else (),
            }
            packer = Packer(spec.system_id, dialect.MAV_COMP_ID_GPS)
            events = EventDetector(spec.system_id, self._origin)
            self._instances.append(Instance(spec, values, arguments, self._start_process(**arguments), packer, events))

    def _own_folder(self, vehicle: str, suffix: str = "") -> Path:
        assert self._folder is not None
        folder = Path(self._folder.name) / (vehicle.replace("/", "-") + suffix)
        folder.mkdir()
        return folder

    def _restart_process(self, instance: Instance, suffix: str) -> None:
        """Start the same in a folder of another name, after ending the previous process."""
        instance.sitl.close()
        instance.sitl = self._start_process(
            **{**instance.arguments, "folder": self._own_folder(instance.spec.vehicle, suffix)}
        )

    def kept_files(self) -> Mapping[str, Path]:
        """The DataFlash logs to keep, by their names in the run's folder; they exist until `close`."""
        if not self._options.keep_logs:
            return {}
        return {
            f"dataflash/{instance.spec.vehicle.replace('/', '-')}{'' if number == 0 else f'-{number + 1}'}.bin": log
            for instance in self._instances
            for number, log in enumerate(sorted((instance.sitl.folder / "logs").glob("*.BIN")))
        }

    def close(self) -> None:
        """End the processes. A second call does nothing."""
        for instance in self._instances:
            instance.sitl.close()
        self._poller.close()
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None

    @property
    def cpu_s(self) -> float:
        """Processor time that the processes have used so far, in seconds."""
        return sum(instance.sitl.program.cpu_s for instance in self._instances)

    # ---------------------------------------------------------------- a tick

    @abstractmethod
    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        """Contract: `contracts.components.Engine`."""

    @abstractmethod
    def finish(self, tick: Time, wall_deadline_s: float) -> Finished:
        """Contract: `contracts.components.Engine`."""

    def _deliver_inputs(self, sensors: Sensors, inbox: Inbox) -> None:
        """Give each process its frames and its GNSS fix."""
        for arrival in inbox:
            instance = self._instances[self._places[arrival.port]]
            if instance.alive:
                instance.sitl.write(0, arrival.payload)
                instance.events.on_upload(arrival.payload)
        for row in self._receivers.fresh(sensors):
            instance = self._instances[row]
            if instance.alive:
                instance.sitl.write(PRIVATE, instance.onboard.pack(self._receivers.message(sensors, row)))

    def _read_ports(self, tick: Time, outbox: Outbox, wait_s: float = 0.0) -> None:
        """Read what the processes sent, waiting up to `wait_s` for the first; before time 0 nothing is delivered."""
        for row in sorted(self._unconnected):
            sitl = self._instances[row].sitl
            if self._instances[row].alive:
                for place in sitl.accept():
                    self._poller.add(row, place, sitl)
                    self._connected(row, place, outbox)
            if sitl.connected:
                self._unconnected.discard(row)
        for row, place in self._poller.poll_ready(wait_s):
            instance = self._instances[row]
            data = instance.sitl.read(place)
            if instance.sitl.serial[place] is None:  # closed
                self._unconnected.add(row)
            if place == PRIVATE:
                self._on_private_data(tick, row, data, outbox)
            else:
                self._on_public_data(tick, row, instance, data, outbox)

    def _connected(self, row: int, place: int, outbox: Outbox) -> None:
        """Its serial port `place` has connected, for the first time or again."""

    def _on_private_data(self, tick: Time, row: int, data: bytes, outbox: Outbox) -> None:
        """Process the reports on its private port."""
        instance = self._instances[row]
        for piece in instance.private.feed(data):
            if piece.garbage:
                continue
            message = decode(piece.data)
            self._on_report(tick, row, message, outbox)
            for kind, details in instance.events.on_report(message):
                if tick >= 0:
                    outbox.note(kind, instance.spec.vehicle, details)
        if instance.events.mode >= 0 and instance.asked < len(self.reports):
            self._request_report(instance)
        paired = instance.signs or instance.spec.signing_key is None
        if instance.events.mode >= 0 and not paired:
            self._send_signing_key(instance)
        if instance.status is InstanceStatus.BOOTING and paired and instance.events.flags & POSITION_VALID_FLAG:
            instance.status = InstanceStatus.READY

    @abstractmethod
    def _on_report(self, tick: Time, row: int, message: Message, outbox: Outbox) -> None:
        """Handle one message from its private port."""

    def _on_public_data(self, tick: Time, row: int, instance: Instance, data: bytes, outbox: Outbox) -> None:
        """Deliver what its public port sends on the link `autopilot`."""
        for piece in instance.deframer.feed(data):
            instance.signs |= not piece.garbage and is_signed(piece.data)
            if tick < 0:
                continue
            outbox.send(self.ports[row], piece.data)
            if not piece.garbage:
                for kind, details in instance.events.on_public_frame(piece.data):
                    outbox.note(kind, instance.spec.vehicle, details)

    def _send_signing_key(self, instance: Instance) -> None:
        """Send its signing key on the private port; it stores the key across reboots, and never acknowledges it."""
        key = instance.spec.signing_key
        assert key is not None
        setup = dialect.MAVLink_setup_signing_message(instance.spec.system_id, 1, list(key.secret), key.initial)
        instance.sitl.write(PRIVATE, instance.onboard.pack(setup))

    def _request_report(self, instance: Instance) -> None:
        """Request its next report on the private port."""
        number, rate_hz = list(self.reports.items())[instance.asked]
        ask = dialect.MAVLink_command_long_message(
            instance.spec.system_id, 1, dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0, number, 1e6 / rate_hz, 0, 0, 0, 0, 0
        )
        instance.asked += instance.sitl.write(PRIVATE, instance.onboard.pack(ask))
