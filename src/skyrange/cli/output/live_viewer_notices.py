"""Messages about viewers of a live range: addresses at the start, counts at the end."""

from __future__ import annotations

from typing import TYPE_CHECKING

from skyrange.cli.output.console import print_notice
from skyrange.cli.output.viewer_notices import open_port_warning, viewer_address_lines, viewer_counts_text
from skyrange.core.ids import vehicle_id

if TYPE_CHECKING:
    from skyrange.runtime.live.range import LiveRange


def first_port(qgc: bool, viewer_port: int | None, port_offset: int) -> int | None:
    """The first viewer port that was requested; `None` if viewers were not requested."""
    from skyrange.runtime.viewers import FIRST_PORT

    if viewer_port is not None:
        return viewer_port
    return FIRST_PORT + port_offset if qgc else None


def print_viewer_addresses(flown: LiveRange) -> None:
    """Print the address of each aircraft for viewers, if viewers were requested."""
    from skyrange.io.mavlink.viewer_ports import LOOPBACK
    from skyrange.runtime.viewers import Address

    lines = open_port_warning(flown.built.scenario)
    if flown.watched:
        fleet = flown.built.scenario.fleet
        systems = {vehicle_id(operator.id, vehicle.id): vehicle.system_id for operator, vehicle in fleet}
        lines += viewer_address_lines([Address(vehicle, LOOPBACK, port) for vehicle, port in flown.watched], systems)
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
