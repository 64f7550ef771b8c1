"""Places of attackers on control links: where their taps are, what the manifest says, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import pytest

from skyrange.assembly.build import build
from skyrange.attack.contract import AttackPlugin
from skyrange.contracts.frames import Fate, Frame
from skyrange.contracts.links import AIR, Act, Channel, OpenChannel, TapPlacement, Uniforms
from skyrange.contracts.mailboxes import Note
from skyrange.contracts.plugins.registry import ATTACKS, kinds
from skyrange.contracts.verdicts import Delay, Drop, Inject, Replace, Verdict
from skyrange.core.errors import ComponentError, InputError
from skyrange.core.time import NS_PER_S, Time
from skyrange.kernel import Kernel, Wiring
from skyrange.scenario import Scenario
from tests.probes.toys import MS, Fleet, Log, Station, onboard

CELLULAR = 'cellular = { base_stations = [{ id = "w", place = [0, 50, 25] }] }'
COMMAND = {"vehicles": ["blue/b1"], "command": "REQUEST_MESSAGE"}
RADIO = {"place": "air", "radio_m": [10.0, 10.0, 2.0]}


def attacked(kind: str, params: dict[str, Any], channel: str = "wifi") -> Scenario:
    """An aircraft under one attack."""
    rule = {"fixed": "", "wifi": 'channel = "wifi"', "cellular": f'channel = "cellular"\n{CELLULAR}'}[channel]
    own = ", ".join(f"{name} = {json.dumps(value)}" for name, value in params.items())
    return Scenario.from_toml(f"""
name = "places"
duration_s = 20
origin = [40.0, -73.0]
[radio]
[[links]]
match = "gcs:*"
{rule or "latency_ms = 5"}
[[operators]]
id = "blue"
  [[operators.vehicles]]
  id = "b1"
  plan = {{ square = {{ side_m = 8, alt_m = 6 }} }}
[[attacks]]
id = "x"
kind = "{kind}"
params = {{ {own} }}
""")


def placed(kind: str, params: dict[str, Any], channel: str = "wifi") -> tuple[list[str], dict[str, Any]]:
    """The sides of its taps, and its row in the manifest."""
    built = build(attacked(kind, params, channel))
    return [tap.side for tap in built.wiring.taps if tap.attack == "x"], built.header["attacks"][0]


ON_LINK = {"links": ["gcs:blue/b1"]}


@pytest.mark.parametrize(
    ("kind", "params", "channel", "side", "place"),
    [
        ("mavlink.command", COMMAND, "wifi", "gcs", "network"),
        ("mavlink.command", COMMAND, "cellular", "gcs", "network"),
        ("mavlink.command", COMMAND, "fixed", "companion", None),
        ("mavlink.command", COMMAND | {"place": "onboard"}, "wifi", "companion", "onboard"),
        ("mavlink.command", COMMAND | {"place": "network"}, "fixed", "gcs", "network"),
        ("mavlink.command", COMMAND | RADIO, "wifi", AIR, "air"),
        ("mavlink.command", COMMAND | {"on": "log"}, "wifi", "proxy", None),
        ("mavlink.command", COMMAND | {"on": "autopilot", "place": "onboard"}, "wifi", "proxy", "onboard"),
        ("link.drop", ON_LINK, "wifi", "gcs", "network"),
        ("link.drop", ON_LINK | {"place": "onboard"}, "wifi", "companion", "onboard"),
        ("link.drop", ON_LINK, "fixed", "companion", None),
        ("link.flood", ON_LINK, "wifi", "gcs", "network"),
        ("link.flood", ON_LINK | {"towards": "station"}, "wifi", "companion", "onboard"),
        ("link.flood", ON_LINK | {"towards": "station", "place": "network"}, "wifi", "gcs", "network"),
        ("link.flood", ON_LINK | {"towards": "station"}, "fixed", "companion", None),
        ("link.flood", ON_LINK | RADIO, "wifi", AIR, "air"),
        ("link.eavesdrop", ON_LINK | RADIO, "wifi", AIR, "air"),
        ("telemetry.position", ON_LINK | {"offset_m": [5.0, 0.0, 0.0]}, "wifi", "gcs", "network"),
        ("mavlink.mission_alter", {"vehicles": ["blue/b1"], "offset_m": [5.0, 0.0, 0.0]}, "wifi", "gcs", "network"),
        ("identity.silence_station", ON_LINK, "wifi", "gcs", "network"),
    ],
)
def test_a_tap_is_at_its_place_and_the_manifest_says_which(
    kind: str, params: dict[str, Any], channel: str, side: str, place: str | None
) -> None:
    sides, row = placed(kind, params, channel)
    assert sides == [side]
    role = "gcs" if params.get("on") is None else params["on"]
    assert row.get("places") == ({f"{role}:blue/b1": place} if place else None)


def test_the_manifest_has_the_radio_and_the_anchor_moves_it() -> None:
    scenario = attacked("mavlink.command", COMMAND | RADIO)
    assert build(scenario).header["attacks"][0]["radios"] == [{"endpoint": "x.radio", "at_enu_m": [10.0, 10.0, 2.0]}]
    start = scenario.operators[0].vehicles[0].start
    moved = scenario.attacks[0].model_copy(update={"anchor": "blue/b1"})
    row = build(scenario.model_copy(update={"attacks": (moved,)})).header["attacks"][0]
    assert row["radios"][0]["at_enu_m"] == [10.0 + start.east_m, 10.0 + start.north_m, 2.0]


@pytest.mark.parametrize(
    ("kind", "params", "channel", "expected"),
    [
        ("mavlink.command", COMMAND | RADIO, "fixed", r"fixed channel, which has no radio.*channel = \"wifi\""),
        ("mavlink.command", COMMAND | RADIO, "cellular", r"air, for the cellular link gcs:blue/b1.*encrypted"),
        ("mavlink.command", COMMAND | RADIO | {"on": "log"}, "wifi", r"air, for log:blue/b1.*only gcs links"),
        ("mavlink.command", COMMAND | {"place": "network", "on": "log"}, "wifi", r"only gcs links leave"),
        ("mavlink.command", COMMAND | {"place": "air"}, "wifi", r"radio_m.*position of the radio"),
        ("mavlink.command", COMMAND | RADIO | {"place": "network"}, "wifi", r"radio_m.*place network"),
        ("link.drop", ON_LINK | {"place": "air"}, "wifi", r"place"),
        ("link.drop", {"links": ["approval:blue"], "place": "onboard"}, "wifi", r"an end in an aircraft"),
        ("link.replay", ON_LINK | RADIO | {"drop_live": True}, "wifi", r"drop_live.*holds no frame"),
        ("identity.keep_alive", ON_LINK | RADIO, "wifi", r"cut.*holds no frame"),
    ],
)
def test_a_place_that_a_link_does_not_have_is_an_error(
    kind: str, params: dict[str, Any], channel: str, expected: str
) -> None:
    with pytest.raises(InputError, match=expected):
        build(attacked(kind, params, channel))


def test_the_place_of_every_attackers_radio_is_moved_by_an_anchor() -> None:
    fields = {name: AttackPlugin.find(name) for name in kinds(ATTACKS)}
    in_air = {name: plugin for name, plugin in fields.items() if "radio_m" in plugin.params.model_fields}
    assert "mavlink.command" in in_air
    assert [name for name, plugin in in_air.items() if "radio_m" not in plugin.places] == []


# ---------------------------------------------------------------- taps beside a link, in a kernel


@dataclass
class Whole:
    """A radio that loses nothing: 2 ms to the receiver; the first two frames it has decoded at 700 ms."""

    left: int = 2

    def open(self, direction: str) -> OpenChannel:
        return self

    def carry(self, now: Time, size: int, draws: Uniforms) -> tuple[Fate, Time, Time | None]:
        return (Fate.OVERFLOW if size > 5 else Fate.DELIVERED), now + 2 * MS, None

    def hear(self, direction: str, draw: float) -> Time | None:
        self.left -= 1
        return 700 * MS if self.left >= 0 else None


@dataclass
class Parrot:
    """Repeats the first frame that it hears, and answers the others as it is told."""

    link: str
    answer: Sequence[Verdict] = ()
    heard: list[tuple[Time, str]] = field(default_factory=list)

    def on_frame(self, now: Time, frame: Frame) -> Sequence[Verdict]:
        self.heard.append((now, frame.direction))
        if len(self.heard) > 1:
            return self.answer
        again = [Inject(payload, "fwd", frame.src, frame.dst, frame.id) for payload in (b"again", b"too much")]
        return [*again, Note("event.learned", self.link, {})]

    def next_wakeup(self) -> Time | None:
        return None

    def on_wakeup(self, now: Time) -> Sequence[Verdict]:
        return ()


def fly(answer: Sequence[Verdict] = (), *, muted: bool = False, taps: int = 1) -> tuple[Log, Kernel]:
    """The first 600 ms of traffic on one link with taps beside it."""
    links, routes = onboard("blue/b1", Channel(latency_ns=5 * MS))
    log, acts = Log(), [Act("x", muted=muted)] if taps else []
    make = partial(Parrot, answer=answer)
    kernel = Kernel(
        Wiring(
            seed=1,
            links=links,
            routes=routes,
            agents=[Station("blue", ["blue/b1"]), Fleet("fleet", ["blue/b1"])],
            taps=[TapPlacement("gcs:blue/b1", AIR, make, "x", radio=Whole()) for _ in range(taps)],
            acts=acts,
        ),
        [log],
    )
    kernel.advance(600 * MS)
    return log, kernel


def test_what_a_tap_in_the_air_injects_meets_its_radio_alone_and_is_recorded_with_its_fate() -> None:
    log, kernel = fly()
    kernel.advance(1200 * MS)
    kernel.finish()
    forged = [row for row in log.frames if row[3] == "x@gcs:blue/b1.air"]
    assert sorted((row[7], row[8], row[9]) for row in forged) == [
        (-1, "overflow", b"too much"), (702 * MS, "delivered", b"again"),
    ]  # fmt: skip
    assert [(label.action, label.actor) for label in log.labels] == [("inject", "x@gcs:blue/b1.air")] * 2
    assert any(row[9] == b"again" and row[1] == "log:blue/b1" for row in log.frames), "it is forwarded as any frame"


def test_a_muted_tap_in_the_air_changes_no_byte() -> None:
    logs = []
    for muted, taps in ((True, 1), (False, 0)):
        log, kernel = fly(muted=muted, taps=taps)
        kernel.advance(1200 * MS)
        kernel.finish()
        logs.append(sorted(log.frames))
        assert not log.labels
    assert logs[0] == logs[1]


def test_two_radios_decode_a_frame_at_one_time() -> None:
    log, kernel = fly(taps=2)
    kernel.advance(1200 * MS)
    kernel.finish()
    actors = {row[3] for row in log.frames if row[9] == b"again" and row[1] == "gcs:blue/b1"}
    assert actors == {"x@gcs:blue/b1.air", "x@gcs:blue/b1.air.1"}


@pytest.mark.parametrize("answer", [Drop(), Delay(NS_PER_S), Replace(b"other")])
def test_a_tap_in_the_air_cannot_hold_or_alter_a_frame(answer: Verdict) -> None:
    _, kernel = fly([answer])
    with pytest.raises(ComponentError, match=r"x@gcs:blue/b1\.air: answered a frame that its radio heard"):
        kernel.advance(1200 * MS)


def test_a_tap_in_the_air_needs_a_radio() -> None:
    links, routes = onboard("blue/b1")
    wiring = Wiring(seed=1, links=links, routes=routes, taps=[TapPlacement("gcs:*", AIR, Parrot)])
    with pytest.raises(InputError, match="a link over the air by its name, and its radio"):
        Kernel(wiring, [])
