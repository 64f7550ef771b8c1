"""Benchmark of flight approval: requests to the approval authority, answered in memory while many intents are active.

Intents are flights of eight legs in a square of 10 km, at one of five heights, within an hour. Each request is decoded,
decided on, and answered with bytes, as on the `approval` link.
"""

from __future__ import annotations

import math
import time
from typing import Any, Final

import numpy as np

from skyrange.bench.yardstick import yardstick_us
from skyrange.contracts.mailboxes import Arrival, Inbox
from skyrange.core.chance import Chance
from skyrange.core.geodesy import Origin
from skyrange.core.ids import FrameId, Port, hash64
from skyrange.core.time import NS_PER_S, Epoch
from skyrange.gcs.plan.paths import Leg, Point
from skyrange.gcs.plan.volumes import MARGINS, leg_volumes
from skyrange.runtime.memory import collect_seldom
from skyrange.utm.approval_service import FlightApproval
from skyrange.utm.authority import Authority, AuthorityParams
from skyrange.utm.contract import OperationalIntent, intent_id
from skyrange.utm.messages import DecisionBody, Request, decode_response, encode

_SIDE_M: Final = 10_000.0
_HEIGHTS_M: Final = (30.0, 45.0, 60.0, 75.0, 90.0)
_LEGS: Final = 6
"""Legs at height, between take-off and landing."""
_HOUR_S: Final = 3_600.0
_ORIGIN: Final = Origin(40.7, -74.0, 10.0, -32.0)
_EPOCH: Final = Epoch(1_767_268_800 * NS_PER_S)
_PORT: Final = Port("approval", "approval:blue")
_MOST_TRIES: Final = 20


def measure(active: int, requests: int) -> dict[str, Any]:
    """Answer `requests` while `active` intents are accepted; each that is accepted is ended again.

    `decisions_per_s` is of one core; `mean_ms`, `p50_ms` and `p99_ms` are wall time of one request, `cpu_ms` its mean
    processor time; `rejected` is the share of requests that got alternatives instead.
    """
    authority = Authority(AuthorityParams())
    service = FlightApproval(["blue"], _EPOCH, authority)
    number = accepted = 0
    while accepted < active and number < _MOST_TRIES * active:
        accepted += authority.follow(0, make_intent(number)).accepted
        number += 1
    times, rejected, cpu_s = np.zeros(requests), 0, 0.0
    with collect_seldom():  # as `skyrange utm serve` does
        for row in range(requests):
            payload = _request(number)
            before_s = time.process_time()
            times[row], taken = _answer(service, number, payload)
            cpu_s += time.process_time() - before_s
            rejected += not taken
            if taken:
                service.step(0, Inbox([_arrival(number, encode(Request.end(make_intent(number))))]))
            number += 1
    milliseconds = times * 1e3
    return {
        "active": accepted,
        "requests": requests,
        "rejected": round(rejected / requests, 3),
        "decisions_per_s": round(float(requests / times.sum()), 1),
        "mean_ms": round(float(milliseconds.mean()), 3),
        "cpu_ms": round(cpu_s / requests * 1e3, 3),
        "p50_ms": round(float(np.percentile(milliseconds, 50)), 3),
        "p99_ms": round(float(np.percentile(milliseconds, 99)), 3),
        "yardstick_us": round(yardstick_us(), 2),
    }


def _answer(service: FlightApproval, number: int, payload: bytes) -> tuple[float, bool]:
    """How long the answer to a request took, and whether it accepts."""
    inbox = Inbox([_arrival(number, payload)])
    began = time.perf_counter()
    out = service.step(0, inbox)
    took_s = time.perf_counter() - began
    body = decode_response(out.departures[-1].payload).body
    return took_s, isinstance(body, DecisionBody) and body.decision == "Accepted"


def _arrival(number: int, payload: bytes) -> Arrival:
    return Arrival(_PORT, 0, payload, "", FrameId(_PORT.link, "fwd", "blue.gcs", number))


def _request(number: int) -> bytes:
    return encode(Request.of(make_intent(number), _EPOCH))


def make_intent(number: int) -> OperationalIntent:
    """The `number`-th flight: up, along legs of 150 to 400 m, and down."""
    chance = Chance(1)
    vehicle = f"blue/b{number}"

    def draw(k: int) -> tuple[float, float, float, float]:
        return chance.uniform4("bench.approval", hash64(vehicle), 0, k)

    east, north, when, height = draw(0)
    here = Point((east - 0.5) * _SIDE_M, (north - 0.5) * _SIDE_M, 0.0)
    top = here._replace(up_m=_HEIGHTS_M[int(height * len(_HEIGHTS_M))])
    legs = [Leg(here, top, top.up_m / 2.5)]
    here = top
    for k in range(1, _LEGS + 1):
        turn, far, _, _ = draw(k)
        length_m = 150.0 + 250.0 * far
        angle = 2.0 * math.pi * turn
        next_point = Point(
            here.east_m + length_m * math.cos(angle), here.north_m + length_m * math.sin(angle), here.up_m
        )
        legs.append(Leg(here, next_point, length_m / 5.0))
        here = next_point
    legs.append(Leg(here, here._replace(up_m=0.0), here.up_m / 1.5))
    volumes = leg_volumes(_ORIGIN, legs, round((60.0 + _HOUR_S * when) * NS_PER_S), MARGINS)
    return OperationalIntent(intent_id(vehicle), "blue", vehicle, volumes)
