from __future__ import annotations

import pytest

from skyrange.core.errors import InputError
from skyrange.core.geodesy import Origin
from skyrange.core.time import Epoch
from skyrange.gcs.flight.lifecycle import Flight
from skyrange.gcs.plan.plans import square
from skyrange.gcs.station import GroundStation

PLAN = square(Origin(47.0, 8.0), (0.0, 0.0, 0.0), side_m=5, alt_m=5)


def station(*addresses: tuple[int, int]) -> GroundStation:
    flights = [
        Flight(f"blue/b{place}", system_id, PLAN, network=network)
        for place, (network, system_id) in enumerate(addresses)
    ]
    return GroundStation("blue", flights, Epoch(0))


def test_a_system_id_may_occur_once_in_each_network() -> None:
    assert len(station((0, 1), (1, 1), (7, 1), (0, 2)).states) == 4


@pytest.mark.parametrize("addresses", [[(0, 1), (0, 1)], [(3, 9), (0, 9), (3, 9)], [(0, 0)], [(1, 251)]])
def test_but_not_twice_in_one_nor_out_of_range(addresses: list[tuple[int, int]]) -> None:
    with pytest.raises(InputError, match=r"a system id in 1…250 that occurs once in its network"):
        station(*addresses)
