"""Light of a scan: what attacks and faults may alter of it before a LiDAR or a depth camera measures it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from skyrange.core.arrays import Floats
from skyrange.core.time import Time

ScannerKind = Literal["lidar", "depth"]
SCANNER_KINDS: Final[tuple[ScannerKind, ...]] = ("lidar", "depth")


@dataclass(slots=True)
class ScanLight:
    """The light of the n pulses or pixels of one scan. Hooks write into what begins with `transmission`."""

    vehicle: str
    sensor: str
    """Its id on the vehicle."""
    kind: ScannerKind
    near_m: float
    """What is nearer is not returned."""
    reach_m: float
    wavelength_um: float
    velocity: Floats
    """(3,) of the aircraft at the start of the scan, in m/s."""
    origin: Floats
    """(n, 3) true place of the sensor at each pulse: east, north and up in m. Not to be written."""
    direction: Floats
    """(n, 3) unit vectors: east, north and up. Not to be written."""
    in_base: Floats
    """(n, 3) the same in the frame of the sensor's base: forward, left and up. Not to be written."""
    ahead: Floats
    """(n,) cosine of the angle between a ray and the axis of the sensor. Not to be written."""
    delay_s: Floats
    """(n,) since the start of the scan. Not to be written."""
    is_in_sight: Callable[[tuple[float, float, float]], bool]
    """Whether no building and no ground is between the sensor, at the middle of the scan, and a place."""
    transmission: Floats
    """(n,) share of the power that passes the sensor's window on both ways; all 1."""
    false_echo_m: Floats
    """(n,) distance of a false echo that is stronger than any true one; all not a number, which is none. One that is
    nearer than `near_m` leaves no return, as any echo there."""
    is_blind: NDArray[np.bool_]
    """(n,) whether the receiver is saturated, so that it returns nothing; all False."""
    extinction_per_m: float = 0.0
    """What rain and fog of faults add to the extinction coefficient of the air."""


class ScanHook(Protocol):
    """Alters the light of scans. It belongs to an attack or to a fault.

    It is called for each scan of its vehicles' sensors that begins while its act acts, in order of act and name. It is
    deep-copyable and pure: what it does depends on what it was handed and on the time alone. It may read true places
    and directions, as nature does, to find where light goes. Of two false echoes of a pulse the later hook's counts.
    """

    @property
    def name(self) -> str:
        """The actor in labels; unique among the scan hooks of a run."""
        ...

    @property
    def vehicles(self) -> Sequence[str]:
        """The vehicles whose sensors it acts on."""
        ...

    @property
    def kinds(self) -> Sequence[ScannerKind]:
        """The kinds of sensors that it acts on."""
        ...

    @property
    def sensor(self) -> str | None:
        """Id of the sensor; `None` for all of its kinds."""
        ...

    def on_scan(self, now: Time, light: ScanLight) -> bool:
        """Write into the light of a scan that begins at `now`; returns whether it acted, which is then labelled."""
        ...


class LightSource(Protocol):
    """What alters the light of the scans of one run."""

    def has_hooks(self, vehicle: str, kind: ScannerKind) -> bool:
        """Whether something may ever alter the light of such a sensor."""
        ...

    def alter(self, now: Time, light: ScanLight) -> None:
        """Let everything that acts at `now` write into the light of a scan."""
        ...


@runtime_checkable
class ScanMaker(Protocol):
    """A truth subscriber that makes scans. A kernel takes one with a method `attach_light` for one."""

    def attach_light(self, light: LightSource) -> None:
        """Have `light` alter the light of all scans from now on."""
        ...
