"""The simulation kernel: agents, engines and a world in virtual time, and every frame on its links."""

from __future__ import annotations

from skyrange.kernel.directed_link import Transit
from skyrange.kernel.kernel import Kernel
from skyrange.kernel.wiring import EngineMount, Wiring

__all__ = ["EngineMount", "Kernel", "Transit", "Wiring"]
