"""Messages about viewers of a live range: addresses at the start, counts at the end."""

from __future__ import annotations

from typing import TYPE_CHECKING

from skyrange.cli.output.console import print_notice
from skyrange.cli.output.viewer_notices import open_port_warning, viewer_address_lines, viewer_counts_text
from skyrange.cli.output.warnings import print_warnings
from skyrange.core.ids import vehicle_id

if TYPE_CHECKING:
    from skyrange.runtime.live.range import LiveRange, OnUpdate


def first_port(qgc: bool, viewer_port: int | None, port_offset: int) -> int | None:
    """The first viewer port that was requested; `None` if viewers were not requested."""
    from skyrange.runtime.viewers import FIRST_PORT

    if viewer_port is not None:
        return viewer_port
    return FIRST_PORT + port_offset if qgc else None


def tell_when_up(flown: LiveRange, on_update: OnUpdate | None) -> OnUpdate:
    """`on_update` that also prints where aircraft can be watched, as soon as every process is up.

    The ports then listen. Before that, processes may compile for a minute.
    """
    told = False

    def update(now: LiveRange) -> None:
        nonlocal told
        if now.zero_ns and not told:
            told = True
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
