"""Orders of an approval authority: who comes first when several operators want the same airspace."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.core.chance import Chance
from skyrange.core.geodesy import Origin
from skyrange.core.ids import APPROVAL
from skyrange.core.time import NS_PER_S
from skyrange.testing.checks.approval_policies import EPOCH, box
from skyrange.utm.contract import ApprovalContext, ApprovalPlugin
from skyrange.utm.intent_states import IntentState
from skyrange.utm.request_book import WaitingRequest, least_served
from tests.approval_stations import LAT, LON, Station, ask, decisions, end, fly_requests
from tests.tiers import examples

NAMES = ("blue", "green", "red")


def flown(asks: Mapping[str, Sequence[tuple[float, bytes]]], **params: object) -> dict[str, Station]:
    plugin = ApprovalPlugin.find("authority")
    context = ApprovalContext(f"{APPROVAL}.authority", NAMES, Origin(LAT, LON), EPOCH, Chance(3))
    service = plugin(plugin.params.model_validate(params), context)
    rows = {name: asks.get(name, ()) for name in NAMES}
    return fly_requests(rows, 20.0, service.agents, service.links, 3)[0]


def rush() -> dict[str, list[tuple[float, bytes]]]:
    """Blue has two flights already, and asks for a third just before green asks for its first there."""
    early = [(0.1 + number, ask(f"blue/b{number}", box(LAT + 0.01 * (number + 1), LON))) for number in range(2)]
    return {
        "blue": [*early, (5.0, ask("blue/b9", box(LAT, LON)))],
        "green": [(5.4, ask("green/g1", box(LAT, LON)))],
    }


def test_first_come_is_first_served_by_default() -> None:
    stations = flown(rush())
    assert decisions(stations["blue"]) == ["Accepted"] * 3
    assert decisions(stations["green"]) == ["Rejected"]


def test_the_operator_with_the_fewest_accepted_intents_is_served_first() -> None:
    stations = flown(rush(), order="least_served")
    assert decisions(stations["blue"]) == ["Accepted", "Accepted", "Rejected"]
    assert decisions(stations["green"]) == ["Accepted"]
    assert stations["blue"].answers[2][1].alternatives


def test_what_is_in_flight_or_ends_does_not_wait() -> None:
    active = ask("blue/b1", box(LAT, LON, start_s=0.0), state=IntentState.ACTIVATED, version=1)
    asks = {"blue": [(0.1, ask("blue/b1", box(LAT, LON, start_s=0.0))), (8.0, active), (9.0, end("blue/b1"))]}
    stations = flown({**asks, "green": [(7.9, ask("green/g1", box(LAT, LON)))]}, order="least_served", window_s=5)
    assert decisions(stations["blue"]) == ["Accepted", "Accepted", "Ended"]
    assert [at // NS_PER_S for at, _ in stations["blue"].answers] == [5, 8, 9]
    assert stations["green"].answers[0][0] // NS_PER_S == 12


def test_a_flight_that_is_withdrawn_while_it_waits_claims_nothing_afterwards() -> None:
    asks = {
        "blue": [(0.1, ask("blue/b1", box(LAT, LON))), (1.0, end("blue/b1"))],
        "green": [(8.0, ask("green/g1", box(LAT, LON)))],
    }
    stations = flown(asks, order="least_served", window_s=5)
    assert decisions(stations["blue"]) == ["Accepted", "Ended"]
    assert decisions(stations["green"]) == ["Accepted"]


@pytest.mark.parametrize("ties", [(b"a", b"b"), (b"b", b"a")])
def test_a_tie_favours_no_name(ties: tuple[bytes, bytes]) -> None:
    waiting = [WaitingRequest(name, 7, 3, tie) for name, tie in zip(NAMES, ties, strict=False)]
    assert least_served(waiting) == ties.index(b"a")


REQUESTS = st.lists(
    st.tuples(
        st.sampled_from(NAMES),
        st.integers(1, 120),  # tenths of a second
        st.sampled_from(["ask", "end"]),
        st.integers(0, 1),  # vehicle
        st.integers(0, 2),  # place
    ),
    max_size=14,
)


@given(REQUESTS, st.sampled_from([0.1, 1.0, 4.0]))
@settings(deadline=None, max_examples=examples(200))
def test_each_request_has_one_answer_within_the_window_and_a_little(
    rows: list[tuple[str, int, str, int, int]], window_s: float
) -> None:
    asks: dict[str, list[tuple[float, bytes]]] = {name: [] for name in NAMES}
    for version, (name, tenth, what, number, place) in enumerate(sorted(rows, key=lambda row: row[1])):
        vehicle = f"{name}/v{number}"
        volume = box(LAT + 0.0004 * place, LON, start_s=600.0 + version)  # no two requests are alike
        asks[name].append((tenth / 10, end(vehicle) if what == "end" else ask(vehicle, volume, version=version)))
    stations = flown(asks, order="least_served", window_s=window_s)
    for name, station in stations.items():
        distinct = Counter(payload for _, payload in asks[name])
        assert len(station.answers) == sum(distinct.values()), "each has an answer, repeated ones again"
        last = max((at for at, _ in asks[name]), default=0.0)
        assert all(at <= (last + window_s + 0.2) * NS_PER_S for at, _ in station.answers)
