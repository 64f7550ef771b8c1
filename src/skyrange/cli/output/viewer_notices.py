"""Messages about viewers of a run or of a live range: addresses at the start, counts at the end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from skyrange.cli.output.console import print_notice
from skyrange.cli.output.warnings import print_warnings
from skyrange.core.ids import vehicle_id

if TYPE_CHECKING:
    from skyrange.cli.options import ViewerOptions
    from skyrange.io.mavlink.viewer_ports import ViewerCounts
    from skyrange.runtime.live.range import LiveRange, OnUpdate
    from skyrange.runtime.viewers import Address, Viewers
    from skyrange.scenario.model.scenario import Scenario

MAX_LINES = 60


@contextmanager
def open_viewers(scenario: Scenario, options: ViewerOptions) -> Iterator[Viewers | None]:
    """Open the viewers' ports for `fly`, if they are wanted. Messages go to standard error."""
    for line in open_port_warning(scenario):
        print_notice(line)
    if not options.wanted:
        yield None
        return
    from skyrange.runtime.viewers import FIRST_PORT, Viewers

    system_ids = {vehicle_id(operator.id, vehicle.id): vehicle.system_id for operator, vehicle in scenario.fleet}
    first_port = FIRST_PORT if options.first_port is None else options.first_port
    with Viewers(list(system_ids), first_port, options.host) as viewers:
        for line in viewer_address_lines(viewers.addresses, system_ids):
            print_notice(line)
        yield viewers
    if viewers.counts.viewers:
        print_notice(viewer_counts_text(viewers.counts))


def viewer_address_lines(addresses: Sequence[Address], system_ids: dict[str, int]) -> list[str]:
    """Lines with the address of each aircraft for viewers, and how to connect."""
    lines = ["viewers can connect here (read-only; data from viewers is discarded):"]
    width = max((len(vehicle) for vehicle in system_ids), default=0)
    for vehicle, host, port in addresses[:MAX_LINES]:
        lines.append(f"  {vehicle:<{width}}  tcp {host}:{port}  system id {system_ids[vehicle]}")
    if len(addresses) > MAX_LINES:
        last = addresses[-1]
        lines.append(f"  … and so on, up to {last.vehicle} at port {last.port}")
    if addresses:
        _, host, port = addresses[0]
        lines.append(f"  MAVProxy: mavproxy.py --master=tcp:{host}:{port}")
        lines.append(f"  QGroundControl: Application Settings, Comm Links, Add: type TCP, server {host}, port {port}")
    if any(count > 1 for count in Counter(system_ids.values()).values()):
        lines.append(
            "  several aircraft have the same system id: connect a ground station to only one aircraft of each id"
        )
    return lines


def open_port_warning(scenario: Scenario) -> list[str]:
    """Lines that warn of autopilots which listen on network ports themselves."""
    from skyrange.vehicle.contract import AutopilotPlugin

    ports: list[str] = []
    for kind in scenario.autopilots.options:
        vehicles = [
            vehicle_id(operator.id, vehicle.id) for operator, vehicle in scenario.fleet if vehicle.autopilot == kind
        ]
        opened = AutopilotPlugin.find(kind).opened_ports(scenario.autopilots.params_of(kind), len(vehicles))
        ports += [f"  {vehicle} at port {port}" for vehicle, port in zip(vehicles, opened, strict=False)]
    if not ports:
        return []
    return [
        "WARNING: these autopilots listen on ALL network interfaces and obey every ground station that connects. Its",
        "heartbeats hide the loss of the aircraft's own ground station, and the run is not repeatable:",
        *ports[:MAX_LINES],
        *([f"  … and {len(ports) - MAX_LINES} more"] if len(ports) > MAX_LINES else []),
    ]


def viewer_counts_text(counts: ViewerCounts) -> str:
    """The number of viewers, and the data that was discarded, as text."""
    text = f"viewers: {counts.viewers} connected; {counts.bytes_ignored:,} bytes that they sent were discarded"
    if counts.frames_lost:
        text += f"; {counts.frames_lost:,} frames were dropped because a viewer read too slowly"
    if counts.displaced:
        text += f"; {counts.displaced} connections gave way to others"
    return text


def tell_when_up(flown: LiveRange, on_update: OnUpdate | None) -> OnUpdate:
    """`on_update` that also prints where aircraft can be watched, as soon as every process is up.

    The ports then listen. Before that, processes may compile for a minute.
    """
    printed = False

    def update(now: LiveRange) -> None:
        nonlocal printed
        if now.zero_ns and not printed:
            printed = True
            print_viewer_addresses(flown)
        if on_update is not None:
            on_update(now)

    return update


def print_open_ports(flown: LiveRange) -> None:
    """Warn of autopilots that listen on network ports themselves."""
    for line in open_port_warning(flown.built.scenario):
        print_notice(line)
    print_warnings(flown.built.scenario)


def print_viewer_addresses(flown: LiveRange) -> None:
    """Print the address of each aircraft for viewers, if viewers were requested."""
    lines: list[str] = []
    if flown.watched:
        fleet = flown.built.scenario.fleet
        systems = {vehicle_id(operator.id, vehicle.id): vehicle.system_id for operator, vehicle in fleet}
        lines = viewer_address_lines(flown.watched, systems)
    for line in lines:
        print_notice(line)


def print_viewer_counts(flown: LiveRange) -> None:
    """Print counts of viewers, if any connected."""
    from skyrange.io.mavlink.viewer_ports import ViewerCounts

    statuses = [member.status for member in flown.members.values() if member.status.get("viewing_viewers")]
    for status in statuses:
        prefix = "viewing_"
        counts = {name.removeprefix(prefix): int(value) for name, value in status.items() if name.startswith(prefix)}
        print_notice(viewer_counts_text(ViewerCounts(**counts)))
