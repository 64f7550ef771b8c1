"""skyrange: a cyber range for the sky.

>>> import skyrange
>>> record = skyrange.run("squares")      # doctest: +SKIP
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from skyrange.agent.plugins import register
    from skyrange.core.errors import SkyrangeError
    from skyrange.record import load
    from skyrange.scenario.schema import Scenario
    from skyrange.study.pairing import pair
    from skyrange.study.session import run

__version__ = "0.1.0"

__all__ = ["Scenario", "SkyrangeError", "__version__", "load", "pair", "register", "run"]

_HOMES = {
    "Scenario": "skyrange.scenario.schema",
    "SkyrangeError": "skyrange.core.errors",
    "load": "skyrange.record",
    "pair": "skyrange.study.pairing",
    "register": "skyrange.agent.plugins",
    "run": "skyrange.study.session",
}


def __getattr__(name: str) -> Any:
    """Import on first use, so that `import skyrange` stays quick."""
    home = _HOMES.get(name)
    if home is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(home), name)


def __dir__() -> list[str]:
    return sorted(__all__)
