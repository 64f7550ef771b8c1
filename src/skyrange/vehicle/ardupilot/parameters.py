"""Start parameters of an ArduPilot process, under the names that its firmware uses, and the list of what it has.

A scenario may use the names and units of ArduCopter 4.6 or 4.7. ArduPilot ignores an unknown name silently, so every
name is looked up in the list from the binary itself before anything starts.

Parameter list of a firmware, with its values: the firmware is started, asked for its list, and ended.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from skyrange.codec.mavlink import Deframer, Packer, decode, dialect
from skyrange.core.errors import ComponentError, InputError, Problem, nearest
from skyrange.core.time import NS_PER_S
from skyrange.io.ardupilot.sitl import LockstepSitl, wall_s
from skyrange.vehicle.ardupilot.json_backend.json_lines import format_lines
from skyrange.vehicle.ardupilot.json_backend.motion import STANDING, step_time_s
from skyrange.vehicle.builtin.parameters.renames import (
    RENAMED,
    STREAM_PARAMETERS,
    canonical_name,
    from_canonical,
    to_canonical,
)
from skyrange.vehicle.builtin.parameters.table import AIRFRAME_TUNING, hover_throttle
from skyrange.vehicle.contract import VehicleSpec
from skyrange.world.airframes import Airframe

LOOP_RATE: Final = "SCHED_LOOP_RATE"
SIM_RATE: Final = "SIM_RATE_HZ"
INS_CHECK: Final = 1 << 4
"""The bit of ARMING_CHECK for the checks of gyros and accelerometers (AP_Arming.h, `Check::INS`)."""
RATES: Final[Mapping[str, Mapping[str, float]]] = {
    "full": {},
    "single": {"ARMING_SKIPCHK": float(INS_CHECK)},
    "reduced": {LOOP_RATE: 100.0, SIM_RATE: 200.0},
}
"""ArduCopter's own rates, a loop at 400 Hz with two exchanges per iteration; and two trade-offs: one exchange per
iteration, which requires that no gyro check runs before arming, or a slower loop."""
RANGE_PARAMETERS: Final = {
    "FRAME_CLASS": 1.0,
    "FRAME_TYPE": 1.0,  # X, as the airframes' rotors are numbered
    # sensor errors come from the range; those of ArduPilot's simulation are switched off
    "SIM_BARO_RND": 0.0,
    "SIM_DRIFT_SPEED": 0.0,
    "INS_ACCOFFS_X": 0.001,  # 0 would count as not calibrated; the simulation adds the same offset
    "INS_ACCOFFS_Y": 0.001,
    "INS_ACCOFFS_Z": 0.001,
    "INS_ACCSCAL_X": 1.001,
    "INS_ACCSCAL_Y": 1.001,
    "INS_ACCSCAL_Z": 1.001,
    "INS_ACC2OFFS_X": 0.001,
    "INS_ACC2OFFS_Y": 0.001,
    "INS_ACC2OFFS_Z": 0.001,
    "INS_ACC2SCAL_X": 1.001,
    "INS_ACC2SCAL_Y": 1.001,
    "INS_ACC2SCAL_Z": 1.001,
    **{
        f"COMPASS_OFS{number}_{axis}": value
        for number in ("", "2", "3")
        for axis, value in zip("XYZ", (5.0, 13.0, -18.0), strict=True)
    },
    "BATT_MONITOR": 4.0,
    "FS_THR_ENABLE": 0.0,  # there is no radio control; the simulation's own sticks are at rest
    "LOG_BACKEND_TYPE": 0.0,
    "GPS1_TYPE": 14.0,
    "MAV2_OPTIONS": 2.0,
    "DID_MAVPORT": 0.0,  # with DID_ENABLE 1: its transmitter is the companion, on the link `autopilot`
}
"""Settings that make ArduPilot's simulation use the range: frame, calibration of its simulated sensors, GNSS by
GPS_INPUT on a private port. The calibration values are those of its own Tools/autotest/default_params/copter.parm."""
NATIVE_PARAMETERS: Final = {
    "MOT_THST_HOVER": 0.39,
    "MOT_THST_EXPO": 0.65,
    "MOT_BAT_VOLT_MIN": 9.6,
    "MOT_BAT_VOLT_MAX": 12.8,
    "ATC_RAT_YAW_P": 0.3,
    "ATC_RAT_YAW_I": 0.02,
    "SIM_TERRAIN": 0.0,  # the ground is as high everywhere as at home
}
"""Settings for ArduPilot's own quadcopter, also from copter.parm."""
RESERVED_PARAMETERS: Final = frozenset(
    ("GPS1_TYPE", "MAV2_OPTIONS", "GPS1_DELAY_MS", "MAV_SYSID", "SYSID_THISMAV", "SERIAL0_PROTOCOL", "SERIAL1_PROTOCOL")
)
"""Parameters that a scenario must not set, because the range depends on them."""
PRIVATE_OPTIONS: Final = 3.0
"""MAVn_OPTIONS of a private channel beside a signed one: neither signed nor forwarded (GCS.h `Option`)."""
_OLD: Final = {"GPS1_TYPE": "GPS_TYPE", "GPS1_DELAY_MS": "GPS_DELAY_MS"}


def resolve_parameter(name: str, value: float, listed: Mapping[str, float]) -> tuple[str, float] | None:
    """Name and value as the firmware that lists `listed` has them; `None` if it has no such parameter."""
    upper = name.upper()
    if upper in listed:
        return upper, value
    known = canonical_name(upper)
    plain = to_canonical(upper, value)
    if known in listed:
        return known, plain
    for other, (old, _) in RENAMED.items():
        if old == known and other in listed:
            return other, from_canonical(other, plain)
    return None


def start_values(
    who: str,
    airframe: Airframe,
    given: Mapping[str, float],
    listed: Mapping[str, float],
    gnss_lag_ms: int,
    rates: str = "full",
) -> dict[str, float]:
    """What the file of defaults says. Raises `InputError` with every name and value of `given` that is wrong."""
    airframe_values = {"MOT_THST_HOVER": hover_throttle(airframe), "MOT_THST_EXPO": airframe.thrust_expo}
    return _values(
        who, {**AIRFRAME_TUNING.get(airframe.name, {}), **airframe_values, **RATES[rates]}, given, listed, gnss_lag_ms
    )


def native_values(
    spec: VehicleSpec, listed: Mapping[str, float], gnss_lag_ms: int, rates: str = "full"
) -> dict[str, float]:
    """The same for ArduPilot's own quadcopter, in the wind that is known before the run."""
    east_mps, north_mps, up_mps = spec.wind_enu_mps
    level_mps = math.hypot(east_mps, north_mps)
    wind = {
        "SIM_WIND_SPD": math.hypot(level_mps, up_mps),
        "SIM_WIND_DIR": math.degrees(math.atan2(-east_mps, -north_mps)) % 360.0,  # where it comes from
        "SIM_WIND_DIR_Z": math.degrees(math.atan2(up_mps, level_mps)),
        "SIM_WIND_T": 1.0,  # the same at all heights
    }
    return _values(spec.vehicle, {**NATIVE_PARAMETERS, **wind, **RATES[rates]}, spec.params, listed, gnss_lag_ms)


def _values(
    who: str,
    airframe_values: Mapping[str, float],
    given: Mapping[str, float],
    listed: Mapping[str, float],
    gnss_lag_ms: int,
) -> dict[str, float]:
    values: dict[str, float] = {}
    wanted = {**RANGE_PARAMETERS, "GPS1_DELAY_MS": float(max(gnss_lag_ms, 1)), **airframe_values}
    for name, value in wanted.items():
        resolved = resolve_parameter(name, value, listed) or resolve_parameter(_OLD.get(name, name), value, listed)
        if resolved is not None:  # versions differ in what they simulate
            values[resolved[0]] = resolved[1]
    problems = []
    for name, value in given.items():
        resolved = resolve_parameter(name, value, listed)
        if resolved is None:
            problems.append(Problem(name, f"{value:g}", "a parameter that this firmware lists", nearest(name, listed)))
        elif resolved[0] in RESERVED_PARAMETERS:
            problems.append(Problem(name, f"{value:g}", "a parameter that the range does not set itself"))
        elif not math.isfinite(value):
            problems.append(Problem(name, f"{value}", "a finite number"))
        else:
            values[resolved[0]] = resolved[1]
    if problems:
        raise InputError(f"params of {who}", problems)
    return values


def swap_serial_ports(values: Mapping[str, float], listed: Mapping[str, float]) -> dict[str, float]:
    """The parameters with serial ports 0 and 1 swapped, with their stream rates, as MAVLink with keys requires.

    ArduPilot accepts unsigned frames on its first channel (GCS_Signing.cpp `accept_unsigned_callback`), as if it were
    USB. So the private port is the first channel then, and the link `autopilot` the second.
    """
    swapped = {
        "MAV1_OPTIONS": PRIVATE_OPTIONS,
        "MAV2_OPTIONS": values.get("MAV1_OPTIONS", 0.0),
        "DID_MAVPORT": {0.0: 1.0, 1.0: 0.0}.get(values.get("DID_MAVPORT", 0.0), values.get("DID_MAVPORT", 0.0)),
    }
    for first, second in (("MAV1", "MAV2"), ("SR0", "SR1")):  # 4.7 and 4.6
        for stream in STREAM_PARAMETERS:
            first_name, second_name = f"{first}_{stream}", f"{second}_{stream}"
            if first_name in values or second_name in values:
                swapped |= {first_name: values.get(second_name, 0.0), second_name: values.get(first_name, 0.0)}
    return {**values, **{name: value for name, value in swapped.items() if name in listed}}


def defaults_text(values: Mapping[str, float]) -> str:
    """The text of a file of defaults."""
    return "".join(f"{name} {value:.9g}\n" for name, value in sorted(values.items()))


def exchange_steps(values: Mapping[str, float], listed: Mapping[str, float], quantum_s: float) -> tuple[int, int]:
    """Division of time into exchanges: (exchanges per tick, ticks per exchange), one of them 1.

    ArduPilot reads its gyros once per exchange, and waits for them in each iteration of its loop. It arms only if they
    are read 1.8 times as often (AP_Arming.cpp, `ins_checks`), unless its arming checks leave them out. SIM_RATE_HZ may
    request more.
    """
    loop_hz = values.get(LOOP_RATE, listed.get(LOOP_RATE, 400.0))
    least_hz = max((1.8 if _checks_gyros(values, listed) else 1.0) * loop_hz, values.get(SIM_RATE, 0.0))
    per_tick = least_hz * quantum_s
    if per_tick > 0.5 + 1e-9:
        return max(1, math.ceil(per_tick - 1e-9)), 1
    return 1, max(1, math.floor(1.0 / per_tick + 1e-9))


def _checks_gyros(values: Mapping[str, float], listed: Mapping[str, float]) -> bool:
    for name in ("ARMING_CHECK", "ARMING_SKIPCHK"):
        if name in values or name in listed:
            value = values[name] if name in values else listed[name]
            return bool(int(to_canonical(name, value)) & (1 | INS_CHECK))  # 1 stands for all of them
    return True


def moments_per_iteration(values: Mapping[str, float], listed: Mapping[str, float], quantum_s: float) -> int:
    """Ticks with exchanges per iteration of ArduPilot's main loop; 1 if that is not an integer."""
    _, ticks = exchange_steps(values, listed, quantum_s)
    moments = 1.0 / (values.get(LOOP_RATE, listed.get(LOOP_RATE, 400.0)) * quantum_s * ticks)
    whole = round(moments)
    return whole if whole >= 1 and math.isclose(moments, whole, rel_tol=1e-9) else 1


def changed_by_firmware(
    given: Mapping[str, float], listed: Mapping[str, float], reported: Mapping[str, float]
) -> Iterator[Problem]:
    """The parameters in `given` that the firmware, which then reported the values `reported`, did not accept unchanged.

    The firmware reports no error: it truncates a fraction given for an integer, and replaces a number beyond its
    type's range by the largest one (AP_Param.cpp, `set_value`).
    """
    for name, value in given.items():
        resolved = resolve_parameter(name, value, listed)
        if resolved is not None and resolved[0] in reported:
            kept = reported[resolved[0]]
            if not math.isclose(kept, resolved[1], rel_tol=1e-6, abs_tol=1e-9):
                yield Problem(
                    name, f"{value:g}", f"a value that this firmware accepts; it changed this one to {kept:g}"
                )


STEP_NS: Final = 2_500_000
MAX_S: Final = 30.0
"""Simulated seconds within which the list has to be complete; it takes two to four."""
READY_NS: Final = 5 * NS_PER_S
"""It has booted by then; a list that is requested earlier arrives slowly."""
WALL_S: Final = 20.0
_STATION: Final = 255


@lru_cache(maxsize=64)
def list_parameters(binary: Path, sha256: str, text: str = "") -> Mapping[str, float]:
    """Every parameter of a firmware with its value, given the file of defaults `text`; `sha256` identifies the binary.

    Raises `ComponentError` if it does not answer.
    """
    with TemporaryDirectory(prefix="skyrange-") as folder:
        sitl = LockstepSitl(
            f"arducopter {binary.name}", binary, Path(folder), home=(0.0, 1.0, 0.0, 0.0), system_id=1, start_unix_s=1,
            parameters=text + "LOG_BACKEND_TYPE 0\n", options=("--unhide-groups",),
        )  # fmt: skip
        try:
            return _request_list(sitl)
        finally:
            sitl.close()


def _request_list(sitl: LockstepSitl) -> Mapping[str, float]:
    packer, deframer = Packer(_STATION, dialect.MAV_COMP_ID_MISSIONPLANNER), Deframer()
    values: dict[str, float] = {}
    total, requested = -1, False
    deadline = wall_s() + WALL_S
    for step in range(1, round(MAX_S * NS_PER_S / STEP_NS)):
        if sitl.servos(deadline) is None:
            raise sitl.lost("did not answer when asked for its parameters")
        sitl.accept()
        if sitl.connected and not requested and step * STEP_NS >= READY_NS:
            requested = sitl.write(0, packer.pack(dialect.MAVLink_param_request_list_message(1, 1)))
        for piece in deframer.feed(sitl.read(0)):
            if not piece.garbage:
                message = decode(piece.data)
                if message.get_type() == "PARAM_VALUE":
                    values[message.param_id] = float(message.param_value)
                    total = message.param_count
        if total > 0 and len(values) >= total:
            return values
        sitl.send(format_lines([step_time_s(step, STEP_NS)], STANDING)[0])
    raise ComponentError(sitl.name, f"sent {len(values)} of {total} parameters in {MAX_S:g} simulated seconds")
