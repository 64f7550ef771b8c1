"""The missions that both autopilots fly: one aircraft each, 200 m apart, and a ground station that falls silent."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from skyrange.contracts.frames import Frame
from skyrange.contracts.links import TapPlacement
from skyrange.contracts.verdicts import Drop, Verdict
from skyrange.core.time import Time, from_seconds
from skyrange.parity.flights import Parity, compare, compare_rates
from skyrange.scenario.model.scenario import Scenario

FILES = Path(__file__).parent / "missions"
SILENT_S = 26.0
"""From then on the aircraft `lost` and its ground station hear nothing of each other."""
DEPART_S = 10.0
DURATION_S = 100.0
WINDS: dict[float, tuple[str, ...]] = {0.0: ("climb", "square", "fast", "speed", "yaw", "rtl", "guided", "lost")}
WINDS[8.0] = ("square", "fast", "rtl", "guided")
"""Which missions are flown in which wind, m/s."""
PLANS: dict[str, dict[str, Any]] = {
    "climb": {"plan": {"path": {"points": [[0, 0, 25]]}, "end": "land"}},
    "square": {"plan": {"square": {"side_m": 20, "alt_m": 12}}},
    "fast": {"plan": {"path": {"points": [[0, 0], [50, 0], [50, 40], [5, 5]], "alt_m": 12}, "speed_mps": 10}},
    "speed": {"plan": {"file": str(FILES / "speed.waypoints"), "anchor": "start"}},
    "yaw": {"plan": {"file": str(FILES / "yaw.waypoints"), "anchor": "start"}},
    "rtl": {"plan": {"path": {"points": [[0, 0, 10], [0, 40, 10]]}, "speed_mps": 8}},
    "guided": {
        "plan": {
            "path": {"points": [[0, 0, 10], [20, 0, 10], [20, 20, 14], [0, 0, 10]]},
            "mode": "guided",
            "end": "land",
        }
    },
    "lost": {
        "plan": {"path": {"points": [[0, 0], [0, 60], [60, 60]], "alt_m": 10}, "end": "land"},
        "params": {"FS_GCS_ENABLE": 1},
    },
}
"""By the aircraft's name. False GNSS is compared elsewhere, over many settings."""
WATCHED = "square"
"""Its operator asks for all streams, the others' for the light load."""


@dataclass
class Silence:
    """Drops everything from `SILENT_S` on."""

    link: str

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        return [Drop()] if now >= from_seconds(SILENT_S) else []

    def next_wakeup(self) -> Time | None:
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        return ()


TAPS = (TapPlacement("gcs:blue/lost", "companion", Silence), TapPlacement("gcs:blue/lost", "gcs", Silence))


def scenario(wind_mps: float, names: Sequence[str] = tuple(PLANS)) -> Scenario:
    """The missions of `names`, in a wind from the north-west, near sea level, with ideal sensors.

    ArduCopter makes up for thin air, which the world's motors do not feel; and at sea level itself it says each second
    that it has set its field elevation (`AP_Baro::update_field_elevation`).
    """
    operators = [
        {
            "id": owner,
            "streams": streams,
            "vehicles": [
                {"id": name, "start": [200.0 * place, 0.0, 20.0], "depart_s": DEPART_S, **PLANS[name]}
                for place, name in enumerate(names)
                if (name == WATCHED) is (streams == "operator")
            ],
        }
        for owner, streams in (("blue", "light"), ("green", "operator"))
    ]
    data: dict[str, Any] = {
        "name": "parity",
        "duration_s": DURATION_S,
        "origin": {"lat": -35.363328, "lon": 149.1652241, "alt_msl_m": 10.0},
        "wind": {"speed_mps": wind_mps, "from_deg": 315.0},
        "sensors": {"noise": 0.0},
        "operators": [operator for operator in operators if operator["vehicles"]],
    }
    return Scenario(**data)


def flown(wind_mps: float, folder: Path, names: Sequence[str] = tuple(PLANS)) -> Parity:
    """The missions under both autopilots."""
    return compare(scenario(wind_mps, names), folder, taps=TAPS if "lost" in names else ())


def flown_at(rates: str, wind_mps: float, folder: Path, names: Sequence[str] = tuple(PLANS)) -> Parity:
    """The missions under ArduPilot, at its own rates and at these."""
    return compare_rates(scenario(wind_mps, names), folder, rates, taps=TAPS if "lost" in names else ())
