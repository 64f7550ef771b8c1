"""skyrange: a cyber range for the sky.

>>> import skyrange
>>> record = skyrange.run("squares")      # doctest: +SKIP

Public are this module, `skyrange.scenario`, `skyrange.plugin`, `skyrange.analysis`, `skyrange.env` and
`skyrange.testing`. All other modules are private and may change.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from skyrange.core.lazy_exports import export_lazily

if TYPE_CHECKING:
    from skyrange.contracts.plugins.registry import register
    from skyrange.core.errors import InputError, SkyrangeError
    from skyrange.record import load
    from skyrange.runtime.acts import RunAct
    from skyrange.runtime.run import Run
    from skyrange.runtime.viewers import Viewers
    from skyrange.scenario.model.scenario import Scenario
    from skyrange.study.pairing import pair
    from skyrange.study.runs import run

__version__ = "0.1.0"

__all__ = [
    "InputError",
    "Run",
    "RunAct",
    "Scenario",
    "SkyrangeError",
    "Viewers",
    "__version__",
    "load",
    "pair",
    "register",
    "run",
]

if not TYPE_CHECKING:
    __getattr__ = export_lazily(
        __name__,
        {
            "skyrange.contracts.plugins.registry": "register",
            "skyrange.core.errors": "InputError SkyrangeError",
            "skyrange.record": "load",
            "skyrange.runtime.acts": "RunAct",
            "skyrange.runtime.run": "Run",
            "skyrange.runtime.viewers": "Viewers",
            "skyrange.scenario.model.scenario": "Scenario",
            "skyrange.study.pairing": "pair",
            "skyrange.study.runs": "run",
        },
    )


def __dir__() -> list[str]:
    return sorted(__all__)
