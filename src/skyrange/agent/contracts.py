"""What must an agent, a tap, an engine, a world, an observer do? The protocols, and nothing else.

`skyrange.testing` ships a conformance check for each that a plugin may implement.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from skyrange.agent.blocks import FrameBlock
from skyrange.agent.frames import Frame
from skyrange.agent.messages import Inbox, Note, Outbox
from skyrange.agent.monitors import Alert
from skyrange.agent.verdicts import Label, Verdict
from skyrange.core.ids import Port
from skyrange.core.time import Time

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Agent(Protocol):
    """A component as a plain object: same inputs, same outputs; no clock, no socket, no thread.

    The kernel hands it everything that arrived since its last step, at the next multiple of
    `service_ns` (a real program polls), and steps it when `next_wakeup` falls due (perhaps later,
    never earlier). All its state is deep-copyable data: no generators, closures or handles.
    """

    name: str
    service_ns: Time
    ports: Sequence[Port]
    """Where it sends and receives. An agent may own many vehicles' endpoints."""

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """React to time and frames; the outbox is complete, never a generator."""
        ...

    def next_wakeup(self) -> Time | None:
        """When it wants to be stepped without mail; `None` for "only by mail"."""
        ...


class Speaker(Agent, Protocol):
    """An agent that also sends on links where its endpoint forwards, and hears nothing there."""

    speaks: Sequence[Port]
    """Those ends. What it sends there has `core.ids.own_voice` of the endpoint as its true sender."""


class Watcher(Agent, Protocol):
    """An agent that is told where everything truly is, as what carries radio waves must be; no other may be one."""

    look_ns: Time
    """The kernel has it look at every multiple of this: whole ticks of the world."""

    def look(self, now: Time, world: World) -> None:
        """See the world as it is after its tick at `now`; nothing of it may be kept but copies, or altered."""
        ...


class Tap(Protocol):
    """Stands on one side of one link, sees frames of both directions, judges each."""

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """At most one of Pass, Drop, Replace and Delay-with-Replace combined, plus any Injects; empty is Pass."""
        ...

    def next_wakeup(self) -> Time | None:
        """When it wants to act without a frame."""
        ...

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Act on its own initiative: Injects only."""
        ...


@dataclass(slots=True)
class Sensors:
    """What the sensors of an engine's vehicles say at one tick: rows in the engine's own vehicle order.

    Frames: local is east-north-up from the origin; body is forward-left-up (REP 103). Arrays are
    read-only views, valid until the next tick.
    """

    gyro_radps: Floats
    """(n, 3) body rates."""
    accel_mps2: Floats
    """(n, 3) specific force in the body: (0, 0, +9.8) at rest and level."""
    attitude: Floats
    """(n, 4) quaternion w, x, y, z, body to local, as it truly is: for engines that make sensors of their own of it."""
    gnss_enu_m: Floats
    """(n, 3) position."""
    gnss_vel_enu_mps: Floats
    """(n, 3) velocity."""
    baro_up_m: Floats
    """(n,) height above the origin."""
    rangefinder_m: Floats
    """(n,) height above the ground below."""
    compass_gauss: Floats
    """(n, 3) the Earth's magnetic field in the body."""
    gnss_accuracy: Floats
    """(n, 3) what the receiver claims of itself: horizontal m, vertical m, speed m/s, one sigma each."""
    gnss_fix: Ints
    """(n,) MAVLink GPS_FIX_TYPE: 0 no receiver, 1 no fix, 3 3D, 6 RTK fixed."""
    gnss_satellites: Ints
    """(n,) satellites used."""
    gnss_time_ns: Ints
    """(n,) when the position was measured: a new value is a new measurement, an old one is a repetition."""
    battery_v: Floats
    """(n,) voltage at the terminals."""
    battery_a: Floats
    """(n,) current drawn."""
    rotor_radps: Floats
    """(n, motors) how fast each rotor turns, as its speed controller measures it."""


class SensorAct(NamedTuple):
    """One thing that a sensor fault did, to be labelled: to which vehicle's which sensor."""

    vehicle: str
    sensor: str
    """Such as "gnss", "baro", "compass", "imu"."""


class SensorFault(Protocol):
    """Alters what sensors say before their autopilot hears it. It belongs to an attack, which owns its state.

    Called once a tick, muted or not: while its attack does not act, on copies that are thrown away. Deep-copyable,
    pure: what it does depends on what it was handed and on the time alone.
    """

    name: str
    """Who acted, in the labels; unique among the faults of a run."""
    vehicles: Sequence[str]
    """Whose sensors it reaches: the rows of what it is handed, in this order."""

    def on_sensors(self, now: Time, sensors: Sensors) -> Sequence[SensorAct]:
        """Write into `sensors`, writable copies of its vehicles' rows, as other faults have left them.

        A fix is new to an autopilot by its `gnss_time_ns`: to invent one, give it a time of its own. Returns the
        acts to be labelled: one where an alteration begins or changes in kind, not one at every tick.
        """
        ...


class Trigger(Protocol):
    """A condition on truth that starts an attack. The kernel asks it at world ticks; of the attack's parts none does.

    Deep-copyable and pure: the answer depends on what it was handed alone.
    """

    @property
    def vehicles(self) -> Sequence[str]:
        """The vehicles that it speaks of."""
        ...

    def holds(self, now: Time, truth: Mapping[str, NDArray[np.float64]], rows: Sequence[int]) -> bool:
        """Whether it holds; `truth` are the world's columns, `rows` where its `vehicles` stand in them, in order."""
        ...


class InstanceStatus(StrEnum):
    """How one instance of an engine is."""

    BOOTING = "booting"
    READY = "ready"
    SILENT = "silent"
    DEAD = "dead"


class Source(StrEnum):
    """What moves a body."""

    DYNAMIC = "dynamic"
    """The world: forces on it."""
    KINEMATIC = "kinematic"
    """Its engine, which imposes its pose."""
    EXTERNAL = "external"
    """As above, but what is imposed is what a vehicle outside the range reports of itself."""


@dataclass(slots=True)
class Poses:
    """Where an engine's own dynamics have brought its vehicles at one tick: rows in the engine's vehicle order.

    Frames as in `Sensors`. Every number of a fresh row is finite, and its quaternion of length 1 to a hundredth; the
    other rows are not read.
    """

    fresh: NDArray[np.bool_]
    """(n,) whether the row says something new; the vehicle goes on by its last pose where it does not."""
    position_enu_m: Floats
    """(n, 3) of the bottom of the gear."""
    vel_enu_mps: Floats
    """(n, 3) velocity."""
    attitude: Floats
    """(n, 4) quaternion w, x, y, z, body to local."""
    rates_radps: Floats
    """(n, 3) body rates."""


@dataclass(slots=True)
class Finished:
    """What an engine hands back for one tick."""

    actuators: Floats
    """(n, motors) commands in 0…1, rows in the engine's vehicle order.

    Of a vehicle that the engine moves itself: what its motors are told there, zeros where that is not known. They move
    nothing, but turn its rotors, drain its battery and shake its sensors.
    """
    outbox: Outbox
    status: Sequence[InstanceStatus] | None = None
    """Per vehicle; `None` means all are ready."""
    poses: Poses | None = None
    """Of the vehicles in `Engine.moves`; `None` means that nothing is new."""


class Engine(Protocol):
    """All aircraft of one autopilot kind, stepped together: first `begin` on all engines, then `finish`.

    An engine that runs programs starts them at its first `begin`, has a method `close()` that ends them, called once
    when the run ends however it does, and a mapping `manifest` that says in the record what they are. Before that
    `leaves()` may name files of theirs that are worth keeping, by their names in the run's folder. A model
    `options` (`agent.settings.Params`) of its factory says what a scenario may tell it, as keyword `options`.

    One whose clock is `wall` is a `WallEngine`. Two more it may have: `source`, of the vehicles that it moves
    (`Source.KINEMATIC` without), and `why(vehicle)`, in words, for the error that names one not ready or silent.
    """

    name: str
    vehicles: Sequence[str]
    """Vehicle ids, in the row order of every array that crosses this boundary."""
    service_ns: Time
    """How often its serial ports are served: mail comes only at multiples of it."""
    ports: Sequence[Port]
    clock: Literal["lockstep", "wall"]
    repeatable: Literal["bytes", "outcome"]
    preroll_ns: Time
    """How long before time 0 it must be ticked to boot (0 for the builtin)."""
    moves: Sequence[str]
    """Those of `vehicles` whose poses it imposes, by dynamics of its own; the world moves the others. One whose
    instance dies is the world's from then on, and falls."""

    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        """Hand the tick's sensors and the mail that came since the last service to all instances."""
        ...

    def finish(self, tick: Time, wall_deadline_s: float) -> Finished:
        """Collect what they answer, waiting at most `wall_deadline_s` of wall time for a program."""
        ...


class WallEngine(Engine, Protocol):
    """One whose programs run on the machine's clock: `finish` waits until their time has come to the tick.

    One with an attribute `waits` that is False does not: whoever drives the kernel holds it to the pace.
    """

    pace: float
    """How many simulated seconds pass in a second of the machine's clock."""


class World(Protocol):
    """Owner of truth: bodies in a city, advanced by a fixed quantum."""

    quantum_ns: Time
    vehicles: Sequence[str]

    def advance(self, now: Time) -> Sequence[Note]:
        """Move all bodies from the last tick to `now` under the last actuators; say what happened."""
        ...

    def sensors(self, rows: slice | NDArray[np.int64]) -> Sensors:
        """The sensors of some vehicles."""
        ...

    def actuate(self, rows: slice | NDArray[np.int64], actuators: Floats) -> None:
        """Set the motor commands that hold until the next tick."""
        ...

    @property
    def sources(self) -> Sequence[Source]:
        """What moves each body, in vehicle order."""
        ...

    def set_source(self, rows: NDArray[np.int64], source: Source) -> None:
        """From now on these move some bodies; each goes on from where it is, with motors at rest."""
        ...

    def impose(self, rows: slice | NDArray[np.int64], poses: Poses) -> None:
        """Say where bodies are now that are not dynamic; the next tick takes them from there on.

        Raises ValueError for a pose that no body can have, or of a body that is dynamic.
        """
        ...

    def motion(self) -> tuple[Floats, Floats]:
        """Position and velocity, (n, 3) each, in vehicle order: read-only views that later ticks refill."""
        ...

    def truth(self) -> Mapping[str, NDArray[np.float64]]:
        """Named (n,) columns of the true state, in vehicle order; copies, units in the names."""
        ...


class Observer(Protocol):
    """Sees everything, alters nothing. The kernel calls it in simulated-time order of completion."""

    def on_frame(self, frame: Frame) -> None:
        """A frame reached its fate: delivered, lost, dropped, replaced, or still in flight at the end."""
        ...

    def on_block(self, block: FrameBlock) -> None:
        """Many frames reached their fate; `for frame in block.frames(): self.on_frame(frame)` is enough."""
        ...

    def on_note(self, now: Time, source: str, note: Note) -> None:
        """An agent, engine, the world or the kernel noted something."""
        ...

    def on_label(self, label: Label) -> None:
        """A hostile tap or agent acted."""
        ...

    def on_alert(self, now: Time, detector: str, alert: Alert) -> None:
        """A monitor raised an alert at its service time `now`."""
        ...

    def on_truth(self, now: Time, world: World) -> None:
        """A tick has ended; called at every tick that `truth_period_ns` asks for, and at those that others ask for."""
        ...

    truth_period_ns: Time
