"""What do a lost motor and a gust do to aircraft that fly, and what does the autopilot say of it?"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from skyrange.assembly.build import build
from skyrange.codec.mavlink import decode
from skyrange.core.errors import SkyrangeError
from skyrange.core.time import from_seconds
from skyrange.kernel import Kernel
from skyrange.record.write.memory_observer import MemoryObserver
from skyrange.scenario.toml_files import load_text
from skyrange.study.pairing import pair

pytestmark = pytest.mark.rotating

FLEET = """
name = "one"
seed = 2
duration_s = 26
origin = [47.3977, 8.5456]

[[operators]]
id = "blue"
vehicles = [{ id = "b1", plan = { square = { side_m = 40, alt_m = 30 } } }]

[[faults]]
id = "cause"
start_s = 18
"""


def flown(kind: str, params: str) -> MemoryObserver:
    text = FLEET + f'kind = "{kind}"\nparams = {{ {params} }}\n'
    seen = MemoryObserver()
    kernel = Kernel(build(load_text(text)).wiring, [seen])
    kernel.advance(from_seconds(26))
    kernel.finish()
    return seen


def column(seen: MemoryObserver, name: str, from_s: float = 0.0) -> np.ndarray:
    return np.array([row.columns[name][0] for row in seen.truth if row.time_ns >= from_seconds(from_s)])


def texts(seen: MemoryObserver) -> list[str]:
    found = []
    for frame in seen.frames:
        if frame.link.startswith("gcs:"):
            try:
                message = decode(frame.payload)
            except SkyrangeError:
                continue
            if message.get_type() == "STATUSTEXT":
                found.append(str(message.text))
    return found


def test_a_quadrotor_that_loses_a_motor_spins_tumbles_and_falls() -> None:
    seen = flown("motor.loss", 'vehicles = ["blue/b1"], motor = 2')
    (crash,) = [note.note for note in seen.notes if note.note.kind == "event.crash"]
    speed_mps = crash.data["speed_mps"]
    assert isinstance(speed_mps, float)
    assert speed_mps > 8.0
    before_impact = column(seen, "crashed", 18.0) == 0
    # two rotors turn clockwise against one: the body turns counter-clockwise
    assert column(seen, "rate_z_radps", 18.0)[before_impact].max() > 2.0
    cosines = 1.0 - 2.0 * (column(seen, "qx", 18.0) ** 2 + column(seen, "qy", 18.0) ** 2)
    assert cosines[before_impact].min() < 0.0, "it is on its back at times"
    assert not any("Thrust Loss" in text for text in texts(seen)), "it is not level, so the check does not speak"


def test_an_autopilot_names_the_motor_that_is_weak() -> None:
    seen = flown("motor.loss", 'vehicles = ["blue/b1"], motor = 4, loss = 0.57')
    assert "Potential Thrust Loss (4)" in texts(seen)
    assert column(seen, "vel_up_mps")[-1] < -1.0 or any(note.note.kind == "event.crash" for note in seen.notes)


def test_a_weak_motor_is_flown_through_while_there_is_thrust_to_spare() -> None:
    seen = flown("motor.loss", 'vehicles = ["blue/b1"], motor = 4, loss = 0.3')
    assert not any(note.note.kind == "event.crash" for note in seen.notes)
    assert not any("Thrust Loss" in text for text in texts(seen))


def test_a_gust_carries_an_aircraft_off_and_is_in_the_record_of_the_wind(tmp_path: Path) -> None:
    text = FLEET + 'kind = "gust"\nparams = { speed_mps = 18, from_deg = 270, length_m = 20, travel_mps = 10 }\n'
    made = pair(load_text(text), tmp_path / "pair", jobs=1)
    (row,) = made.effects.to_pylist()
    assert row["departure_m"] > 2.0
    assert (row["attacks"], row["faults"], row["attribution"]) == ([], ["cause"], "both")
    rows = made.propagation.to_pylist()
    assert [(one["kind"], one["link"]) for one in rows if one["phase"] == "onset"] == [("body", "wind:blue/b1")]
    winds = {arm: made.run(arm).table("truth")["wind_east_mps"].to_numpy() for arm in ("attacked", "nominal")}
    assert winds["attacked"].max() == pytest.approx(18.0, rel=0.01)
    assert not winds["nominal"].any()
    assert made.run("attacked").manifest["faults"][0]["touches"] == ["body of blue/b1"]
