"""Reference of the builtin autopilot: its modes, commands, messages and parameters, airframes, Remote ID, avoidance."""

from __future__ import annotations

import re
from pathlib import Path

from tools.docs.markdown_tables import table


def message_name(number: int) -> str:
    """The name of a MAVLink message."""
    from skyrange.codec.mavlink import dialect

    return str(dialect.mavlink_map[number].msgname)


def _command(number: int) -> str:
    from skyrange.codec.mavlink import dialect

    return str(dialect.enums["MAV_CMD"][number].name)


def modes() -> str:
    """Flight modes, and in which one may arm."""
    from skyrange.vehicle.builtin.modes import Mode, allows_arming

    rows = [
        (
            f"`{m.name}`",
            int(m),
            "yes" if allows_arming(m, 0) else "with bit 0 of `AUTO_OPTIONS`" if allows_arming(m, 1) else "no",
        )
        for m in Mode
    ]
    return table(("mode", "number", "can be armed in"), rows)


def autopilot_commands() -> str:
    """Commands that are obeyed."""
    from skyrange.vehicle.builtin.commands import HANDLERS

    return "".join(f"- `{_command(number)}` ({number})\n" for number in sorted(HANDLERS))


def mission_items() -> str:
    """Mission items that are flown, and the auxiliary functions that have an effect."""
    from skyrange.vehicle.builtin.mission import command_ids as ids
    from skyrange.vehicle.builtin.modes import Mode

    items = "".join(f"- `{_command(number)}` ({number})\n" for number in sorted(ids.SUPPORTED))
    modes = ", ".join(f"{function} `{Mode(mode).name}`" for function, mode in sorted(ids.MODE_FUNCTIONS.items()))
    return (
        f"{items}\nAuxiliary functions of `DO_AUX_FUNCTION` with an effect are modes in position 2 ({modes}), "
        f"the fence ({ids.FENCE_FUNCTION}), and disarming ({ids.DISARM_FUNCTION}, {ids.ARM_DISARM_FUNCTION}).\n"
    )


def messages() -> str:
    """Messages that can be streamed or asked for, the data stream of each, and the rates of the stations' profiles."""
    from skyrange.gcs.telemetry_streams import PROFILES
    from skyrange.vehicle.builtin.telemetry.schedule import STREAMS
    from skyrange.vehicle.builtin.telemetry.table import BUILDERS

    stream = {number: name for name, numbers in STREAMS.values() for number in numbers}
    rates: dict[str, dict[int, float]] = {}
    for name, profile in PROFILES.items():
        of_streams = {number: float(rate) for one, rate in profile.streams for number in STREAMS[one][1]}
        rates[name] = {**of_streams, **dict(profile.messages)}
    rows = [
        (
            f"`{message_name(number)}`",
            number,
            f"`{stream[number]}`" if number in stream else "",
            *(f"{of_profile[number]:g}" if number in of_profile else "" for of_profile in rates.values()),
        )
        for number in BUILDERS
    ]
    return table(("message", "id", "rate at boot", *(f"Hz in `{name}`" for name in rates)), rows)


def heard() -> str:
    """Messages that the autopilot acts on."""
    from skyrange.vehicle.builtin import engine

    numbers = sorted({*engine._HANDLERS, *engine._COMMANDS})
    others = re.findall(r"MAVLINK_MSG_ID_([A-Z_]+)", Path(engine.__file__).read_text().split("def _receive", 1)[1])
    names = sorted({message_name(number) for number in numbers} | set(others))
    return "".join(f"- `{name}`\n" for name in names)


def parameters() -> str:
    """Parameters with range, default and meaning."""
    from skyrange.vehicle.builtin.parameters.table import PARAMETERS

    rows = [(f"`{p.name}`", f"{p.default:g}", f"{p.low:g} to {p.high:g}", p.meaning) for p in PARAMETERS]
    return table(("parameter", "default", "range", "meaning and unit"), rows)


def renamed() -> str:
    """Parameters' names of ArduCopter 4.7."""
    from skyrange.vehicle.builtin.parameters.renames import RENAMED
    from skyrange.vehicle.builtin.parameters.table import INDEX

    rows = [
        (f"`{new}`", f"`{old}`", "inverse" if factor == 0.0 else f"{factor:g}")
        for new, (old, factor) in sorted(RENAMED.items())
        if old in INDEX
    ]
    return table(("name in 4.7", "name in 4.6", "times"), rows)


def tuning() -> str:
    """What an airframe changes of the defaults."""
    from skyrange.vehicle.builtin.parameters.table import AIRFRAME_TUNING

    rows = [
        (airframe, f"`{name}`", f"{value:g}")
        for airframe, values in AIRFRAME_TUNING.items()
        for name, value in values.items()
    ]
    return table(("airframe", "parameter", "value"), rows)


def airframes() -> str:
    """The airframe table."""
    from dataclasses import fields

    from skyrange.world.airframes import AIRFRAMES

    names = [f.name for f in fields(next(iter(AIRFRAMES.values()))) if f.name not in ("name", "rotors")]
    rows = [(f"`{name}`", *(_number(getattr(a, name)) for a in AIRFRAMES.values())) for name in names]
    rows.append(("rotors", *(str(len(a.rotors)) for a in AIRFRAMES.values())))
    rows.append(("hover thrust, of full", *(f"{a.hover_thrust:.3f}" for a in AIRFRAMES.values())))
    return table(("", *AIRFRAMES), rows)


def _number(value: object) -> str:
    return ", ".join(f"{part:g}" for part in value) if isinstance(value, tuple) else f"{value:g}"


def part89() -> str:
    """The rule's elements and the fields that carry them."""
    from skyrange.codec.f3411.part89 import MODULE, STANDARD

    return table(("14 CFR", "element", "carried by"), [(e.clause, e.what, e.fields) for e in (*STANDARD, *MODULE)])


def avoidance() -> str:
    """The parameters of every kind of avoidance."""
    from skyrange.vehicle.avoidance.contract import AvoidanceLimits

    rows = [
        (f"`{name}`", f"{field.default:g}", field.description) for name, field in AvoidanceLimits.model_fields.items()
    ]
    return table(("parameter", "default", "meaning"), rows)
