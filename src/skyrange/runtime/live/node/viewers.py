"""Viewers of a live range: ground stations that watch at ports of the node in which the autopilots run.

A viewer receives what an autopilot sends to its proxy, at the ports and by the rules of `runtime.viewers`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Final

from skyrange.contracts.frames import Fate, Frame
from skyrange.io.mavlink.viewer_ports import LOOPBACK
from skyrange.runtime.viewers import Address, Viewers

SERVED_S: Final = 0.02
"""Interval at which the viewers' sockets are served."""
Watched = tuple[Address, ...]
"""The TCP port of each aircraft that is watched."""


def assign_viewer_ports(vehicles: Sequence[str], first_port: int, host: str = LOOPBACK) -> Watched:
    """A port of `host` for each aircraft from `first_port` on, 0 for any.

    Raises `InputError` with the ports that are taken.
    """
    with Viewers(vehicles, first_port, host) as tried:
        return tuple(tried.addresses)


class LiveViewers(Viewers):
    """The viewers of the aircraft whose autopilots run in this process.

    An observer of its kernel, like any `Viewers`; a frame for a proxy in another process meets its fate there, so it is
    shown when it leaves.
    """

    def __init__(self, where: Watched) -> None:
        """Listen. Raises `InputError` if a port cannot be had."""
        super().__init__([viewer.vehicle for viewer in where], [viewer.port for viewer in where], where[0].host)
        self._serving: asyncio.Task[None] | None = None

    def show_outgoing(self, frame: Frame) -> None:
        """Show a frame that is being written to a socket."""
        if frame.fate is Fate.IN_FLIGHT:
            self.show(frame)

    def open(self) -> None:
        """Serve in the background from now until `close`."""
        self._serving = asyncio.get_running_loop().create_task(self._serve())

    def close(self) -> None:
        """Close the ports. A second call does nothing."""
        if self._serving is not None:
            self._serving.cancel()
            self._serving = None
        super().close()

    async def _serve(self) -> None:
        while True:
            self.serve()
            await asyncio.sleep(SERVED_S)

    @property
    def status(self) -> Mapping[str, int]:
        """Counts of the viewers' ports, for the supervisor."""
        return {f"viewing_{name}": count for name, count in asdict(self.counts).items()}
