"""Run agents, engines and a world in virtual time, move every frame over its link, and lose nothing."""

from __future__ import annotations

from skyrange.kernel.kernel import Kernel
from skyrange.kernel.lane import Transit
from skyrange.kernel.wiring import EngineMount, Wiring

__all__ = ["EngineMount", "Kernel", "Transit", "Wiring"]
