"""Defences in scenarios: what is refused before a run, their order at one end, and what only they may do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from skyrange.assembly.build import build
from skyrange.attack.contract import Attack, AttackContext, AttackPlugin
from skyrange.attack.tapped_links import TapMaker
from skyrange.contracts.alerts import Alert
from skyrange.contracts.components import SensorAct, Sensors
from skyrange.contracts.frames import Frame
from skyrange.contracts.plugins.registry import DEFENCES, NoParams, kinds
from skyrange.contracts.verdicts import Verdict
from skyrange.core.errors import ComponentError, InputError
from skyrange.core.time import NS_PER_S, Time
from skyrange.defence.contract import Defence, DefenceContext, DefencePlugin
from skyrange.defence.placement import Alarm, DefenceTap, place_taps
from skyrange.kernel import Kernel
from skyrange.record import MemoryObserver
from skyrange.scenario.toml_files import load_text
from tests.registered_kinds import registered

BASE = """
name = "defended"
duration_s = 6
origin = [47.3977, 8.5456]
[[operators]]
id = "blue"
  [[operators.vehicles]]
  id = "b1"
  plan = { square = { side_m = 10, alt_m = 8 } }
"""
NATIVE = (
    BASE.replace('id = "b1"', 'id = "b1"\n  autopilot = "ardupilot"')
    + '[autopilots.options.ardupilot]\nphysics = "native"\n'
)
UNREAD = "params.vehicles: blue/b1 — expected an aircraft that flies by"
FIREWALL = '[[defences]]\nid = "a"\nkind = "mavlink.firewall"\n'


def scenario(more: str) -> Any:
    return load_text(BASE + more)


@pytest.mark.parametrize(
    ("more", "where", "hint"),
    [
        ('[[defences]]\nid = "a"\nkind = "mavlink.firewal"', "defences.a.kind", "mavlink.firewall"),
        (
            FIREWALL + 'params = { vehicles = ["blue/b2"] }',
            "vehicles",
            "blue/b1",
        ),
        (FIREWALL + 'params = { commands = ["ARM"] }', "commands", ""),
        (FIREWALL + "start_s = 5\nstop_s = 4", "stop_s", ""),
        (FIREWALL + "cost = { us_per_frame = -1 }", "us_per_frame", ""),
        (FIREWALL + "cost = { us_per_frame = nan }", "us_per_frame", ""),
        (FIREWALL + "cost = { us = 1 }", "us", "us_per_frame"),
        ('[[defences]]\nid = "a"\nkind = "gnss.barometer"\ncost = { us_per_frame = 1 }', "defences.a.cost", "sensors"),
        (
            '[[defences]]\nid = "a"\nkind = "mavlink.firewall"\n[[detectors]]\nid = "a"\nkind = "heartbeat.gap"',
            "defences.a.id",
            "detectors.0 already has it",
        ),
        (
            '[[defences]]\nid = "a"\nkind = "mavlink.firewall"\n[[defences]]\nid = "b"\nkind = "mavlink.firewall"',
            "defences.b",
            "Choose times that do not overlap",
        ),
    ],
)
def test_wrong_defences_are_named_before_the_run(more: str, where: str, hint: str) -> None:
    with pytest.raises(InputError) as caught:
        build(scenario(more))
    text = str(caught.value)
    assert where in text
    assert hint in text


RADIO = "[radio]\n"
RECEIVER = '[[radio.receivers]]\nid = "r"\noperator = "blue"\nplace = [0, 9, 3]\n'


def declare(kind: str, params: str = "") -> str:
    return f'[[defences]]\nid = "a"\nkind = "{kind}"\nparams = {{ {params} }}\n'


@pytest.mark.parametrize("kind", kinds(DEFENCES))
def test_a_defence_of_nobody_is_named_for_each_kind(kind: str) -> None:
    key = "operators" if kind == "remote_id.ground" else "vehicles"
    if key not in DefencePlugin.find(kind).params.model_fields:
        pytest.skip("a kind of a test, which has no parameters")
    with pytest.raises(InputError, match=rf"defences\.a\.params\.{key}\.0: red.* — expected") as caught:
        build(scenario(RADIO + RECEIVER + declare(kind, f'{key} = ["red/r1"]')))
    assert "blue" in str(caught.value)


@pytest.mark.parametrize(
    ("more", "where", "hint"),
    [
        (declare("remote_id.signal"), "a.params.vehicles: no link rid_down", "Add a table [radio]"),
        (declare("remote_id.motion"), "a.params.vehicles: no link rid_down", "Add a table [radio]"),
        (declare("remote_id.appearance"), "a.params.vehicles: no link rid_down", "Add a table [radio]"),
        (declare("remote_id.replay"), "a.params.vehicles: no link rid_down", "Add a table [radio]"),
        (RADIO + declare("remote_id.ground"), "a.params.operators: no receivers", "Add [[radio.receivers]]"),
        (declare("control_link.channel_change"), "a.params.vehicles: blue/b1", 'channel = "wifi"'),
        (declare("mavlink.firewall", 'at = "gcs"'), "a.params.at: 'gcs'", "Known: companion, proxy"),
        (declare("mission.hash", 'at = "autopilot"'), "a.params.at: 'autopilot'", "Known: companion, proxy"),
        (declare("parameter.watch", 'at = "station"'), "a.params.at: 'station'", "Known: companion, proxy"),
        (declare("mission.hash", 'passphrase = ""'), "a.params.passphrase: ''", "at least 1 character"),
        (declare("mission.hash", "passphrase = 5"), "a.params.passphrase: 5", "text in quotes"),
        (declare("mavlink.signing", 'key = "00"'), "a.params.key", "Known: passphrase"),
        (declare("mavlink.signing", f'passphrase = "{"x" * 257}"'), "a.params.passphrase", "at most 256"),
    ],
)
def test_a_defence_where_it_cannot_stand_is_named(more: str, where: str, hint: str) -> None:
    with pytest.raises(InputError) as caught:
        build(scenario(more))
    assert where in str(caught.value)
    assert hint in str(caught.value)


@pytest.mark.parametrize("kind", ["gnss.barometer", "gnss.innovation", "gnss.integrity", "gnss.receiver"])
def test_a_check_of_sensors_outside_the_range_is_named(kind: str) -> None:
    options = '[autopilots.options.external]\nconnect = { "blue/b1" = "tcp:127.0.0.1:5760" }\n'
    text = BASE.replace('id = "b1"', 'id = "b1"\n  autopilot = "external"') + options
    build(load_text(text))
    with pytest.raises(
        InputError, match=r"defences\.a\.params\.vehicles: blue/b1 — expected an aircraft that flies by"
    ):
        build(load_text(text + declare(kind)))


@pytest.mark.parametrize("kind", ["gnss.barometer", "gnss.innovation", "gnss.integrity", "gnss.receiver"])
def test_a_check_of_the_sensors_of_native_physics_is_named(kind: str) -> None:
    with pytest.raises(
        InputError, match=r"defences\.a\.params\.vehicles: blue/b1 — expected an aircraft that flies by"
    ):
        build(load_text(NATIVE + declare(kind)))


@pytest.mark.parametrize(
    ("table", "kind", "params"),
    [
        ("attacks", "gnss.jump", 'vehicles = ["blue/b1"], offset_m = [9, 0, 0]'),
        ("faults", "gnss.outage", 'vehicles = ["blue/b1"]'),
    ],
)
def test_an_attack_or_a_fault_of_the_sensors_of_native_physics_is_named(table: str, kind: str, params: str) -> None:
    more = f'[[{table}]]\nid = "a"\nkind = "{kind}"\nstart_s = 1\nparams = {{ {params} }}\n'
    with pytest.raises(InputError, match=rf"{table}\.a\.{UNREAD}"):
        build(load_text(NATIVE + more))


@pytest.mark.parametrize("signed", [declare("mavlink.signing"), "signing"])
def test_a_start_before_the_first_timestamp_of_signatures_is_named(signed: str) -> None:
    base = BASE.replace('id = "blue"', 'id = "blue"\nsigning = "on"') if signed == "signing" else BASE + signed
    start = "duration_s = 6\nstart_utc = {}T00:00:00Z"
    build(load_text(base.replace("duration_s = 6", start.format("2015-01-01"))))
    with pytest.raises(InputError, match=r"start_utc: 2014-12-31.*MAVLink signatures"):
        build(load_text(base.replace("duration_s = 6", start.format("2014-12-31"))))


def test_a_registry_that_does_not_exist_is_named() -> None:
    broadcasts = 'id = "b1"\n  remote_id = { auth = "drip", registry = "faa" }'
    with pytest.raises(InputError, match=r"remote_id\.registry: 'faa' .*Known: range, unknown"):
        build(load_text(BASE.replace('id = "b1"', broadcasts) + RADIO))


@pytest.mark.parametrize("error_s", [-2.1, 120.1])
def test_a_clock_outside_the_validity_of_signatures_is_named(error_s: float) -> None:
    verifies = f'id = "b1"\n  remote_id = {{ verify = {{ clock_error_s = {error_s} }} }}'
    with pytest.raises(InputError, match=rf"verify\.clock_error_s: {error_s}"):
        build(load_text(BASE.replace('id = "b1"', verifies) + RADIO))


def test_a_muted_defence_excludes_no_other() -> None:
    build(
        scenario(
            '[[defences]]\nid = "a"\nkind = "mavlink.firewall"\nmuted = true\n'
            '[[defences]]\nid = "b"\nkind = "mavlink.firewall"'
        )
    )


@dataclass(slots=True)
class Witness(DefenceTap):
    """Raises an alarm for each frame, so that the order of those that share an end shows."""

    alarm: Alarm
    direction: str

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        return self.alarm.raise_at(now, "seen", 1.0) if frame.direction == self.direction else []


@dataclass(slots=True)
class Blindfold:
    """A sensor check that tells whether the true attitude is in its readings."""

    name: str
    vehicles: Sequence[str]
    told: bool = False

    def on_sensors(self, now: Time, sensors: Sensors) -> Sequence[SensorAct | Alert]:
        if self.told:
            return []
        self.told = True
        known = bool(np.isfinite(sensors.attitude).any()) or not np.isfinite(sensors.gyro_radps).all()
        return [Alert(now, self.vehicles[0], "blind", float(known))]


def _witness(direction: str) -> Any:
    def make(params: NoParams, context: DefenceContext) -> Defence:
        maker = TapMaker(Witness, (Alarm("blue/b1", 100 * NS_PER_S), direction))
        return Defence(taps=place_taps("gcs", "companion", list(context.vehicles), context, maker))

    return make


def _blindfold(params: NoParams, context: DefenceContext) -> Defence:
    return Defence(checks=[Blindfold(context.id, list(context.vehicles))])


def _loud(params: NoParams, context: AttackContext) -> Attack:
    maker = TapMaker(Witness, (Alarm("blue/b1"), "fwd"))
    return Attack(taps=place_taps("gcs", "companion", list(context.vehicles), context, maker))


KINDS = (
    ("test.arriving", DefencePlugin(NoParams, _witness("fwd"), "Tells of what arrives.")),
    ("test.leaving", DefencePlugin(NoParams, _witness("rev"), "Tells of what leaves.")),
    ("test.blindfold", DefencePlugin(NoParams, _blindfold, "Tells what it can read.")),
    ("test.loud", AttackPlugin(NoParams, _loud, "Raises an alert, which no attack may.")),
)


def fly(more: str) -> MemoryObserver:
    seen = MemoryObserver()
    with registered(*KINDS):
        kernel = Kernel(build(scenario(more)).wiring, [seen])
    kernel.advance(6 * NS_PER_S)
    kernel.finish()
    return seen


@pytest.mark.parametrize(("kind", "order"), [("test.arriving", ["z", "a"]), ("test.leaving", ["a", "z"])])
def test_what_arrives_meets_the_first_declared_defence_first(kind: str, order: list[str]) -> None:
    seen = fly(f'[[defences]]\nid = "z"\nkind = "{kind}"\n[[defences]]\nid = "a"\nkind = "{kind}"')
    assert [one.detector for one in seen.alerts] == order


def test_a_sensor_check_cannot_read_the_true_attitude() -> None:
    (alert,) = fly('[[defences]]\nid = "look"\nkind = "test.blindfold"').alerts
    assert (alert.detector, alert.alert.kind, alert.alert.score) == ("look", "blind", 0.0)


def test_an_attack_that_raises_an_alert_is_blamed() -> None:
    with pytest.raises(ComponentError, match="only a defence raises alerts"):
        fly('[[attacks]]\nid = "foe"\nkind = "test.loud"')
