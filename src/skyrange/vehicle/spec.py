"""What does an autopilot need to know of an aircraft before the run? The same for every kind of engine."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from skyrange.codec.signing import SigningKey


@dataclass(frozen=True, slots=True)
class VehicleSpec:
    """One aircraft: it starts at `home_enu_m`, with `heading_deg` clockwise from north.

    `system_id` is its MAVLink system in the operator's network number `network`. `params` are ArduCopter parameters in
    their own units that replace defaults. `wind_enu_mps` is the steady wind, for engines with dynamics of their own.
    With a `signing_key` its MAVLink is signed, and commands to it must be signed.
    """

    vehicle: str
    system_id: int
    airframe: str = "iris"
    home_enu_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    heading_deg: float = 0.0
    params: Mapping[str, float] = field(default_factory=dict)
    network: int = 0
    wind_enu_mps: tuple[float, float, float] = (0.0, 0.0, 0.0)
    signing_key: SigningKey | None = field(default=None, repr=False)
