"""Does the builtin medium keep its contract on a loss table: cuts, company, copies, chance?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from skyrange.contracts.medium import RadioSpec
from skyrange.core.chance import Chance
from skyrange.radio.builtin.medium import BuiltinMedium
from skyrange.radio.propagation.loss_table import LossGrid, free_space_of, loss_table
from skyrange.testing import check_medium

GRID = LossGrid(-600.0, -600.0, 100.0, 13, 13, (0.0, 50.0, 200.0))


@pytest.mark.rotating
def test_the_builtin_medium_conforms_on_a_table() -> None:
    places = np.array([(float(x), float(y), 30.0) for x in range(-500, 501, 250) for y in range(-500, 501, 250)])
    excess = np.random.default_rng(1).uniform(-5.0, 30.0, (len(places), *GRID.shape))
    excess[..., 8:] = np.nan  # from 200 m east of the origin; the radios stand up to 300 m east of it
    losses = np.stack([free_space_of(place, GRID, 2437.0) for place in places]) + excess
    table = loss_table(places, losses.astype(np.float32), GRID, 2437.0, 180.0, 100.0)
    made: list[BuiltinMedium] = []

    def make(radios: Sequence[RadioSpec]) -> BuiltinMedium:
        made.append(BuiltinMedium(radios, Chance(3), table=table, every_pair=True))
        return made[-1]

    check_medium(make)
    found, not_covered = np.sum([medium.table_lookups for medium in made], axis=0).tolist()
    assert found > 1_000
    assert not_covered > 100
