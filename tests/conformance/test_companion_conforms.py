"""The companion keeps the contract of an agent, besieged and copied too."""

from __future__ import annotations

from functools import cache

import pytest

from skyrange.core.chance import Chance
from skyrange.core.time import NS_PER_S
from skyrange.remoteid.broadcast_profiles import Broadcast
from skyrange.testing import InputMessage, MessageRecorder, check_agent
from skyrange.vehicle.avoidance.geometric import Geometric
from skyrange.vehicle.companion import Companion, CompanionSpec
from tests.integration.companion_range import CRUISE_MPS, Ghost, legs, wired
from tests.unit.fake_autopilot import ORIGIN

pytestmark = pytest.mark.rotating

NAMES = ("blue/b1", "blue/b2")
UNTIL = 40 * NS_PER_S
_GEOMETRIC = Geometric()


def companion() -> Companion:
    specs = [
        CompanionSpec(name, row + 1, Broadcast(name, transports=("bluetooth", "wifi_beacon")), _GEOMETRIC, CRUISE_MPS)
        for row, name in enumerate(NAMES)
    ]
    return Companion("companions", specs, ORIGIN, Chance(3))


@cache
def mail() -> list[InputMessage]:
    """What it hears of two flights, with a ghost in the way of one."""
    homes = {name: (-100.0, 60.0 * row, 0.0) for row, name in enumerate(NAMES)}
    plans = {name: (home, legs(home, (-100.0, home[1], 30.0), (100.0, home[1], 30.0))) for name, home in homes.items()}
    flown = wired(plans, lambda city: None, ghosts=(Ghost("red", (0.0, 0.0, 30.0)),))
    recorder = MessageRecorder(companion().ports, flown.wiring.links)
    flown.kernel.set_observers([recorder])
    flown.run(UNTIL / NS_PER_S)
    return recorder.messages


def test_companion() -> None:
    assert len(mail()) > 500
    check_agent(companion, mail=mail(), until=UNTIL)
