"""Parameters of control links over Wi-Fi and over a cellular network."""

from __future__ import annotations

from typing import Annotated, Self

from pydantic import Field, Strict, model_validator

from skyrange.contracts.params import Enu, Number, Params, Whole, refuse
from skyrange.core.errors import Problem

Switch = Annotated[bool, Strict()]


class WifiParams(Params):
    """A control link over 802.11g at 2.4 GHz: the ground station has an access point, the aircraft is its client."""

    place: Enu | None = Field(
        default=None,
        description="Position of the access point's antenna, [east_m, north_m, up_m] in metres from the origin; "
        "default: 2 m above the operator's station, or above the start of its first aircraft.",
    )
    channel: Whole = Field(default=1, ge=1, le=13, description="Wi-Fi channel; Remote ID uses channel 6.")
    power_dbm: Number = Field(
        default=18.0,
        ge=-60,
        le=60,
        description="Power of the access point into its antenna, a dipole, in dBm.",
    )
    aircraft_dbm: Number = Field(
        default=18.0, ge=-60, le=60, description="Power of the aircraft's radio into its antenna, in dBm."
    )
    noise_figure_db: Number = Field(default=7.0, ge=0, le=40, description="Noise figure of both receivers in dB.")
    protected: Switch = Field(
        default=False,
        description="Whether both ends protect management frames (802.11w), so that they ignore forged ones.",
    )
    encrypted: Switch = Field(
        default=True,
        description="Whether data frames are encrypted, such as by WPA2: a radio that is no end of the link needs its "
        "key to read them, and to have its own accepted. Wi-Fi modules for telemetry have WPA2 on, with a password "
        "that is the same for all until the operator changes it.",
    )
    reassociation_ms: Number = Field(
        default=400.0,
        ge=0,
        le=60_000,
        description="Time from the loss of an association to the next one, in milliseconds.",
    )
    queue_bytes: Whole = Field(
        default=65_536,
        ge=1,
        le=2**31,
        description="Size of each radio's queue in bytes; a frame that does not fit is lost.",
    )
    latency_ms: Number = Field(
        default=1.0, ge=0.001, le=600_000, description="Delay of both computers beside the air, in milliseconds."
    )


class BaseStation(Params):
    """A cell of a cellular network with an antenna that radiates alike in all directions."""

    id: str = Field(min_length=1, max_length=32, description="Name, unique in the network.")
    place: Enu = Field(description="Position of its antenna, [east_m, north_m, up_m] in metres from the origin.")
    power_dbm: Number = Field(default=46.0, ge=-60, le=80, description="Radiated power in its bandwidth, in dBm.")
    load: Number = Field(
        default=0.5, ge=0, le=1, description="Share of its resources in use, at which it disturbs other cells."
    )


class CellularParams(Params):
    """A control link over LTE: the aircraft is a terminal, and the station is behind the network."""

    base_stations: tuple[BaseStation, ...] = Field(min_length=1, max_length=1000, description="The cells.")
    frequency_mhz: Number = Field(default=1800.0, ge=400, le=6000, description="Carrier frequency in MHz.")
    bandwidth_mhz: Number = Field(default=10.0, ge=1.4, le=100, description="Bandwidth of a cell in MHz.")
    share: Number = Field(
        default=0.05, gt=0, le=1, description="Share of a cell's resources that one aircraft gets, in each direction."
    )
    aircraft_dbm: Number = Field(
        default=23.0,
        ge=-60,
        le=60,
        description="Power of the aircraft's radio in dBm; 23: class 3 (TS 36.101).",
    )
    noise_figure_db: Number = Field(default=9.0, ge=0, le=40, description="Noise figure of the aircraft's radio in dB.")
    station_noise_figure_db: Number = Field(
        default=5.0, ge=0, le=40, description="Noise figure of the base stations in dB."
    )
    noise_rise_db: Number = Field(
        default=3.0, ge=0, le=60, description="Interference of other terminals at a base station, above noise, in dB."
    )
    a3_offset_db: Number = Field(
        default=0.0, ge=-15, le=15, description="Offset of the event A3 in dB (TS 36.331, 5.5.4.4)."
    )
    hysteresis_db: Number = Field(default=3.0, ge=0, le=15, description="Hysteresis of the event A3 in dB.")
    time_to_trigger_ms: Whole = Field(
        default=256, ge=0, le=5120, description="Time for which the event must hold, in milliseconds."
    )
    interruption_ms: Number = Field(
        default=50.0, ge=0, le=60_000, description="Interruption by a hand-over, in milliseconds."
    )
    reestablishment_ms: Number = Field(
        default=200.0,
        ge=0,
        le=60_000,
        description="Time from the return of a usable cell after a radio link failure to the next frame, in "
        "milliseconds.",
    )
    queue_bytes: Whole = Field(
        default=65_536,
        ge=1,
        le=2**31,
        description="Size of each radio's queue in bytes; a frame that does not fit is lost.",
    )
    latency_ms: Number = Field(
        default=20.0,
        ge=0.001,
        le=600_000,
        description="Delay of scheduling, core network and Internet beside the air, in milliseconds.",
    )

    @model_validator(mode="after")
    def _names_differ(self) -> Self:
        names = [station.id for station in self.base_stations]
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise refuse(Problem("base_stations", repeated[0], "ids that differ"))
        return self
