"""Does a federation keep intents apart whatever its operators ask, and however late and lossy its links are?"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from implicitdict import ImplicitDict
from uas_standards.astm.f3548.v21.api import OPERATIONS

from skyrange.codec.f3548.frames import UssRequest, decode
from skyrange.codec.f3548.operations import find_operation
from skyrange.contracts.components import Agent
from skyrange.contracts.links import Channel, LinkSpec
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.core.chance import Chance
from skyrange.core.geodesy import Origin
from skyrange.core.ids import APPROVAL
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.core.volumes import Volume4D
from skyrange.kernel import Kernel, Wiring
from skyrange.record import MemoryObserver
from skyrange.testing.checks.approval_policies import EPOCH, box
from skyrange.utm.airspace.claimed_airspace import Airspace
from skyrange.utm.contract import ApprovalContext, intent_id
from skyrange.utm.federated.dss.intents import NOMINAL
from skyrange.utm.federated.dss.service import Dss
from skyrange.utm.federated.plugin import FEDERATED
from skyrange.utm.federated.uss.service import Uss
from tests.approval_stations import LAT, LON, Station, ask, end

pytestmark = pytest.mark.rotating

NAMES = ("blue", "green", "red")
UNTIL_S = 90


@dataclass(frozen=True)
class Step:
    """What one operator asks at one time."""

    at_s: float
    operator: str
    flight: int
    place: int
    slot: int
    priority: int
    ends: bool


STEPS = st.lists(
    st.builds(
        Step,
        at_s=st.integers(0, 40).map(lambda tenths: tenths / 10.0),
        operator=st.sampled_from(NAMES),
        flight=st.integers(0, 2),
        place=st.integers(0, 2),
        slot=st.integers(0, 2),
        priority=st.sampled_from([0, 0, 0, 20]),
        ends=st.sampled_from([False, False, False, True]),
    ),
    min_size=1,
    max_size=14,
)


def claim(step: Step) -> Volume4D:
    return box(LAT + 0.0006 * step.place, LON, start_s=600.0 + 90.0 * step.slot)


def letters(steps: Sequence[Step], operator: str) -> list[tuple[float, bytes]]:
    rows = []
    for number, step in enumerate(sorted(steps, key=lambda one: one.at_s)):
        if step.operator == operator:
            vehicle = f"{operator}/f{step.flight}"
            request = ask(vehicle, claim(step), priority=step.priority, version=number + 1)
            rows.append((step.at_s, end(vehicle) if step.ends else request))
    return rows


def check_apart(dss: Dss, usss: dict[str, Uss]) -> None:
    """No two nominal intents of one priority overlap, by the volumes that their USSs have."""
    shown = []
    for stored in dss.store.intents:
        reference = stored.reference
        uss = usss[reference.manager]
        intent, own = uss._intents.get(stored.id), uss._intents.own.get(stored.id)
        # a USS learns later than the DSS that its intent was accepted
        if intent is not None and own is not None and own.version == reference.version and reference.state in NOMINAL:
            shown.append(intent)
    for one, other in combinations(shown, 2):
        airspace = Airspace()
        airspace.put(one.id, one.volumes)
        if airspace.find_overlaps(other.volumes):
            assert one.priority != other.priority, (one, other)


def check_bodies(seen: MemoryObserver) -> None:
    """The package of the standard's types reads every request."""
    for frame in seen.frames:
        if frame.link.startswith("uss:"):
            message = decode(frame.payload)
            if isinstance(message, UssRequest):
                operation = find_operation(message.method, message.path)
                assert operation is not None, message.path
                model = OPERATIONS[operation.id].request_body_type
                assert (model is None) == (message.body is None)
                if model is not None:
                    ImplicitDict.parse(message.body, model)


JSON = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**60), 2**60)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)


def alter(data: st.DataObject, value: Any) -> Any:
    """The value with one part of it, at any depth, taken away or replaced."""
    if isinstance(value, dict) and value:
        key = data.draw(st.sampled_from(sorted(value)))
        if data.draw(st.integers(0, 4)) == 0:
            return {name: one for name, one in value.items() if name != key}
        return {**value, key: alter(data, value[key])}
    if isinstance(value, list) and value:
        place = data.draw(st.integers(0, len(value) - 1))
        return [*value[:place], alter(data, value[place]), *value[place + 1 :]]
    return data.draw(st.sampled_from([200, 201, 204, 404, 409]) if isinstance(value, int) else JSON)


@settings(deadline=None, suppress_health_check=list(HealthCheck))
@given(steps=STEPS, data=st.data())
def test_altered_messages_stop_no_service(steps: Sequence[Step], data: st.DataObject) -> None:
    context = ApprovalContext(f"{APPROVAL}.federated", NAMES, Origin(LAT, LON), EPOCH, Chance(1))
    service = FEDERATED(FEDERATED.params(), context)
    for agent in service.agents:
        _alter_departures(agent, data)
    stations = [Station(name, letters(steps, name)) for name in NAMES]
    own = [
        LinkSpec(one.ports[0].link, one.name, APPROVAL, Channel(mode="reliable", latency_ns=NS_PER_MS))
        for one in stations
    ]
    agents: list[Agent] = [*stations, *service.agents]
    kernel = Kernel(Wiring(seed=1, links=[*own, *service.links], agents=agents), [])
    kernel.advance(20 * NS_PER_S)
    kernel.finish()


def _alter_departures(agent: Any, data: st.DataObject) -> None:
    step: Callable[[Time, Inbox], Outbox] = agent.step

    def altered(now: Time, inbox: Inbox) -> Outbox:
        out = step(now, inbox)
        for number, one in enumerate(out.departures):
            if one.port.link.startswith("uss:") and data.draw(st.integers(0, 9)) == 0:
                value = alter(data, json.loads(one.payload))
                out.departures[number] = one._replace(payload=json.dumps(value).encode())
        return out

    agent.step = altered


@settings(deadline=None)
@given(
    steps=STEPS,
    latency_ms=st.integers(1, 400),
    loss=st.sampled_from([0.0, 0.0, 0.1, 0.3]),
    seed=st.integers(0, 1_000),
)
def test_accepted_intents_are_apart_at_every_moment_and_every_request_is_answered(
    steps: Sequence[Step], latency_ms: int, loss: float, seed: int
) -> None:
    context = ApprovalContext(f"{APPROVAL}.federated", NAMES, Origin(LAT, LON), EPOCH, Chance(seed))
    service = FEDERATED(FEDERATED.params.model_validate({"max_delay_s": 600, "climbs_m": [], "aside_m": []}), context)
    dss, *others = service.agents
    assert isinstance(dss, Dss)
    usss = {one.uss: one for one in others if isinstance(one, Uss)}
    channel = Channel(latency_ns=latency_ms * NS_PER_MS, jitter_ns=latency_ms * NS_PER_MS // 2, loss=loss)
    stations = [Station(name, letters(steps, name)) for name in NAMES]
    own = [
        LinkSpec(one.ports[0].link, one.name, APPROVAL, Channel(mode="reliable", latency_ns=NS_PER_MS))
        for one in stations
    ]
    links: list[Any] = [replace(one, channel=channel) for one in service.links]
    seen = MemoryObserver()
    agents: list[Agent] = [*stations, *service.agents]
    kernel = Kernel(Wiring(seed=seed, links=[*own, *links], agents=agents), [seen])
    for tenth in range(UNTIL_S * 5):
        kernel.advance(tenth * NS_PER_S // 5)
        check_apart(dss, usss)
    kernel.finish()
    check_bodies(seen)
    for station in stations:
        asked = len(station.asks)
        answered = [body for _, body in station.answers if not body.overruled]
        assert len(answered) <= asked
        if loss == 0.0:
            asked_for = {one.flight for one in steps if one.operator == station.operator}
            assert {body.id for body in answered} == {intent_id(f"{station.operator}/f{one}") for one in asked_for}
