"""Is what a defence assumes of sensors, channel and map a value of its own, apart from the world's?"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import shapely

import skyrange.defence as package
from skyrange.city.buildings import Building
from skyrange.city.city import City
from skyrange.core.chance import Chance
from skyrange.core.errors import InputError
from skyrange.defence import data_sheets
from skyrange.defence.bases.signal_strengths import (
    USUAL,
    AssumedChannel,
    StrengthTest,
    free_space_loss_db,
    map_with_errors,
)
from skyrange.defence.contract import DefencePlugin
from skyrange.defence.gnss.innovation import InnovationCheck
from skyrange.radio.propagation import fading
from skyrange.world.sensing import sensor_errors

HOME = Path(package.__file__).parent
CITY = City(
    [Building(f"b{k}", 20.0, shapely.box(40.0 * k, 0.0, 40.0 * k + 20.0, 20.0)) for k in range(100)], "made", None
)


@pytest.mark.parametrize("folder", ["gnss", "remote_id", "bases"])
def test_no_check_imports_the_models_of_errors_and_fading(folder: str) -> None:
    for file in (HOME / folder).glob("*.py"):
        text = file.read_text(encoding="utf-8")
        assert "sensor_errors" not in text, file.name
        assert "radio.propagation" not in text, file.name


def test_by_default_the_assumptions_are_true() -> None:
    """So numbers of the columns that are not called mismatched are those of the best case."""
    assert (data_sheets.WANDER_M, data_sheets.WANDER_UP_M) == (
        sensor_errors.GNSS_WANDER_M,
        sensor_errors.GNSS_WANDER_UP_M,
    )
    assert data_sheets.GYRO_FLIGHT_RADPS == sensor_errors.GYRO_FLOOR_RADPS + sensor_errors.GYRO_MOTORS_RADPS
    assert data_sheets.ACCEL_FLIGHT_MPS2 == sensor_errors.ACCEL_FLOOR_MPS2 + sensor_errors.ACCEL_MOTORS_MPS2
    assert 10.0 ** (0.1 * USUAL.rician_k_db) == pytest.approx(fading.RICIAN_K, rel=1e-3)
    assert USUAL.cell_m == fading.cell_side_m(False)


def test_a_map_with_errors_is_moved_and_lacks_a_share() -> None:
    assert map_with_errors(CITY, (0.0, 0.0), 0.0, Chance(1)) is CITY
    assert map_with_errors(None, (4.0, -3.0), 0.5, Chance(1)) is None
    assert map_with_errors(CITY, (0.0, 0.0), 1.0, Chance(1)) is None
    moved = map_with_errors(CITY, (4.0, -3.0), 0.0, Chance(1))
    assert moved is not None
    assert np.subtract(moved.bounds, CITY.bounds).tolist() == [4.0, -3.0, 4.0, -3.0]
    thinned = [map_with_errors(CITY, (0.0, 0.0), 0.3, Chance(seed)) for seed in (1, 1, 2)]
    ids = [[one.id for one in made.buildings] for made in thinned if made is not None]
    assert ids[0] == ids[1] != ids[2]
    assert 50 < len(ids[0]) < 90


def test_a_test_that_believes_in_less_fading_rejects_honest_senders() -> None:
    """What the stated error rate is worth if the channel is another: sigma 5 dB and K = 12 dB, against 2 dB."""
    rng = np.random.default_rng(5)
    rejected = []
    for channel in (USUAL, AssumedChannel(20.0, 3.0, 2.0)):
        count = 0
        for _ in range(60):
            test, most = StrengthTest((0.0, 36.0), channel), -np.inf
            shadow: dict[int, float] = {}
            for second in range(60):
                here = (0.0, 10.0 * second, 30.0)
                value = shadow.setdefault(int(10.0 * second // USUAL.cell_m), rng.normal() * USUAL.shadowing_db(30.0))
                loss = free_space_loss_db(abs(900.0 - 10.0 * second))
                test.add("b1", here, (0.0, 900.0, 30.0), 20.0 - loss + value + rng.normal() * USUAL.fading_db)
                most = max(most, test.log_evidence)
            count += most >= np.log(1000.0)
        rejected.append(count)
    assert rejected[0] <= 1
    assert rejected[1] >= 10


def test_parameters_reach_the_filter() -> None:
    usual, other = InnovationCheck(), InnovationCheck(gyro_noise_radps=0.01, gyro_bias_radps=0.001)
    assert usual.gyro_walk == pytest.approx((np.radians(0.14) ** 2) * 0.01 + (np.radians(0.004) ** 2) * 60.0)
    assert other.gyro_walk == pytest.approx(0.01**2 * 0.01 + 0.001**2 * 60.0)


@pytest.mark.parametrize("kind", ["remote_id.signal", "remote_id.ground", "remote_id.appearance"])
def test_a_shift_of_a_map_has_two_parts(kind: str) -> None:
    params = DefencePlugin.find(kind).params
    assert params.model_validate({"map_shift_m": [4, -3]}).map_shift_m == (4.0, -3.0)  # type: ignore[attr-defined]
    with pytest.raises((InputError, ValueError), match="map_shift_m"):
        params.model_validate({"map_shift_m": [4]})


def test_the_checks_of_fixes_load_without_the_models() -> None:
    """A module that they import must not bring the models in under another name."""
    code = (
        "import sys, skyrange.defence.gnss.barometer, skyrange.defence.gnss.innovation;"
        "import skyrange.defence.gnss.integrity, skyrange.defence.gnss.multi_receiver, skyrange.defence.gnss.receiver;"
        "print('skyrange.world.sensing.sensor_errors' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
