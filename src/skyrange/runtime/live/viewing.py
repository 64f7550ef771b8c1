"""How do ground stations watch a live range? From the node of the autopilots, which reads nothing of what they send.

A viewer is shown what leaves an autopilot for its proxy, at the ports and by the rules of `runtime.viewers`.
"""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Final

from skyrange.agent.frames import Fate, Frame
from skyrange.runtime.viewers import Viewers

SERVED_S: Final = 0.02
"""Between two looks at the viewers' sockets."""
Watched = tuple[tuple[str, int], ...]
"""Each aircraft that is watched, and the TCP port where."""


def watched(vehicles: Sequence[str], first_port: int) -> Watched:
    """A port for each aircraft, `first_port` and on, 0 for any; all are free now, or `InputError` says which is not."""
    with Viewers(vehicles, first_port) as tried:
        return tuple((vehicle, port) for vehicle, _, port in tried.addresses)


class Viewing(Viewers):
    """The viewers of the aircraft whose autopilots live in this process.

    An observer of its kernel, as any `Viewers`; a frame that leaves for a proxy in another process meets its fate
    there, and is shown as it leaves.
    """

    def __init__(self, where: Watched) -> None:
        """Listen. `InputError` where a port cannot be had."""
        super().__init__([vehicle for vehicle, _ in where], [port for _, port in where])
        self._serving: asyncio.Task[None] | None = None

    def leaves(self, frame: Frame) -> None:
        """Show a frame that is written to a socket now."""
        if frame.fate is Fate.IN_FLIGHT:
            self.show(frame)

    def open(self) -> None:
        """Serve from now until `close`, beside whatever else this process does."""
        self._serving = asyncio.get_running_loop().create_task(self._serve())

    def close(self) -> None:
        """Give the ports back. Again does nothing."""
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
        """What viewers did, for the supervisor."""
        return {f"viewing_{name}": count for name, count in asdict(self.counts).items()}
