"""Parameter list of a firmware, with its values: the firmware is started, asked for its list, and ended."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

from skyrange.codec.mavlink import Deframer, Packer, decode, dialect
from skyrange.core.errors import ComponentError
from skyrange.core.time import NS_PER_S
from skyrange.io.ardupilot.sitl import LockstepSitl, wall_s
from skyrange.vehicle.ardupilot.json_backend.json_lines import format_lines
from skyrange.vehicle.ardupilot.json_backend.motion import STANDING, step_time_s

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
    found: dict[str, float] = {}
    total, asked = -1, False
    deadline = wall_s() + WALL_S
    for step in range(1, round(MAX_S * NS_PER_S / STEP_NS)):
        if sitl.servos(deadline) is None:
            raise sitl.lost("did not answer when asked for its parameters")
        sitl.accept()
        if sitl.connected and not asked and step * STEP_NS >= READY_NS:
            asked = sitl.write(0, packer.pack(dialect.MAVLink_param_request_list_message(1, 1)))
        for piece in deframer.feed(sitl.read(0)):
            if not piece.garbage:
                message = decode(piece.data)
                if message.get_type() == "PARAM_VALUE":
                    found[message.param_id] = float(message.param_value)
                    total = message.param_count
        if total > 0 and len(found) >= total:
            return found
        sitl.send(format_lines([step_time_s(step, STEP_NS)], STANDING)[0])
    raise ComponentError(sitl.name, f"sent {len(found)} of {total} parameters in {MAX_S:g} simulated seconds")
