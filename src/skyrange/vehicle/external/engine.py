"""Engine of external vehicles: real autopilots, or foreign simulations, in a world that only observes them.

Their reports are the truth, imposed on bodies that are extrapolated by velocity in between. Their bytes are the link
`autopilot`, and what the range sends to them passes the interlock. Their time is not controlled: they run on the
machine's clock, and whoever drives the kernel paces it to that.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, Literal

import numpy as np

from skyrange.agent.contracts import Finished, InstanceStatus, Sensors, Source
from skyrange.agent.messages import Inbox, Outbox
from skyrange.core.chance import Chance
from skyrange.core.errors import ComponentError
from skyrange.core.geodesy import Origin
from skyrange.core.ids import Port, endpoint, link_name
from skyrange.core.time import NS_PER_S, Epoch, Time, ceil_to
from skyrange.io.sitl import wall_s
from skyrange.io.wires import rest, wire_to
from skyrange.vehicle.ardupilot.truth import Truth
from skyrange.vehicle.external.contact import Contact
from skyrange.vehicle.external.options import Options
from skyrange.vehicle.spec import VehicleSpec
from skyrange.world.airframes import MOTORS

QUANTUM_NS: Final[Time] = 2_500_000
"""The world's tick."""


class External:
    """An engine (contract: `agent.contracts.WallEngine`). It connects with its first tick.

    `motion` comes from the command line: together with the scenario's `allow_motion` it opens the interlock.
    """

    service_ns: Time = QUANTUM_NS
    clock: Literal["lockstep", "wall"] = "wall"
    repeatable: Literal["bytes", "outcome"] = "outcome"
    pace = 1.0
    waits = False
    source = Source.EXTERNAL

    def __init__(
        self, name: str, specs: Sequence[VehicleSpec], origin: Origin, options: Options, motion: bool = False
    ) -> None:
        """Connects to no vehicle yet. Raises `InputError` for vehicles without a connection in `options`, and for
        unknown ones.
        """
        self.name = name
        self.vehicles = [spec.vehicle for spec in specs]
        self.moves = self.vehicles
        self.ports = [Port(endpoint(v, "autopilot"), link_name("autopilot", v)) for v in self.vehicles]
        self.preroll_ns: Time = ceil_to(round(options.boot_s * NS_PER_S), QUANTUM_NS)
        self._places = {port: place for place, port in enumerate(self.ports)}
        self._origin = origin
        self._options = options
        self._open = (options.allow_motion, motion)
        wires = [wire_to(address) for address in options.addresses(self.vehicles)]
        self._contacts = [
            Contact(spec, wire, all(self._open), options.rate_hz) for spec, wire in zip(specs, wires, strict=True)
        ]
        self._truth = Truth(len(specs))
        self._motors = np.zeros((len(specs), MOTORS))
        """Their motor commands are unknown."""
        self._started: tuple[Time, float] | None = None
        self._noted_interlock = False

    def __deepcopy__(self, memo: dict[int, Any]) -> External:
        raise ComponentError(f"engine {self.name}", "external vehicles cannot be copied", "Fork a run of builtins")

    @property
    def manifest(self) -> dict[str, Any]:
        """The address of each vehicle, the state of the interlock, and after a flight what it passed and refused."""
        counted = self._started is not None
        return {
            "interlock": self._interlock,
            "vehicles": {
                one.spec.vehicle: {"connect": str(one.wire.address)} | (one.counts if counted else {})
                for one in self._contacts
            },
        }

    @property
    def _interlock(self) -> dict[str, Any]:
        scenario, switch = self._open
        return {"state": "open" if scenario and switch else "closed", "scenario": scenario, "command_line": switch}

    def why(self, vehicle: str) -> str:
        """Why a vehicle is not ready, in words; "" if nothing is known to be wrong."""
        return self._contacts[self.vehicles.index(vehicle)].why

    # ---------------------------------------------------------------- a tick

    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        """Send the frames that the interlock permits."""
        if self._started is None:
            self._started = tick, wall_s()
        for arrival in inbox:
            self._contacts[self._places[arrival.port]].tell(arrival)

    def finish(self, tick: Time, wall_deadline_s: float) -> Finished:
        """Take in what they sent. Before time 0, it keeps to the machine's clock while a vehicle is still missing."""
        outbox = Outbox()
        if tick < 0 and any(one.status is InstanceStatus.BOOTING for one in self._contacts):
            assert self._started is not None
            first, began_s = self._started
            rest(began_s + (tick - first) / NS_PER_S - wall_s())
        now_s = wall_s()
        for row, one in enumerate(self._contacts):
            for piece in one.wire.read():
                if tick >= 0:
                    outbox.send(self.ports[row], piece.data)
                one.heard(piece, now_s, self._origin)
            one.ask(now_s)
            one.judge(now_s, wall_deadline_s)
            if one.late_ns is not None and one.reports.place is not None:
                self._truth.tell(row, one.reports.place, one.late_ns)
                one.late_ns = None
        if tick >= 0:
            self._write_notes(outbox)
        return Finished(self._motors, outbox, [one.status for one in self._contacts], self._truth.take())

    def _write_notes(self, outbox: Outbox) -> None:
        """Write the waiting notes; before time 0 they wait."""
        for one in self._contacts:
            if not self._noted_interlock:
                outbox.note("event.interlock", one.spec.vehicle, self._interlock)
            for kind, data, causes in one.said():
                outbox.note(kind, one.spec.vehicle, data, causes)
        self._noted_interlock = True

    def close(self) -> None:
        """Close the connections. A second call does nothing."""
        for one in self._contacts:
            one.wire.close()


class _Factory:
    options = Options
    guards_motion = True
    """It takes the command line's word on motion, as keyword `motion`."""

    def __call__(
        self,
        name: str,
        specs: Sequence[VehicleSpec],
        origin: Origin,
        epoch: Epoch,
        chance: Chance,
        options: Options | None = None,
        *,
        motion: bool = False,
    ) -> External:
        return External(name, specs, origin, options or Options(), motion)


ExternalFleet: Final = _Factory()
"""What is registered as the autopilot `external`. Raises `InputError` as `External` does."""
