"""How does a person come to watch a live range? Where to connect, and at the end what viewers did."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from skyrange.cli.viewing import farewell, invitation, warning
from skyrange.core.ids import vehicle_id

if TYPE_CHECKING:
    from skyrange.runtime.live.range import Range


def first_port(qgc: bool, viewer_port: int | None, port_offset: int) -> int | None:
    """The first viewer's port that was asked for; `None` where none was."""
    from skyrange.runtime.viewers import FIRST_PORT

    if viewer_port is not None:
        return viewer_port
    return FIRST_PORT + port_offset if qgc else None


def invite(flown: Range) -> None:
    """Say where each aircraft is watched, if any is."""
    from skyrange.io.viewing import LOOPBACK
    from skyrange.runtime.viewers import Address

    lines = warning(flown.rig.scenario)
    if flown.watched:
        fleet = flown.rig.scenario.fleet
        systems = {vehicle_id(operator.id, vehicle.id): vehicle.system_id for operator, vehicle in fleet}
        lines += invitation([Address(vehicle, LOOPBACK, port) for vehicle, port in flown.watched], systems)
    for line in lines:
        print(line, file=sys.stderr, flush=True)


def see_off(flown: Range) -> None:
    """Say what viewers did, if any came."""
    from skyrange.io.viewing import Counts

    said = [member.status for member in flown.members.values() if member.status.get("viewing_viewers")]
    for status in said:
        prefix = "viewing_"
        counts = {name.removeprefix(prefix): int(value) for name, value in status.items() if name.startswith(prefix)}
        print(farewell(Counts(**counts)), file=sys.stderr)
