"""What cannot be on the air is said before the run: all of it at once, by its key, exit code 2, nothing written."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from skyrange.assembly.city import build_city
from skyrange.cli import main
from skyrange.scenario.toml_files import load_text

FLEET = """
name = "bad"
duration_s = 5
origin = [40.778, -73.955]
[city]
grid = {}
RADIO
[[operators]]
id = "green"
AVOIDS
  [[operators.vehicles]]
  id = "g1"
  plan.square = { side_m = 5, alt_m = 10 }
  RID
"""


def fleet(radio: str = "[radio]", rid: str = "", avoids: str = "") -> str:
    return FLEET.replace("RADIO", radio).replace("RID", rid).replace("AVOIDS", avoids)


def wall() -> str:
    """A place inside a building, as TOML."""
    city = build_city(load_text(fleet()))
    assert city is not None
    place = city.buildings[0].shape.representative_point()
    return f"[{place.x}, {place.y}, 3]"


def receiver(name: str, operator: str, place: str, more: str = "") -> str:
    return f'[[radio.receivers]]\nid = "{name}"\noperator = "{operator}"\nplace = {place}\n{more}\n'


def attack(name: str, kind: str, params: str) -> str:
    return f'[[attacks]]\nid = "{name}"\nkind = "{kind}"\nparams = {{ {params} }}\n'


def in_the_world() -> tuple[str, list[str]]:
    radio = "[radio]\n" + receiver("mast", "green", wall()) + receiver("low", "gren", "[0, 0, -3]")
    attacks = [
        attack("a", "remote_id.spoof", 'at = [1, 2, 3], via = "link", on = "green/g9"'),
        attack("b", "remote_id.jam", f"transmitter_m = {wall()}"),
        attack("c", "remote_id.jam", "transmitter_m = [0, 0, -2]"),
        attack("mast", "remote_id.replay", "transmitter_m = [0, 0, 2]"),
    ]
    return fleet(radio, 'remote_id = { uas_id = "SHORT" }') + "".join(attacks), [
        "radio.receivers.mast.place: [",
        "radio.receivers.low.place: [0, 0, -3] m — expected a place on the ground",
        "radio.receivers.low.operator: gren — expected an operator of the scenario. Did you mean 'green'?",
        "radio.receivers.mast.id: mast — expected an id that no other receiver and no attack has",
        "green/g1.remote_id.uas_id: SHORT",
        "attacks.a.params.on: green/g9 — expected a vehicle of the scenario. Did you mean 'green/g1'?",
        "attacks.b.params.transmitter_m: [",
        "attacks.c.params.transmitter_m: [0, 0, -2] m — expected a place on the ground",
        "expected a place outside buildings",
    ]


def without_radio() -> tuple[str, list[str]]:
    attacks = [
        attack("a", "remote_id.spoof", 'at = [1, 2, 3], via = "link", on = "green/g1"'),
        attack("b", "remote_id.jam", "transmitter_m = [0, 0, 2]"),
        attack("c", "remote_id.replay", "transmitter_m = [0, 0, 2]"),
        attack("d", "remote_id.spoof", "at = [1, 2, 3]"),
    ]
    return fleet("", "remote_id = {}", 'avoidance = "stop"') + "".join(attacks), [
        "attacks.a.params.on: rid_up:green/g1 — expected a link of the scenario",
        "attacks.b: a transmitter — expected a radio medium to send over",
        "attacks.c: a transmitter — expected a radio medium to send over",
        "attacks.d: a transmitter — expected a radio medium to send over",
        "green/g1.remote_id: set — expected a radio medium",
        "green/g1.avoidance: stop — expected a radio medium",
    ]


def unknown() -> tuple[str, list[str]]:
    radio = '[radio]\nengine = "gnuradio"\nband = "5ghz"\naboard = "radar"\n' + receiver(
        "mast", "green", "[0, 0, 3]", 'kind = "snifer"\nantenna = "yagi"'
    )
    attacks = [attack("a", "remote_id.spof", ""), attack("b", "remote_id.jam", "transmitter_m = [0, 0, 2], band = 5")]
    text = fleet(radio, 'remote_id = { transports = ["wifi_5ghz"], profile = "eu" }', 'avoidance = "orka"')
    return text + "".join(attacks), [
        "radio.band",
        "radio.engine: gnuradio — expected a radio medium",
        "radio.aboard: 'radar'",
        "radio.receivers.mast.kind: 'snifer'",
        "radio.receivers.mast.antenna: 'yagi'",
        "remote_id.transports: wifi_5ghz — expected a Remote ID transport",
        "remote_id.profile: 'eu'",
        "avoidance.kind: orka — expected a kind of avoidance that is installed. Did you mean 'orca'?",
        "attacks.a.kind: remote_id.spof — expected a kind of attack that is installed. Did you mean 'remote_id.spoof'?",
        "attacks.b.params.band",
    ]


@pytest.mark.parametrize("command", ["run", "pair"])
@pytest.mark.parametrize("case", [in_the_world, without_radio, unknown], ids=lambda case: case.__name__)
def test_all_that_cannot_be_is_said_at_once_and_nothing_is_written(
    case: Callable[[], tuple[str, list[str]]],
    command: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    text, words = case()
    (tmp_path / "bad.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["skyrange", command, "bad.toml"])
    with pytest.raises(SystemExit) as ended:
        main()
    done = capfd.readouterr()
    assert ended.value.code == 2, done.err
    assert done.out == ""
    for word in words:
        assert word in done.err, word
    assert "Traceback" not in done.err
    assert [path.name for path in tmp_path.iterdir()] == ["bad.toml"]
