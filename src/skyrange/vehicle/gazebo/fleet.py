"""ArduPilot in lockstep, with aircraft that Gazebo moves.

In each tick Gazebo computes the next tick's poses while the ArduPilots compute their answers to this one's sensors. So
Gazebo knows the rotor speeds that follow from the answers of one tick earlier than the range's own physics would use:
the motors act 2.5 ms later. Rotors, batteries, air, sensors and everything that attacks and faults do to them are the
range's; forces are those of `world.multirotor`; motion and contacts are Gazebo's.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

import numpy as np

from skyrange.city.city import City
from skyrange.codec.gazebo_protocol import INPUT_NUMBERS, POSE_NUMBERS, Aircraft, Stepped, encode_hello
from skyrange.contracts.components import BodyInputs, Contacts, Finished, Poses, Sensors, Source
from skyrange.contracts.mailboxes import Inbox
from skyrange.core.errors import InputError, Problem
from skyrange.core.time import NS_PER_S, Time
from skyrange.io.gazebo import GazeboSimulator, take_port
from skyrange.vehicle.ardupilot.arducopter_binary import find_binary
from skyrange.vehicle.ardupilot.lockstep_fleet import LockstepFleet
from skyrange.vehicle.ardupilot.process_fleet import QUANTUM_NS
from skyrange.vehicle.contract import AutopilotContext, VehicleSpec
from skyrange.vehicle.gazebo.aircraft_model import PlacedAircraft
from skyrange.vehicle.gazebo.gazebo_program import Gazebo, find_gazebo, find_window, window_command
from skyrange.vehicle.gazebo.options import GazeboOptions
from skyrange.vehicle.gazebo.plugin_library import find_plugin
from skyrange.vehicle.gazebo.sdf_elements import model_name
from skyrange.vehicle.gazebo.world_file import write_world
from skyrange.world.airframes import AIR_DENSITY_KGM3, AIRFRAMES, MOTORS

T = TypeVar("T")
MASTER_PORT = "options.gazebo.master_port"


class GazeboFleet(LockstepFleet):
    """A fleet moved by one Gazebo (contract: `contracts.components.SimulatorEngine`)."""

    source = Source.SIMULATOR

    def __init__(self, context: AutopilotContext, options: GazeboOptions) -> None:
        """Find ArduCopter, Gazebo and the plugin; none of them is left running.

        Raises `InputError` if one of them is missing or too old, a port is in use, or a parameter is wrong.
        """
        self._gazebo, self._plugin = _find_programs(options)
        super().__init__(context.name, context.specs, context.origin, context.epoch, options)
        self.moves = self.vehicles
        self._gazebo_options = options
        if options.window:
            self.repeatable = "outcome"  # who uses the window may move things
        own_vehicles = set(self.vehicles)
        self._shown = [row for row, spec in enumerate(context.fleet) if spec.vehicle not in own_vehicles]
        """World rows of the aircraft that Gazebo shows and others move."""
        self._shown_specs = [context.fleet[row] for row in self._shown]
        self._city: City | None = context.city
        self._seed = context.chance.seed
        self._simulator: GazeboSimulator | None = None
        self._gazebo_folder: TemporaryDirectory[str] | None = None
        self._cg_up_m = np.array([AIRFRAMES[spec.airframe].cg_height_m for spec in context.specs])
        self._inputs = np.zeros((len(context.specs), MOTORS + INPUT_NUMBERS))
        self._shown_poses = np.zeros((len(self._shown), POSE_NUMBERS))

    @property
    def manifest(self) -> dict[str, Any]:
        """As `ProcessFleet`, and Gazebo's version, physics engine and rate."""
        started = self._simulator
        entry = {
            "program": str(self._gazebo.path),
            "flavour": str(self._gazebo.flavour),
            "version": self._gazebo.version,
            "plugin": str(self._plugin),
            "steps_per_tick": self._gazebo_options.steps_per_tick,
        }
        if started is not None:
            entry["physics"] = started.physics
        return {**super().manifest, "physics": "gazebo", "gazebo": entry}

    @property
    def cpu_s(self) -> float:
        """Processor time that ArduPilots and Gazebo have used so far, in seconds."""
        return super().cpu_s + self.simulator_cpu_s

    @property
    def simulator_cpu_s(self) -> float:
        """Processor time that Gazebo has used so far, in seconds, without its window."""
        return self._simulator.cpu_s if self._simulator is not None else 0.0

    @property
    def window_cpu_s(self) -> float:
        """Processor time that Gazebo's window has used so far, in seconds; 0 without one."""
        return self._simulator.window_cpu_s if self._simulator is not None else 0.0

    def set_body_inputs(self, tick: Time, inputs: BodyInputs) -> None:
        """Contract: `contracts.components.SimulatorEngine`."""
        if self._simulator is None:
            self._simulator = self._start_gazebo()
        self._inputs[:, :MOTORS] = inputs.rotor_radps
        self._inputs[:, MOTORS : MOTORS + 3] = inputs.air_enu_mps
        self._inputs[:, MOTORS + 3 : MOTORS + 6] = inputs.impulse_ns
        self._inputs[:, MOTORS + 6 :] = inputs.angular_impulse_nms
        if self._shown:
            self._shown_poses[:, :3] = inputs.world_position_enu_m[self._shown]
            self._shown_poses[:, 3:] = inputs.world_attitude[self._shown]

    def begin(self, tick: Time, sensors: Sensors, inbox: Inbox) -> None:
        """As `LockstepFleet`, and let Gazebo compute the tick's motion beside it."""
        super().begin(tick, sensors, inbox)
        if self._simulator is not None and tick >= 0:  # before time 0 all stand at their start
            self._simulator.begin_step(tick, self._inputs, self._shown_poses)

    def finish(self, tick: Time, wall_deadline_s: float) -> Finished:
        """As `LockstepFleet`, with the poses at the next tick."""
        finished = super().finish(tick, wall_deadline_s)
        if self._simulator is not None and tick >= 0:
            finished.poses = self._to_poses(self._simulator.end_step(wall_deadline_s))
        return finished

    def _to_poses(self, stepped: Stepped) -> Poses:
        states = stepped.states
        position = states[:, 0:3].copy()
        position[:, 2] -= self._cg_up_m
        contacts = stepped.contacts
        return Poses(
            np.ones(len(states), dtype=np.bool_),
            position,
            states[:, 3:6],
            states[:, 6:10],
            states[:, 10:13],
            at_next_tick=True,
            contacts=Contacts(
                contacts["vehicle"].astype(np.int64),
                contacts["other"].astype(np.int64),
                contacts["rotor"].astype(np.int64),
                contacts["other_rotor"].astype(np.int64),
                contacts["position_m"],
                contacts["normal"],
            )
            if len(contacts)
            else None,
        )

    def _start_gazebo(self) -> GazeboSimulator:
        self._gazebo_folder = TemporaryDirectory(prefix="skyrange-gazebo-world-")
        folder = Path(self._gazebo_folder.name)
        steps = self._gazebo_options.steps_per_tick
        step_s = QUANTUM_NS / NS_PER_S / steps
        world = write_world(
            folder,
            [_placed(spec) for spec in self._specs],
            [_placed(spec) for spec in self._shown_specs],
            city=self._city,
            origin=self._origin,
            wind_enu_mps=self._specs[0].wind_enu_mps,
            step_s=step_s,
            flavour=self._gazebo.flavour.value,
            plugin=self._plugin,
        )
        hello = encode_hello(
            [describe_aircraft(spec) for spec in self._specs],
            [model_name(spec.vehicle) for spec in self._shown_specs],
            step_s,
            steps,
            MOTORS,
        )
        master = take_port(self._gazebo_options.master_port, MASTER_PORT)
        sizes = len(self._specs), 0 if self._city is None else len(self._city.buildings)
        window = window_command(self._gazebo, master) if self._gazebo_options.window else ()
        command = self._gazebo.server_command(world, seed=self._seed & 0x7FFFFFFF, port=master)
        return GazeboSimulator(f"engine {self.name}", command, hello, sizes, window)

    def close(self) -> None:
        """End Gazebo and the ArduPilots. A second call does nothing."""
        if self._simulator is not None:
            self._simulator.close()
        if self._gazebo_folder is not None:
            self._gazebo_folder.cleanup()
            self._gazebo_folder = None
        super().close()


def _find_programs(options: GazeboOptions) -> tuple[Gazebo, Path]:
    """Gazebo and the plugin for it. Raises `InputError` with all that is missing, of ArduCopter too."""
    problems: list[Problem] = []

    def seek(find: Callable[[], T]) -> T | None:
        try:
            return find()
        except InputError as error:
            problems.extend(replace(fault, where=f"{error.who}: {fault.where}") for fault in error.problems)
            return None

    seek(find_binary)
    gazebo = seek(find_gazebo)
    plugin = None if gazebo is None else seek(lambda: find_plugin(gazebo))
    if gazebo is not None and options.window:
        seek(lambda: find_window(gazebo))
    if options.master_port:
        seek(lambda: take_port(options.master_port, MASTER_PORT))
    if gazebo is None or plugin is None or problems:
        raise InputError("autopilot gazebo", problems)
    return gazebo, plugin


def _placed(spec: VehicleSpec) -> PlacedAircraft:
    operator = spec.vehicle.partition("/")[0]
    return PlacedAircraft(spec.vehicle, operator, spec.airframe, *spec.home_enu_m, spec.heading_deg)


def describe_aircraft(spec: VehicleSpec) -> Aircraft:
    """What the plugin is told of an aircraft."""
    airframe = AIRFRAMES[spec.airframe]
    drag = 0.5 * AIR_DENSITY_KGM3 * airframe.drag_area_m2
    return Aircraft(
        model_name(spec.vehicle),
        airframe.thrust_ns2,
        airframe.torque_arm_m,
        airframe.rotor_drag_ns2,
        drag,
        drag * airframe.arm_m**3,
        [(rotor.forward_m, rotor.left_m, rotor.spin) for rotor in airframe.rotors],
    )
