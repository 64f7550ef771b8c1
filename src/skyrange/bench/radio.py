"""Benchmark of radio media: aircraft over a city at one density, which all broadcast on Wi-Fi once a second.

The oracle is driven as a kernel would: frames on `rid_up` come in, receptions on `rid_down` go out, positions move.
"""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skyrange.bench.yardstick import yardstick_us
from skyrange.city.city import City
from skyrange.city.downtown import downtown_grid
from skyrange.codec.remote_id import link_payload
from skyrange.codec.remote_id.link_payload import RidHeader, Transport
from skyrange.contracts.mailboxes import Arrival, Inbox
from skyrange.contracts.medium import Medium, RadioSpec
from skyrange.core.chance import Chance
from skyrange.core.compiled import compiled
from skyrange.core.errors import ComponentError
from skyrange.core.ids import FrameId, Port, link_name
from skyrange.core.time import NS_PER_S
from skyrange.io.processes.program import processor_time_s
from skyrange.radio.builtin.listening import COMPANION
from skyrange.radio.builtin.medium import BuiltinMedium
from skyrange.radio.builtin.params import RadioEnvironment
from skyrange.radio.contract import MediumContext, MediumPlugin
from skyrange.radio.oracle import Oracle
from skyrange.radio.phy import MIN_SNIR_DB
from skyrange.radio.propagation.link_budget import MediumParams, max_range_m
from skyrange.radio.propagation.obstruction import Obstacles, obstruction_db
from skyrange.radio.propagation.path_loss import MIN_DISTANCE_M, noise_dbm, open_ground_db, wavelength_m

PER_KM2 = 50.0
"""Aircraft per square kilometre, whatever their number: the city grows with them."""
SPEED_MPS = 10.0
BODY_BYTES = 178
"""A pack of seven messages, as 14 CFR 89.305 fills it."""
CENTRE_MHZ = 2437.0
Floats = NDArray[np.float64]


class Fleet:
    """A world of aircraft that fly straight, 30 to 100 m up, and turn back at the city's edge."""

    def __init__(self, nodes: int, side_m: float, city: City) -> None:
        rng = np.random.default_rng(nodes)
        self.vehicles = [f"op/v{k + 1}" for k in range(nodes)]
        half = 0.5 * side_m
        place = np.column_stack((rng.uniform(-half, half, (nodes, 2)), rng.uniform(30.0, 100.0, nodes)))
        for _ in range(100):
            inside = [k for k in range(nodes) if city.inside(*place[k])]
            if not inside:
                break
            place[inside, :2] = rng.uniform(-half, half, (len(inside), 2))
        heading = rng.uniform(0.0, 2.0 * math.pi, nodes)
        self.place = place
        self.velocity = SPEED_MPS * np.column_stack((np.cos(heading), np.sin(heading), np.zeros(nodes)))
        self.half = half

    def move(self, seconds: float) -> None:
        """Fly on for `seconds`."""
        self.place += seconds * self.velocity
        for axis in range(2):
            beyond = np.abs(self.place[:, axis]) > self.half
            self.velocity[beyond, axis] = -np.sign(self.place[beyond, axis]) * np.abs(self.velocity[beyond, axis])

    def motion(self) -> tuple[Floats, Floats]:
        """Positions and velocities, as of a world."""
        return self.place, self.velocity


@compiled
def _all_lines(
    obstacles: Obstacles, place: Floats, reach: float, power_dbm: float, floor_dbm: float, wavelength: float
) -> int:
    """Trace each sight line between two aircraft in reach, as one second's broadcasts do; the number of lines."""
    lines = 0
    for i in range(place.shape[0]):
        for j in range(place.shape[0]):
            dx, dy, dz = place[j, 0] - place[i, 0], place[j, 1] - place[i, 1], place[j, 2] - place[i, 2]
            distance = math.sqrt(dx * dx + dy * dy + dz * dz)
            if i == j or distance > reach:
                continue
            margin = (
                power_dbm
                - open_ground_db(max(distance, MIN_DISTANCE_M), place[i, 2], place[j, 2], wavelength)
                - floor_dbm
            )
            if margin >= 0.0:
                lines += 1
                if (
                    obstruction_db(
                        obstacles,
                        place[i, 0],
                        place[i, 1],
                        place[i, 2],
                        place[j, 0],
                        place[j, 1],
                        place[j, 2],
                        wavelength,
                        margin,
                    )
                    < -1e3
                ):  # never: but what is not used might not be computed
                    lines -= 1
    return lines


def measure(nodes: int, seconds: float, horizon_m: float = 500.0, engine: str = "builtin") -> dict[str, Any]:
    """One row: `nodes` aircraft for `seconds` simulated seconds, with the medium `engine` and its default parameters.

    `cpu_s` are the CPU seconds of the oracle and of the medium's programs; the programs took `engine_cpu_s` of them, to
    a tick of the system's clock (10 ms). `real_time_factor` is simulated over CPU seconds; `us_per_node_s` the cost of
    a node per second; `transmissions_per_s` and `receptions_per_s` are per CPU second; `heard_by` is the mean number of
    receivers of a broadcast; `lines_per_s` the sight lines traced per simulated second and `line_of_sight_share` their
    share of the time, measured separately, both None for another medium than the builtin; `yardstick_us` is as in
    `bench fleet`. Raises `InputError` for an engine that is not known or not installed.
    """
    if nodes < 2:
        raise ComponentError(f"bench with {nodes} radios", "nobody to hear", "Ask for 2 or more")
    side_m = 1_000.0 * math.sqrt(nodes / PER_KM2)
    city = downtown_grid((math.ceil(side_m / 96.0),) * 2)
    fleet = Fleet(nodes, side_m, city)
    radios = [RadioSpec(name, listening=COMPANION) for name in fleet.vehicles]
    plugin = MediumPlugin.find(engine)
    context = MediumContext(radios, Chance(nodes), city, RadioEnvironment(horizon_m=horizon_m))
    medium = plugin(plugin.params(), context)
    try:
        return _measure(engine, medium, fleet, seconds, horizon_m)
    finally:
        medium.close()


def _measure(engine: str, medium: Medium, fleet: Fleet, seconds: float, horizon_m: float) -> dict[str, Any]:
    nodes = len(fleet.vehicles)
    oracle = Oracle(medium, fleet.vehicles, fleet.vehicles)
    payload = link_payload.pack(RidHeader(Transport.WIFI_BEACON, channel=6), bytes(BODY_BYTES))
    names = [link_name("rid_up", name) for name in fleet.vehicles]
    phase = np.random.default_rng(nodes).integers(1, NS_PER_S, nodes)
    steps = NS_PER_S // oracle.service_ns
    by_step: list[list[int]] = [[] for _ in range(steps)]
    for node in np.argsort(phase).tolist():
        by_step[int(-(-phase[node] // oracle.service_ns)) - 1].append(node)
    spent, received, sent = 0.0, 0, 0
    warm, before_s = steps, 0.0
    for step in range(1, warm + round(seconds * steps) + 1):
        now = step * oracle.service_ns
        second, turn = divmod(step - 1, steps)
        mail = []
        for node in by_step[turn]:
            at = second * NS_PER_S + int(phase[node])
            ref = FrameId(names[node], "fwd", fleet.vehicles[node], second)
            mail.append(Arrival(Port("oracle", names[node]), at, payload, fleet.vehicles[node], ref))
        fleet.move(oracle.service_ns / NS_PER_S)
        began = time.process_time()
        oracle.observe(now, fleet)  # type: ignore[arg-type]
        outbox = oracle.step(now, Inbox(mail)) if mail or not medium.quiet else None
        if step <= warm:
            before_s = _programs_cpu_s(medium) if step == warm else 0.0
            continue
        spent += time.process_time() - began
        sent += len(mail)
        received += sum(len(block.places) for block in outbox.blocks) if outbox is not None else 0
    engine_s = _programs_cpu_s(medium) - before_s
    spent += engine_s
    lines, share = None, None
    if isinstance(medium, BuiltinMedium):
        lines, lines_s = _time_lines(medium, fleet.place)
        share = round(min(lines_s * seconds / spent, 1.0), 3)
    return {
        "engine": engine,
        "nodes": nodes,
        "seconds": seconds,
        "per_km2": PER_KM2,
        "horizon_m": horizon_m,
        "real_time_factor": round(seconds / spent, 2),
        "us_per_node_s": round(spent / seconds / nodes * 1e6, 1),
        "cpu_s": round(spent, 3),
        "engine_cpu_s": round(engine_s, 3),
        "transmissions_per_s": round(sent / spent, 1),
        "receptions_per_s": round(received / spent, 1),
        "heard_by": round(received / max(sent, 1), 2),
        "lines_per_s": lines,
        "line_of_sight_share": share,
        "yardstick_us": round(yardstick_us(), 2),
    }


def _programs_cpu_s(medium: Medium) -> float:
    return sum(processor_time_s(program.pid) for program in medium.programs)


def _time_lines(medium: BuiltinMedium, place: Floats) -> tuple[int, float]:
    """The number of sight lines that a second's broadcasts trace, and the CPU seconds that this takes."""
    params: MediumParams = medium._params
    spec = medium.radios[0]
    floor = float(noise_dbm(spec.noise_figure_db, 20.0)) + float(MIN_SNIR_DB[1]) - 3.0
    reach = min(max_range_m(0.0, spec.wifi_dbm, floor, CENTRE_MHZ), params.horizon_m)
    arguments = (medium._obstacles, place, reach, spec.wifi_dbm, floor, wavelength_m(CENTRE_MHZ))
    _all_lines(*arguments)
    began = time.process_time()
    lines = _all_lines(*arguments)
    return lines, time.process_time() - began
