"""Equal parameters are kept once, changed ones act within 100 ms, and in their own aircraft only."""

from __future__ import annotations

import numpy as np

from skyrange.core.time import NS_PER_MS
from skyrange.vehicle.builtin.parameters import SETTINGS, fill
from skyrange.vehicle.builtin.tuning import TUNE_NS, Tuning
from skyrange.world.airframes import AIRFRAMES

DT = 0.0025
FRAMES = ["iris", "x500", "iris", "iris"]


def fleet() -> tuple[np.ndarray, Tuning]:
    settings = np.zeros(len(FRAMES), dtype=SETTINGS)
    for row, name in enumerate(FRAMES):
        fill(settings, row, f"v{row}", AIRFRAMES[name], row + 1, {})
    tuning = Tuning(FRAMES, settings)
    tuning.renew(0, DT)
    return settings, tuning


def test_each_row_finds_its_own_parameters() -> None:
    settings, tuning = fleet()
    assert len(tuning.sets) == len(tuning.gains) == 2
    assert (tuning.sets[tuning.which] == settings).all()
    assert tuning.which[0] == tuning.which[2] == tuning.which[3] != tuning.which[1]
    for row in range(len(FRAMES)):
        assert tuning.gains["hover"][tuning.which[row]] == settings["MOT_THST_HOVER"][row]


def test_a_change_is_taken_up_at_the_next_tenth_of_a_second() -> None:
    settings, tuning = fleet()
    settings["ATC_ANG_RLL_P"][2] = 6.0
    tuning.renew(TUNE_NS - NS_PER_MS, DT)
    assert len(tuning.sets) == 2
    tuning.renew(TUNE_NS, DT)
    assert tuning.gains["angle_p"][tuning.which, 0].tolist() == [4.5, 4.5, 6.0, 4.5]
    assert (tuning.sets[tuning.which] == settings).all()
    settings["ATC_ANG_RLL_P"][2] = 4.5
    tuning.renew(2 * TUNE_NS, DT)
    assert len(tuning.sets) == 2


def test_gains_follow_the_step() -> None:
    _, tuning = fleet()
    before = tuning.gains["rate_i"][0, 0]
    tuning.renew(NS_PER_MS, 2 * DT)
    assert tuning.gains["rate_i"][0, 0] == 2 * before
