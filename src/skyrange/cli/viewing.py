"""How does a person come to watch a run? Where to connect with what, and at the end what viewers did."""

from __future__ import annotations

import sys
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from skyrange.core.ids import vehicle_id

if TYPE_CHECKING:
    from skyrange.io.viewing import Counts
    from skyrange.runtime.viewers import Address, Viewers
    from skyrange.scenario.schema import Scenario

MOST_LINES = 60


@contextmanager
def watchable(scenario: Scenario, wanted: bool, first_port: int | None) -> Iterator[Viewers | None]:
    """Gives the viewers' ports for `fly`, if `wanted`. What it says goes to standard error, as progress does."""
    for line in warning(scenario):
        print(line, file=sys.stderr, flush=True)
    if not wanted:
        yield None
        return
    from skyrange.runtime.viewers import FIRST_PORT, Viewers

    system_ids = {vehicle_id(operator.id, vehicle.id): vehicle.system_id for operator, vehicle in scenario.fleet}
    with Viewers(list(system_ids), FIRST_PORT if first_port is None else first_port) as viewers:
        for line in invitation(viewers.addresses, system_ids):
            print(line, file=sys.stderr, flush=True)
        yield viewers
    if viewers.counts.viewers:
        print(farewell(viewers.counts), file=sys.stderr)


def invitation(addresses: Sequence[Address], system_ids: dict[str, int]) -> list[str]:
    """Where each aircraft is watched, and how."""
    lines = ["watch, read-only (what a viewer sends is thrown away):"]
    width = max((len(vehicle) for vehicle in system_ids), default=0)
    for vehicle, host, port in addresses[:MOST_LINES]:
        lines.append(f"  {vehicle:<{width}}  tcp {host}:{port}  system id {system_ids[vehicle]}")
    if len(addresses) > MOST_LINES:
        last = addresses[-1]
        lines.append(f"  … and so on, to {last.vehicle} at {last.port}")
    if addresses:
        _, host, port = addresses[0]
        lines.append(f"  MAVProxy: mavproxy.py --master=tcp:{host}:{port}")
        lines.append(f"  QGroundControl: Application Settings, Comm Links, Add: type TCP, server {host}, port {port}")
    if any(count > 1 for count in Counter(system_ids.values()).values()):
        lines.append("  a ground station that is connected to several aircraft of one system id takes them for one")
    return lines


def warning(scenario: Scenario) -> list[str]:
    """What to know where autopilots listen themselves."""
    from skyrange.vehicle.spec import AutopilotPlugin

    ports: list[str] = []
    for kind in scenario.autopilots.options:
        own = [vehicle_id(operator.id, vehicle.id) for operator, vehicle in scenario.fleet if vehicle.autopilot == kind]
        opened = AutopilotPlugin.find(kind).opened_ports(scenario.autopilots.params_of(kind), len(own))
        ports += [f"  {vehicle} at port {port}" for vehicle, port in zip(own, opened, strict=False)]
    if not ports:
        return []
    return [
        "WARNING: these autopilots listen on ALL network interfaces and obey whoever connects. Their heartbeats hide",
        "a lost ground station, and the run does not repeat:",
        *ports[:MOST_LINES],
        *([f"  … and {len(ports) - MOST_LINES} more"] if len(ports) > MOST_LINES else []),
    ]


def farewell(counts: Counts) -> str:
    """What viewers did."""
    said = f"viewers: {counts.viewers} came and sent {counts.bytes_ignored:,} bytes that nobody heard"
    if counts.frames_lost:
        said += f"; {counts.frames_lost:,} frames were too many for those that read slowly"
    if counts.turned_away:
        said += f"; {counts.turned_away} more were turned away"
    return said
