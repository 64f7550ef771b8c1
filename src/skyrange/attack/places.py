"""Places as parameters of attacks."""

from __future__ import annotations

from typing import Any

from skyrange.contracts.plugins.form import MISSING, param


def place_param(what: str, *, default: Any = MISSING) -> Any:
    """A parameter that is a place; its description begins with `what`, such as "Position of the jammer".

    The anchor of an attack moves it, if it is one of the kind's `places`.
    """
    description = f"{what}, [east_m, north_m, up_m] in metres from the origin or the attack's anchor."
    return param(description, default=default)
