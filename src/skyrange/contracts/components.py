"""Protocols of the components that a kernel runs: agents, taps, faults, triggers, engines, the world, observers.

`skyrange.testing` has a conformance check for each that a plugin may implement. Monitors, which detectors are, have a
module of their own (`skyrange.contracts.monitors`), and so have radio media (`skyrange.contracts.medium`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, Literal, NamedTuple, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from skyrange.contracts.alerts import Alert
from skyrange.contracts.frames import Frame, FrameBlock
from skyrange.contracts.mailboxes import Inbox, Note, Outbox
from skyrange.contracts.verdicts import Label, Verdict
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_MS, Time

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


class Agent(Protocol):
    """A component as a plain object: same inputs, same outputs; no clock, no socket, no thread.

    The kernel hands it everything that arrived since its last step, at the next multiple of `service_ns`, as a real
    program polls. It also steps it when `next_wakeup` falls due, perhaps later but never earlier. All its state is
    deep-copyable data: no generators, closures or handles.
    """

    name: str
    service_ns: Time
    ports: Sequence[Port]
    """The link ends at which it sends and receives. An agent may own the endpoints of many vehicles."""

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        """React to time and frames; the outbox is complete, never a generator."""
        ...

    def next_wakeup(self) -> Time | None:
        """When it is to be stepped without mail; `None` for "only by mail"."""
        ...


@runtime_checkable
class OriginatingRouter(Agent, Protocol):
    """An agent that also sends on links over which its endpoint forwards; it receives nothing there.

    A kernel takes an agent with an attribute `originates` for one.
    """

    originates: Sequence[Port]
    """Those ends. The true sender of what it sends there is `core.ids.originator_id` of the endpoint."""


class TruthSubscriber(Agent, Protocol):
    """An agent that is shown the truth, as the owner of a radio medium must be; no other agent may be one."""

    observe_period_ns: Time
    """The kernel shows it the world at every multiple of this, which is a whole number of the world's ticks."""

    def observe(self, now: Time, world: World) -> None:
        """Read the world as it is after its tick at `now`; it may keep copies only, and alters nothing."""
        ...


class Tap(Protocol):
    """A component on one side of one link, which sees the frames of both directions and decides on each."""

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        """At most one of Pass, Drop, Replace and Delay-with-Replace combined, plus Injects, Notes and Alerts.

        An empty answer is Pass.
        """
        ...

    def next_wakeup(self) -> Time | None:
        """When it is to act without a frame; `None` for never."""
        ...

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        """Act on its own initiative: Injects, and Alerts of a defence."""
        ...


@dataclass(slots=True)
class Sensors:
    """Sensor readings of an engine's vehicles at one tick: rows in the engine's own vehicle order.

    Frames: local is east-north-up from the origin; body is forward-left-up (REP 103). Arrays are
    read-only views, valid until the next tick.
    """

    gyro_radps: Floats
    """(n, 3) body rates."""
    accel_mps2: Floats
    """(n, 3) specific force in the body: (0, 0, +9.8) at rest and level."""
    attitude: Floats
    """(n, 4) true attitude as a quaternion w, x, y, z, body to local: for engines that derive sensors from it."""
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
    """(n, 3) accuracy that the receiver claims: horizontal m, vertical m, speed m/s, one sigma each."""
    gnss_fix: Ints
    """(n,) MAVLink GPS_FIX_TYPE: 0 no receiver, 1 no fix, 3 3D, 6 RTK fixed."""
    gnss_satellites: Ints
    """(n,) satellites used."""
    gnss_time_ns: Ints
    """(n,) when the position was measured: a new value is a new measurement, an old one is a repetition."""
    gnss_utc_error_ns: Ints
    """(n,) error of the UTC that the receiver reports, in nanoseconds: positive is ahead; 0 unless it is attacked."""
    battery_v: Floats
    """(n,) voltage at the terminals."""
    battery_a: Floats
    """(n,) current drawn."""
    rotor_radps: Floats
    """(n, motors) how fast each rotor turns, as its speed controller measures it."""
    delta_angle_rad: Floats
    """(n, 3) integral of `gyro_radps`, as inertial sensors integrate their own samples (in ArduPilot
    `AP_InertialSensor::get_delta_angle`): over the time between the last two multiples of `READINGS_NS`."""
    delta_velocity_mps: Floats
    """(n, 3) integral of `accel_mps2` over the same time."""


READINGS_NS: Time = 10 * NS_PER_MS
"""The builtin autopilot reads its sensors, and those with errors have new readings, at the first tick at or after each
multiple of this; gyroscopes, accelerometers and rotors have new ones at every tick."""


class SensorAct(NamedTuple):
    """One act of a sensor fault, to be labelled: the vehicle and the sensor that it altered."""

    vehicle: str
    sensor: str
    """Such as "gnss", "baro", "compass", "imu"."""


class ReadingsTracker(Protocol):
    """What a sensor check keeps of readings other than fixes: of each vehicle for itself, in the order of its rows."""

    def update(self, now: Time, sensors: Sensors) -> None:
        """Take in the readings at a multiple of `READINGS_NS`; again at the same time does nothing. Alters none."""
        ...

    def join(self, others: Sequence[Self]) -> Self:
        """One whose rows are its own and then those of `others`, none of which has been updated yet.

        All of them keep their rows in it from now on, so that its update is theirs.
        """
        ...


class SensorHook(Protocol):
    """Alters sensor readings before the autopilot gets them. It belongs to an attack, which owns its state.

    It is called once a tick, muted or not; while its attack does not act, on copies that are discarded. It is
    deep-copyable and pure: what it does depends on what it was handed and on the time alone.

    One that needs readings at multiples of `READINGS_NS` only, and alters nothing that changes in between, which
    excludes `gyro_radps`, `accel_mps2`, `attitude` and `rotor_radps`, may have an attribute `slow = True`. Where all of
    a run are slow, they may be called once in `READINGS_NS`, and what they write lasts until then. One that alters such
    a reading is an error.

    A slow one that alters readings of GNSS receivers alone, and what it writes depends on these and on whether its
    attack acts, but not on the time, may have an attribute `per_fix = True`. Then it may be called only when one of its
    vehicles has a new fix, and when its attack begins or ends; what it has written lasts until then. A check that also
    depends on other readings may have them in a `tracker`, a `ReadingsTracker` that it updates whenever it is called;
    those of several runs may be joined, and updated in between.

    One may have an attribute `first = True`: it is called before those without, whatever its name. Noise at an antenna
    comes before what a receiver makes of the signals there.

    None alters `delta_angle_rad` and `delta_velocity_mps`: sensor checks get those that follow from the `gyro_radps`
    and `accel_mps2` which attacks and faults have left.

    That of a defence is a sensor check: it gets the readings as all attacks and faults have left them, it may raise
    alerts, and the true `attitude` in them is not a number, because no aircraft can read it.
    """

    name: str
    """The actor in labels; unique among the sensor faults of a run."""
    vehicles: Sequence[str]
    """The vehicles whose sensors it alters: the rows of what it is handed, in this order."""

    def on_sensors(self, now: Time, sensors: Sensors) -> Sequence[SensorAct | Alert]:
        """Write into `sensors`, which are writable copies of its vehicles' rows, as other sensor faults left them.

        An autopilot takes a fix for a new one by its `gnss_time_ns`: an invented fix needs a time of its own. Returns
        the acts to be labelled: one where an alteration begins or changes in kind, not one at every tick; and the
        alerts of a defence.
        """
        ...


@dataclass(slots=True)
class Disturbances:
    """What a body fault makes of its vehicles' bodies from one tick to the next: rows in the order of its vehicles."""

    position_enu_m: Floats
    """(n, 3) true position of the gear; not to be written."""
    thrust_share: Floats
    """(n, motors) thrust that each motor gives, as a share 0 to 1 of a sound motor's at the same command; all 1."""
    wind_enu_mps: Floats
    """(n, 3) motion of the air that comes on top of wind and turbulence; all 0."""


class BodyAct(NamedTuple):
    """One act of a body fault, to be labelled: the vehicle and the part of its body that it acted on."""

    vehicle: str
    part: str
    """Such as "motor" or "wind"."""


class BodyHook(Protocol):
    """Acts on bodies: on the thrust of their motors and on the air around them. It belongs to a benign fault.

    It is called once a tick while its fault acts. It is deep-copyable and pure: what it does depends on what it was
    handed and on the time alone. It reads true positions, as nature does; an attack may have none.
    """

    name: str
    """The actor in labels; unique among the body faults of a run."""
    vehicles: Sequence[str]
    """The vehicles on whose bodies it acts: the rows of what it is handed, in this order."""

    def on_bodies(self, now: Time, bodies: Disturbances) -> Sequence[BodyAct]:
        """Write into `bodies` what holds from the tick at `now` to the next; several faults multiply and add up.

        Returns the acts to be labelled: one where a disturbance begins or changes in kind, not one at every tick.
        """
        ...


class Trigger(Protocol):
    """A condition on truth that starts an attack. The kernel evaluates it at world ticks; the attack's parts never do.

    It is deep-copyable and pure: the answer depends on what it was handed alone.
    """

    @property
    def vehicles(self) -> Sequence[str]:
        """The vehicles that the condition is about."""
        ...

    def holds(self, now: Time, truth: Mapping[str, NDArray[np.float64]], rows: Sequence[int]) -> bool:
        """Whether it holds; `truth` has the world's columns, `rows` the rows of its `vehicles` in them, in order."""
        ...


class InstanceStatus(StrEnum):
    """Status of one instance of an engine."""

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
    """Its engine too, which imposes what a vehicle outside the range reports of itself."""
    SIMULATOR = "simulator"
    """A physics simulator of its engine, under the range's own forces: rotors, air and impulses are the world's
    (`BodyInputs`), motion and contacts the simulator's."""


@dataclass(slots=True)
class BodyInputs:
    """What acts on an engine's vehicles from one tick to the next: rows in the engine's vehicle order.

    Arrays are read-only views or copies, valid until the next tick.
    """

    rotor_radps: Floats
    """(n, motors) how fast each rotor turns."""
    air_enu_mps: Floats
    """(n, 3) motion of the air at the vehicle."""
    impulse_ns: Floats
    """(n, 3) impulse in the local frame, N·s: bodies that the world moves have hit the vehicle."""
    angular_impulse_nms: Floats
    """(n, 3) about its centre of gravity, in the local frame, N·m·s."""
    world_position_enu_m: Floats
    """(N, 3) gear of every body of the world, in the world's order: to show bodies that others move."""
    world_attitude: Floats
    """(N, 4) quaternion w, x, y, z of the same."""


@dataclass(slots=True)
class Contacts:
    """Contacts of an engine's vehicles during one tick, as its simulator found them: one row for each pair and part."""

    vehicle: Ints
    """(k,) row of the vehicle in the engine's order."""
    other: Ints
    """(k,) row of the other vehicle; -1 less the index of a building."""
    rotor: Ints
    """(k,) the vehicle's propeller that touched, -1 for its frame."""
    other_rotor: Ints
    """(k,) that of the other vehicle."""
    position_enu_m: Floats
    """(k, 3) point of contact."""
    normal_enu: Floats
    """(k, 3) of length 1, from the other to the vehicle."""


@dataclass(slots=True)
class Poses:
    """Poses of an engine's vehicles by its own dynamics at one tick: rows in the engine's vehicle order.

    Frames are those of `Sensors`. Every number of a fresh row is finite, and its quaternion has length 1 to a
    hundredth; the other rows are not read.
    """

    fresh: NDArray[np.bool_]
    """(n,) whether the row is new; where it is not, the vehicle goes on from its last pose."""
    position_enu_m: Floats
    """(n, 3) of the bottom of the gear."""
    vel_enu_mps: Floats
    """(n, 3) velocity."""
    attitude: Floats
    """(n, 4) quaternion w, x, y, z, body to local."""
    rates_radps: Floats
    """(n, 3) body rates."""
    present: NDArray[np.bool_] | None = None
    """(n,) whether the vehicle exists from now on; `None` where nothing changes. One that does not exist is in no
    truth: its engine keeps it far from all others. A row that changes here is to be fresh."""
    at_next_tick: bool = False
    """Whether a simulator has computed them for the next tick, so that the world takes them as they are; poses of this
    tick it extrapolates to the next."""
    contacts: Contacts | None = None
    """Contacts on the way to these poses, of vehicles that a simulator moves."""


@dataclass(slots=True)
class Finished:
    """Answer of an engine for one tick."""

    actuators: Floats
    """(n, motors) commands in 0…1, rows in the engine's vehicle order.

    For a vehicle that the engine moves itself these are its motor commands there, or zeros where they are not known.
    They do not move it, but turn its rotors, drain its battery and shake its sensors.
    """
    outbox: Outbox
    status: Sequence[InstanceStatus] | None = None
    """Per vehicle; `None` means all are ready."""
    poses: Poses | None = None
    """Poses of the vehicles in `Engine.moves`; `None` means that nothing is new."""


class Engine(Protocol):
    """All aircraft of one autopilot kind, stepped together: first `begin` on all engines, then `finish`.

    Derive from `EngineBase` to get the members from `source` to `close`, which most engines do not need. An engine
    that runs programs starts them at its first `begin` and ends them in `close`. One whose clock is `wall` is a
    `WallEngine`; one that can run several ticks of a world in one call is a `tick_batches.BatchingEngine`.
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
    """Those of `vehicles` whose poses it imposes, by dynamics of its own; the world moves the others. A vehicle whose
    instance dies is moved by the world from then on, and falls."""

    @property
    def source(self) -> Source:
        """What truth says moves the vehicles in `moves`: `Source.KINEMATIC`, or `Source.EXTERNAL`."""
        ...

    @property
    def runs_programs(self) -> bool:
        """Whether it runs programs or reaches for some: it then uses processes, sockets or files, and has no copy."""
        ...

    @property
    def paces_itself(self) -> bool:
        """Of one whose clock is `wall`: whether `finish` waits for that clock; else whoever drives the kernel does."""
        ...

    @property
    def manifest(self) -> Mapping[str, Any]:
        """What the run's manifest says of it beside its kind: of a program its version, path and so on."""
        ...

    def explain_status(self, vehicle: str) -> str:
        """Why a vehicle is not ready or silent, as part of an error message; "" where nothing is known."""
        ...

    def kept_files(self) -> Mapping[str, Path]:
        """Files worth keeping, by their names in the run's folder; asked for once, before `close` removes them."""
        ...

    def close(self) -> None:
        """End what it started. Called once the run has ended, however it did; again does nothing."""
        ...

    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        """Hand the tick's sensors and the mail that came since the last service to all instances."""
        ...

    def finish(self, tick: Time, wall_deadline_s: float) -> Finished:
        """Collect the answers, waiting at most `wall_deadline_s` of wall time for a program."""
        ...


class EngineBase:
    """Members of an engine that runs no programs and imposes poses of its own at most; override those that differ."""

    source: Source = Source.KINEMATIC
    runs_programs: bool = False
    paces_itself: bool = True

    @property
    def manifest(self) -> Mapping[str, Any]:
        """Nothing."""
        return {}

    def explain_status(self, vehicle: str) -> str:
        """Nothing is known."""
        return ""

    def kept_files(self) -> Mapping[str, Path]:
        """No files."""
        return {}

    def close(self) -> None:
        """There is nothing to end."""


ENGINE_MEMBERS = (
    "begin", "clock", "close", "finish", "kept_files", "manifest", "moves", "name", "ports", "preroll_ns", "repeatable",
    "runs_programs", "service_ns", "source", "vehicles", "paces_itself", "explain_status",
)  # fmt: skip
"""The members of `Engine`, by which a missing one is named before a run starts."""


@runtime_checkable
class SimulatorEngine(Engine, Protocol):
    """An engine whose `source` is `Source.SIMULATOR`: it is told each tick what acts on its vehicles.

    Its vehicles go on in the simulator when their autopilots die.
    """

    def set_body_inputs(self, tick: Time, inputs: BodyInputs) -> None:
        """Take what acts from `tick` to the next; called before `begin`."""
        ...


class WallEngine(Engine, Protocol):
    """An engine whose programs run on the machine's clock: `finish` waits until their time has come to the tick.

    It does not wait where `paces_itself` is False: then whoever drives the kernel holds it to the pace.
    """

    pace: float
    """How many simulated seconds pass in a second of the machine's clock."""


class World(Protocol):
    """Owner of truth: bodies in a city, advanced by a fixed quantum."""

    quantum_ns: Time
    vehicles: Sequence[str]

    def advance(self, now: Time) -> Sequence[Note]:
        """Move all bodies from the last tick to `now` under the last actuators; returns notes of what happened."""
        ...

    def sensors(self, rows: slice | NDArray[np.int64]) -> Sensors:
        """The sensors of some vehicles: for an array of rows, arrays of their own, which the caller may alter."""
        ...

    def actuate(self, rows: slice | NDArray[np.int64], actuators: Floats) -> None:
        """Set the motor commands that hold until the next tick."""
        ...

    @property
    def sources(self) -> Sequence[Source]:
        """What moves each body, in vehicle order."""
        ...

    @property
    def present(self) -> NDArray[np.bool_] | None:
        """(n,) which bodies exist, as engines that impose poses tell it; `None` where all do, as they usually do."""
        ...

    def set_source(self, rows: NDArray[np.int64], source: Source) -> None:
        """Have `source` move some bodies from now on; each continues from where it is, with motors at rest."""
        ...

    def impose(self, rows: slice | NDArray[np.int64], poses: Poses) -> None:
        """Set the poses of bodies that are not dynamic; the next tick continues from there.

        Raises `ValueError` for a pose that no body can have, and for a body that is dynamic.
        """
        ...

    def body_inputs(self, rows: slice | NDArray[np.int64]) -> BodyInputs:
        """What acts on some bodies from this tick to the next; the impulses are handed out once."""
        ...

    def disturb(self, rows: NDArray[np.int64], thrust_share: Floats, wind_enu_mps: Floats) -> None:
        """Set what faults make of some bodies, until it is set anew; all 1 and 0 undo it.

        `thrust_share` (rows, motors) 0 to 1 of a sound motor's thrust, `wind_enu_mps` (rows, 3) on top of the wind.
        """
        ...

    def motion(self) -> tuple[Floats, Floats]:
        """Position and velocity, (n, 3) each, in vehicle order: read-only views that later ticks refill."""
        ...

    def truth(self) -> Mapping[str, NDArray[np.float64]]:
        """Named (n,) columns of the true state, in vehicle order; copies, units in the names."""
        ...


class ReceivedSensors(NamedTuple):
    """The readings that the autopilots of some vehicles receive at a tick, after attacks, faults and defences."""

    rows: slice | Ints
    """Of the vehicles among the world's."""
    sensors: Sensors
    """Read-only, and valid until the next tick."""


@runtime_checkable
class SensorObserver(Protocol):
    """An observer that is also told which readings autopilots received."""

    def on_received(self, received: ReceivedSensors) -> None:
        """The readings of the vehicles with sensor faults; called before `on_truth` of the same tick."""
        ...


class Observer(Protocol):
    """A component that sees everything and alters nothing. It is told in simulated-time order of completion."""

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
    """How often it wants truth; `NEVER` for not at all."""
