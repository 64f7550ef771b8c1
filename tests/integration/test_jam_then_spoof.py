"""A campaign of gnss.jam and gnss.capture: does it take the noise and the false signals to lead an aircraft away?"""

from __future__ import annotations

import pytest

from skyrange.assembly.build import build
from skyrange.core.time import NS_PER_S, from_seconds
from skyrange.kernel import Kernel
from skyrange.record import MemoryObserver
from skyrange.scenario.shipped import source_of
from skyrange.scenario.toml_files import load_text

pytestmark = pytest.mark.catalogue

SCENARIO = source_of("jam-then-spoof").read_text(encoding="utf-8").replace("duration_s = 115", "duration_s = 44")
JAMMER, SPOOFER = "power_dbm = -10 }", "power_dbm = -40,"


def flown(text: str) -> MemoryObserver:
    """The first 44 s: the jammer acts from 25 s to 28 s."""
    seen = MemoryObserver()
    kernel = Kernel(build(load_text(text)).wiring, [seen])
    kernel.advance(from_seconds(44.0))
    kernel.finish()
    return seen


def furthest_m(seen: MemoryObserver) -> float:
    """How far from its line the western aircraft has been."""
    return max(abs(float(row.columns["east_m"][0])) for row in seen.truth if row.time_ns > 25 * NS_PER_S)


@pytest.mark.parametrize(
    ("jammer", "spoofer", "acts", "led_away"),
    [
        (JAMMER, SPOOFER, {"mallory.jam.gnss", "mallory.spoof.gnss"}, True),
        ("power_dbm = -60 }", SPOOFER, {"mallory.spoof.gnss"}, False),
        (JAMMER, "power_dbm = -95,", {"mallory.jam.gnss"}, False),
    ],
    ids=["both", "spoofer-alone", "jammer-alone"],
)
def test_it_takes_both_to_lead_the_aircraft_away(jammer: str, spoofer: str, acts: set[str], led_away: bool) -> None:
    assert JAMMER in SCENARIO
    assert SPOOFER in SCENARIO
    seen = flown(SCENARIO.replace(JAMMER, jammer).replace(SPOOFER, spoofer))
    assert {label.actor for label in seen.labels} == acts
    assert (furthest_m(seen) > 20.0) == led_away
    assert furthest_m(seen) > 20.0 or furthest_m(seen) < 8.0
