"""A live range in virtual time, and what a test does to it while it flies."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from skyrange.record import RunRecord, load
from skyrange.runtime.interrupt import Interruptible
from skyrange.runtime.live.config import file_name_of
from skyrange.runtime.live.range import LiveRange, prepare_range
from skyrange.runtime.live.supervisor.supervisor import supervise
from skyrange.scenario.model.scenario import Scenario
from skyrange.scenario.toml_files import load_text
from tests.live_ranges import VirtualNetwork, VirtualProcess, VirtualSystem

JITTER_S = 5e-4
"""The mean of what a hop takes in life (docs/explanation/live.md)."""


@dataclass
class VirtualFlight:
    """A live range that flies in virtual time."""

    range: LiveRange
    system: VirtualSystem
    interrupt: Interruptible = field(default_factory=Interruptible)

    @property
    def folder(self) -> Path:
        return self.range.folder

    def part(self, node: str) -> Path:
        """The folder that a node's process records into, by its name as that of a file."""
        return self.folder / ".parts" / node

    def process(self, part: str) -> VirtualProcess | None:
        """The process that records into `part`, once it was started."""
        for node, starts in self.system.processes.items():
            for number, process in enumerate(starts, 1):
                if part == file_name_of(node) + (f".{number}" if number > 1 else ""):
                    return process
        return None

    async def until(self, holds: Callable[[], Any], seconds: float, what: str) -> Any:
        """What `holds` gives once it gives anything, asked twenty times a second of virtual time."""
        loop = asyncio.get_running_loop()
        deadline = loop.time() + seconds
        while not (found := holds()):
            assert loop.time() < deadline, f"not within {seconds:g} s: {what}"
            await asyncio.sleep(0.05)
        return found

    async def reach(self, time_s: float) -> None:
        """Wait for the range's time."""
        while self.range.now_s < time_s:
            await asyncio.sleep(0.01)

    async def decided(self, node: str, table: str, kind: str, count: int = 1, seconds: float = 60.0) -> None:
        """Wait until a node's record has so many notes of a kind."""

        def noted() -> bool:
            part = self.part(node)
            if not (part / "manifest.json").exists():
                return False
            return bool(load(part).table(table, ["kind"]).column("kind").to_pylist().count(kind) >= count)

        while not noted():
            seconds -= 0.5
            assert seconds > 0, f"no {kind}"
            await asyncio.sleep(0.5)


Meddle = Callable[[VirtualFlight], Awaitable[None]]


def scenario_of(text: str) -> Scenario:
    return load_text(text, "test", Path())


def prepared(
    scenario: Scenario | str, folder: Path, *, system: VirtualSystem | None = None, **options: Any
) -> VirtualFlight:
    """A range that is ready to fly into `folder`/run, a process for each component."""
    system = system or VirtualSystem(network=VirtualNetwork(jitter_s=JITTER_S))
    made = scenario_of(scenario) if isinstance(scenario, str) else scenario
    flown = prepare_range(made, folder / "run", system=system, **{"group": "component", **options})
    return VirtualFlight(flown, system)


def fly_virtual(flight: VirtualFlight, *meddles: Meddle) -> RunRecord:
    """Fly it to its end while every one of `meddles` runs beside it; its record.

    Raises what the range ends by; a meddler that has not ended by then is cancelled, one that failed fails all.
    """

    async def both() -> None:
        flying = asyncio.create_task(supervise(flight.range, None, flight.interrupt))
        beside = [asyncio.ensure_future(meddle(flight)) for meddle in meddles]
        try:
            waiting = {flying, *beside}
            while not flying.done():
                done, waiting = await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
                for one in done - {flying}:
                    one.result()
            flying.result()
            for one in beside:
                if one.done():
                    one.result()
        finally:
            for task in (flying, *beside):
                task.cancel()

    flight.system.run(both())
    return load(flight.folder)
