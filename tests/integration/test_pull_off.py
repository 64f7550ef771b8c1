"""A pull-off against the estimator in flight: does the model of its gates hold, and is it worth having?"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np
import pytest

from skyrange.attack.contract import Aircraft, AttackContext, AttackPlugin
from skyrange.contracts.components import Sensors
from skyrange.contracts.links import Schedule
from skyrange.core.chance import Chance
from skyrange.core.geodesy import Origin
from skyrange.core.time import NS_PER_S, Epoch
from skyrange.vehicle.builtin.estimation.state import Status
from skyrange.vehicle.contract import VehicleSpec
from tests.integration.flight_harness import Range

pytestmark = pytest.mark.slow

DRIFT = AttackPlugin.find("gnss.drift")
PULL_OFF = AttackPlugin.find("gnss.pull_off")

ME = "blue/b1"
SECONDS = 40.0


@dataclass
class Flown:
    """What an attacked flight shows."""

    glitching: bool
    resets: int
    vel_ratio: float
    pos_ratio: float
    speed_mps: float
    """Greatest eastward speed of the fixes against the truth."""


@pytest.fixture(scope="module")
def hovering() -> Range:
    spec = VehicleSpec(vehicle=ME, system_id=1, airframe="iris", home_enu_m=(3.0, -2.0, 0.0), heading_deg=40.0)
    fly = Range([spec], noise=1.0)
    fly.take_off(ME, 20.0)
    fly.run(40.0)
    return fly


def attacked(trunk: Range, kind: AttackPlugin, seconds: float = SECONDS, **params: object) -> Flown:
    fly = copy.deepcopy(trunk)
    schedule = Schedule(fly.now, fly.now + round(seconds * NS_PER_S))
    context = AttackContext(
        "pull", {ME: Aircraft((3.0, -2.0, 0.0), "")}, [], Origin(40.0, -73.0, 0.0, 0.0), Epoch(0), Chance(3),
        round(seconds * NS_PER_S), schedule,
    )  # fmt: skip
    (fault,) = kind(kind.params.model_validate({"vehicles": [ME], **params}), context).sensor_hooks
    pulled = [0.0]

    def tamper(now: int, sensors: Sensors) -> None:
        before = float(sensors.gnss_vel_enu_mps[0, 0])
        fault.on_sensors(now, sensors)
        pulled.append(float(sensors.gnss_vel_enu_mps[0, 0]) - before)

    rows: list[np.void] = []
    fly.tamper = tamper
    fly.run(seconds, lambda fly: rows.append(fly.engines[0]._fleet.estimate[0].copy()))
    seen = np.array(rows)
    return Flown(
        glitching=bool((seen["status"] & Status.GPS_GLITCHING).any()),
        resets=int(seen["resets"].max() - seen["resets"][0]),
        vel_ratio=float(seen["vel_ratio"].max()),
        pos_ratio=float(seen["pos_ratio"].max()),
        speed_mps=max(pulled),
    )


@pytest.mark.parametrize("fraction", [0.3, 0.6, 0.9])
def test_below_the_gate_every_fix_is_accepted_and_the_innovation_is_the_predicted_one(
    hovering: Range, fraction: float
) -> None:
    flown = attacked(hovering, PULL_OFF, bearing_deg=90, gate_fraction=fraction)
    assert not flown.glitching
    assert flown.resets == 0
    assert flown.vel_ratio == pytest.approx(fraction, abs=0.1)
    assert flown.pos_ratio < 0.5
    assert flown.speed_mps == pytest.approx(10.0 if fraction > 0.5 else 9.0, abs=1.5)


def test_above_the_gate_the_estimator_rejects(hovering: Range) -> None:
    flown = attacked(hovering, PULL_OFF, bearing_deg=90, gate_fraction=1.2)
    assert flown.glitching
    assert flown.vel_ratio > 1.0


def test_a_drift_of_that_speed_without_the_model_is_rejected(hovering: Range) -> None:
    assert not attacked(hovering, DRIFT, rate_mps=[2.0, 0, 0]).glitching
    assert attacked(hovering, DRIFT, seconds=10.0, rate_mps=[4.0, 0, 0]).glitching
    assert attacked(hovering, DRIFT, seconds=10.0, rate_mps=[10.0, 0, 0]).glitching


def test_a_victim_with_narrower_gates_than_assumed_rejects(hovering: Range) -> None:
    """The model must know the gates: of a narrower one, the same fraction is more than all."""
    assert attacked(hovering, PULL_OFF, bearing_deg=90, gate_fraction=0.6, vel_i_gate=1000).glitching
