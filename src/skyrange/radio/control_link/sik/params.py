"""Parameters of control links over SiK telemetry radios."""

from __future__ import annotations

from typing import Final, Self

from pydantic import Field, model_validator

from skyrange.contracts.params import Enu, Number, Params, Whole, refuse
from skyrange.core.errors import Problem
from skyrange.radio.control_link.params import Switch
from skyrange.radio.control_link.sik.modem import AIR_SPEEDS_KBPS
from skyrange.radio.control_link.sik.timing import (
    MAX_CHANNELS,
    MAX_SPACING_HZ,
    MAX_WINDOW_MS,
    SPACING_STEP_HZ,
    compute_timing,
    spacing_hz,
)

BOARDS_KHZ: Final = ((414_000, 460_000), (450_000, 490_000), (849_000, 889_000), (868_000, 935_000))
"""Frequencies of the boards for 433, 470, 868 and 915 MHz (SiK at 50189f2, `Firmware/radio/main.c: radio_init`)."""
SERIAL_SPEEDS: Final = (1_200, 2_400, 4_800, 9_600, 19_200, 38_400, 57_600, 115_200, 230_400)
"""`Firmware/radio/serial.c: serial_rates`."""


class SikParams(Params):
    """A control link over a pair of SiK telemetry radios, one at the station and one in the aircraft. The defaults are
    those of the firmware for boards for 915 MHz. Both radios have the same parameters but for their power.
    """

    place: Enu | None = Field(
        default=None,
        description="Position of the antenna of the ground radio, [east_m, north_m, up_m] in metres from the origin; "
        "default: 2 m above the operator's station, or above the start of its first aircraft.",
    )
    air_speed_kbps: Whole = Field(
        default=64,
        description="Air data rate (AIR_SPEED) in kbit/s, one of 4, 8, 16, 19, 24, 32, 48, 64, 96, 128, 192 and 250. "
        "The firmware also has 2, at which no data fit into its longest window.",
    )
    ecc: Switch = Field(
        default=False,
        description="Whether the radios correct errors by a Golay code (ECC): three wrong bits in each 23, for half "
        "of the throughput.",
    )
    mavlink: Switch = Field(
        default=True,
        description="Whether the radios send whole MAVLink frames in a packet, and report their state to their "
        "computers by RADIO_STATUS at each HEARTBEAT from there (MAVLINK = 1).",
    )
    netid: Whole = Field(
        default=25,
        ge=0,
        le=65_535,
        description="Network id (NETID) of the first aircraft of the rule; each further one has the next number. It "
        "determines frequencies and their order.",
    )
    power_dbm: Whole = Field(
        default=20,
        ge=0,
        le=30,
        description="Power of the ground radio into its antenna, a dipole, in dBm (TXPOWER); HM-TRP boards have up "
        "to 20.",
    )
    aircraft_dbm: Whole = Field(
        default=20, ge=0, le=30, description="Power of the aircraft's radio into its antenna, in dBm (TXPOWER)."
    )
    min_khz: Whole = Field(default=915_000, ge=414_000, le=935_000, description="Lowest frequency (MIN_FREQ) in kHz.")
    max_khz: Whole = Field(default=928_000, ge=414_000, le=935_000, description="Highest frequency (MAX_FREQ) in kHz.")
    channels: Whole = Field(
        default=50,
        ge=1,
        le=MAX_CHANNELS,
        description="Frequencies between which the radios hop (NUM_CHANNELS); boards for 433, 470 and 868 MHz have 10 "
        "by default.",
    )
    max_window_ms: Whole = Field(
        default=MAX_WINDOW_MS,
        ge=1,
        le=MAX_WINDOW_MS,
        description="Longest time for which one radio sends (MAX_WINDOW), in milliseconds.",
    )
    duty_percent: Whole = Field(
        default=100,
        ge=1,
        le=100,
        description="Largest share of time in which a radio sends, on average over about 20 rounds (DUTY_CYCLE), in "
        "percent.",
    )
    serial_bps: Whole = Field(
        default=57_600,
        description="Speed of the serial lines between radios and computers (SERIAL_SPEED) in bits per second, one of "
        "1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200 and 230400.",
    )
    noise_rise_db: Number = Field(
        default=0.0, ge=0, le=60, description="Noise of the aircraft's electronics at its radio, above thermal, in dB."
    )
    station_noise_rise_db: Number = Field(
        default=0.0, ge=0, le=60, description="The same at the ground radio, such as of a computer's USB."
    )
    queue_bytes: Whole = Field(
        default=4096,
        ge=1,
        le=2**20,
        description="Size of each computer's queue before its serial line, in bytes; a frame that does not fit is "
        "lost. 4096 is Linux's (UART_XMIT_SIZE). The buffer of a radio has 1850 bytes.",
    )
    latency_ms: Number = Field(
        default=1.0, ge=0.001, le=600_000, description="Delay of both computers beside lines and air, in milliseconds."
    )

    @model_validator(mode="after")
    def _supported(self) -> Self:
        if self.air_speed_kbps not in AIR_SPEEDS_KBPS:
            raise refuse(Problem("air_speed_kbps", str(self.air_speed_kbps), f"one of {_list(AIR_SPEEDS_KBPS[1:])}"))
        if self.serial_bps not in SERIAL_SPEEDS:
            raise refuse(Problem("serial_bps", str(self.serial_bps), f"one of {_list(SERIAL_SPEEDS)}"))
        timing = compute_timing(
            self.air_speed_kbps, ecc=self.ecc, max_window_ms=self.max_window_ms, channels=self.channels
        )
        if timing.room(timing.window_ns) < 1:
            hint = "The firmware sends no data in a window with room for fewer than 18 bytes."
            if self.max_window_ms < MAX_WINDOW_MS:
                hint += " Choose a longer max_window_ms too, if need be."
            value = f"{self.air_speed_kbps} with windows of {self.max_window_ms} ms"
            raise refuse(Problem("air_speed_kbps", value, "a rate at which data fit into a window", hint))
        return self

    @model_validator(mode="after")
    def _frequencies_of_a_board(self) -> Self:
        band = f"{self.min_khz} to {self.max_khz}"
        if not any(low <= self.min_khz < self.max_khz <= high for low, high in BOARDS_KHZ):
            expected = "a band within " + ", ".join(f"{low} to {high}" for low, high in BOARDS_KHZ) + " kHz"
            raise refuse(Problem("min_khz", band, expected))
        spacing = spacing_hz(self.min_khz, self.max_khz, self.channels)
        if not SPACING_STEP_HZ // 2 <= spacing <= MAX_SPACING_HZ:
            expected = f"as many that their distance, {spacing} Hz, is from {SPACING_STEP_HZ // 2} to {MAX_SPACING_HZ}"
            raise refuse(Problem("channels", f"{self.channels} in {band} kHz", expected))
        return self

    @property
    def centre_mhz(self) -> float:
        """Middle of the band."""
        return 0.5e-3 * (self.min_khz + self.max_khz)


def _list(numbers: tuple[int, ...]) -> str:
    return ", ".join(map(str, numbers[:-1])) + f" and {numbers[-1]}"
