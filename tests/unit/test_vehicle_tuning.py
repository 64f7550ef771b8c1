"""Equal parameters are kept once, changed ones act within 100 ms, and in their own aircraft only."""

from __future__ import annotations

import numpy as np

from skyrange.core.time import NS_PER_MS
from skyrange.vehicle.builtin.control.gains import UPDATE_NS, GainSets
from skyrange.vehicle.builtin.parameters.table import SETTINGS, fill_settings
from skyrange.world.airframes import AIRFRAMES

DT = 0.0025
FRAMES = ["iris", "x500", "iris", "iris"]


def fleet() -> tuple[np.ndarray, GainSets]:
    settings = np.zeros(len(FRAMES), dtype=SETTINGS)
    for row, name in enumerate(FRAMES):
        fill_settings(settings, row, f"v{row}", AIRFRAMES[name], row + 1, {})
    tuning = GainSets(FRAMES, settings)
    tuning.update(0, DT)
    return settings, tuning


def test_each_row_finds_its_own_parameters() -> None:
    settings, tuning = fleet()
    assert len(tuning.parameter_sets) == len(tuning.gains) == 2
    assert (tuning.parameter_sets[tuning.set_index] == settings).all()
    assert tuning.set_index[0] == tuning.set_index[2] == tuning.set_index[3] != tuning.set_index[1]
    for row in range(len(FRAMES)):
        assert tuning.gains["throttle_hover"][tuning.set_index[row]] == settings["MOT_THST_HOVER"][row]


def test_a_change_is_taken_up_at_the_next_tenth_of_a_second() -> None:
    settings, tuning = fleet()
    settings["ATC_ANG_RLL_P"][2] = 6.0
    tuning.update(UPDATE_NS - NS_PER_MS, DT)
    assert len(tuning.parameter_sets) == 2
    tuning.update(UPDATE_NS, DT)
    assert tuning.gains["angle_p"][tuning.set_index, 0].tolist() == [4.5, 4.5, 6.0, 4.5]
    assert (tuning.parameter_sets[tuning.set_index] == settings).all()
    settings["ATC_ANG_RLL_P"][2] = 4.5
    tuning.update(2 * UPDATE_NS, DT)
    assert len(tuning.parameter_sets) == 2


def test_gains_follow_the_step() -> None:
    _, tuning = fleet()
    before = tuning.gains["rate_i"][0, 0]
    tuning.update(NS_PER_MS, 2 * DT)
    assert tuning.gains["rate_i"][0, 0] == 2 * before
