"""Engine of external vehicles and its options: real autopilots, or foreign simulations, that the world only observes.

Their reports are the truth, imposed on bodies that are extrapolated by velocity in between. Their bytes are the link
`autopilot`, and what the range sends to them passes the interlock. Their time is not controlled: they run on the
machine's clock, and whoever drives the kernel paces it to that.

Options are those of the table `[autopilots.options.external]`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, Literal

import numpy as np
from pydantic import Field, model_validator

from skyrange.contracts.components import EngineBase, Finished, InstanceStatus, Sensors, Source
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.contracts.params import Number, Params, refuse
from skyrange.core.errors import ComponentError, InputError, Problem, nearest
from skyrange.core.geodesy import Origin
from skyrange.core.ids import Port, endpoint, link_name
from skyrange.core.time import NS_PER_S, Time, ceil_to
from skyrange.io.ardupilot.sitl import wall_s
from skyrange.io.mavlink.connections import ADDRESS_FORMS, Address, make_connection, sleep_for
from skyrange.vehicle.contract import AutopilotContext, AutopilotPlugin, VehicleSpec
from skyrange.vehicle.external.vehicle_session import VehicleSession
from skyrange.vehicle.reported_poses import ReportedPoses
from skyrange.world.airframes import MOTORS


class Options(Params):
    """Options of the external vehicles of a scenario: addresses, and whether they may be moved."""

    connect: dict[str, str] = Field(
        default_factory=dict,
        description=f"MAVLink address of each vehicle, by operator/vehicle: {', '.join(ADDRESS_FORMS.values())}.",
    )
    allow_motion: bool = Field(
        default=False,
        strict=True,
        description="Whether to pass arming and motion commands to them; this also needs --allow-motion on the "
        "command line.",
    )
    rate_hz: Number = Field(
        default=10.0,
        ge=5,
        le=50,
        description="Rate in Hz at which position and attitude are requested of each vehicle.",
    )
    boot_s: Number = Field(
        default=20.0,
        gt=0,
        le=120,
        description="Wall time in seconds before time 0, within which each vehicle must connect and report its "
        "position.",
    )

    @model_validator(mode="after")
    def _check_addresses(self) -> Options:
        problems: list[Problem] = []
        held: dict[Address, str] = {}
        for vehicle, text in self.connect.items():
            try:
                address = Address.of(text, f"connect.{vehicle}")
            except InputError as error:
                problems += error.problems
                continue
            other = held.setdefault(address, vehicle)
            if other != vehicle:
                problems.append(
                    Problem(f"connect.{vehicle}", text, f"an address that no other vehicle has; {other} already has it")
                )
        if problems:
            raise refuse(*problems)
        return self

    def addresses(self, vehicles: Sequence[str]) -> list[Address]:
        """The address of each of `vehicles`. Raises `InputError` for vehicles without an address, and for unknown
        ones.
        """
        known = "autopilots.options.external.connect"
        problems = [
            Problem(f"{known}.{name}", text, "an external vehicle of the scenario", nearest(name, vehicles))
            for name, text in self.connect.items()
            if name not in vehicles
        ]
        problems += [
            Problem(
                known,
                f"no address for {vehicle}",
                "an address for each external vehicle",
                f'Such as "{vehicle}" = "tcp:127.0.0.1:5760".',
            )
            for vehicle in vehicles
            if vehicle not in self.connect
        ]
        if problems:
            raise InputError("external vehicles", problems)
        return [Address.of(self.connect[vehicle]) for vehicle in vehicles]


QUANTUM_NS: Final[Time] = 2_500_000
"""The world's tick."""


class ExternalEngine(EngineBase):
    """An engine (contract: `contracts.components.WallEngine`). It connects with its first tick.

    `motion` comes from the command line: together with the scenario's `allow_motion` it opens the interlock.
    """

    service_ns: Time = QUANTUM_NS
    clock: Literal["lockstep", "wall"] = "wall"
    repeatable: Literal["bytes", "outcome"] = "outcome"
    pace = 1.0
    paces_itself = False
    runs_programs = True
    source = Source.EXTERNAL

    def __init__(
        self, name: str, specs: Sequence[VehicleSpec], origin: Origin, options: Options, *, motion: bool = False
    ) -> None:
        """Connects to no vehicle yet. Raises `InputError` for vehicles without a connection in `options`, and for
        unknown ones.
        """
        self.name = name
        self.vehicles: Sequence[str] = [spec.vehicle for spec in specs]
        self.moves: Sequence[str] = self.vehicles
        self.ports: Sequence[Port] = [Port(endpoint(v, "autopilot"), link_name("autopilot", v)) for v in self.vehicles]
        self.preroll_ns: Time = ceil_to(round(options.boot_s * NS_PER_S), QUANTUM_NS)
        self._places = {port: place for place, port in enumerate(self.ports)}
        self._options = options
        self._open = (options.allow_motion, motion)
        wires = [make_connection(address) for address in options.addresses(self.vehicles)]
        self._sessions = [
            VehicleSession(spec, wire, origin, options.rate_hz, open_=all(self._open))
            for spec, wire in zip(specs, wires, strict=True)
        ]
        self._poses = ReportedPoses(len(specs))
        self._motors = np.zeros((len(specs), MOTORS))
        """Their motor commands are unknown."""
        self._started: tuple[Time, float] | None = None
        self._noted_interlock = False

    def __deepcopy__(self, memo: dict[int, Any]) -> ExternalEngine:
        raise ComponentError(f"engine {self.name}", "external vehicles cannot be copied", "Fork a run of builtins")

    @property
    def manifest(self) -> dict[str, Any]:
        """The address of each vehicle, the state of the interlock, and after a flight what it passed and refused."""
        counted = self._started is not None
        return {
            "interlock": self._interlock,
            "vehicles": {
                session.spec.vehicle: {"connect": str(session.wire.address)} | (session.counts if counted else {})
                for session in self._sessions
            },
        }

    @property
    def _interlock(self) -> dict[str, Any]:
        scenario, switch = self._open
        return {"state": "open" if scenario and switch else "closed", "scenario": scenario, "command_line": switch}

    def explain_status(self, vehicle: str) -> str:
        """Why a vehicle is not ready, in words; "" if nothing is known to be wrong."""
        return self._sessions[self.vehicles.index(vehicle)].why

    # ---------------------------------------------------------------- a tick

    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        """Send the frames that the interlock permits."""
        if self._started is None:
            self._started = tick, wall_s()
        for arrival in inbox:
            self._sessions[self._places[arrival.port]].send(arrival)

    def finish(self, tick: Time, wall_deadline_s: float) -> Finished:
        """Take in what they sent. Before time 0, it keeps to the machine's clock while a vehicle is still missing."""
        outbox = Outbox()
        if tick < 0 and any(session.status is InstanceStatus.BOOTING for session in self._sessions):
            assert self._started is not None
            first, began_s = self._started
            sleep_for(began_s + (tick - first) / NS_PER_S - wall_s())
        now_s = wall_s()
        for row, session in enumerate(self._sessions):
            for piece in session.wire.read():
                if tick >= 0:
                    outbox.send(self.ports[row], piece.data)
                session.on_frame(piece, now_s)
            session.request_messages(now_s)
            session.update_status(now_s, wall_deadline_s)
            if session.late_ns is not None and session.reports.state is not None:
                self._poses.update(row, session.reports.state, session.late_ns)
                session.late_ns = None
        if tick >= 0:
            self._write_notes(outbox)
        return Finished(self._motors, outbox, [session.status for session in self._sessions], self._poses.take_new())

    def _write_notes(self, outbox: Outbox) -> None:
        """Write the waiting notes; before time 0 they wait."""
        for session in self._sessions:
            if not self._noted_interlock:
                outbox.note("event.interlock", session.spec.vehicle, self._interlock)
            for kind, data, causes in session.take_notes():
                outbox.note(kind, session.spec.vehicle, data, causes)
        self._noted_interlock = True

    def close(self) -> None:
        """Close the connections. A second call does nothing."""
        for session in self._sessions:
            session.wire.close()


def _make(options: Options, context: AutopilotContext) -> ExternalEngine:
    return ExternalEngine(context.name, context.specs, context.origin, options, motion=context.motion)


def _reads_sensors(options: Options) -> bool:
    return False


EXTERNAL = AutopilotPlugin(
    Options,
    _make,
    "Connects to vehicles that skyrange does not start: real ones, or other simulations.",
    reads_sensors=_reads_sensors,
)
"""The autopilot `external`. Raises `InputError` as `ExternalEngine` does."""
