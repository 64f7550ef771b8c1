"""Does an aircraft with any two defences, in any order that is not refused, fly its plan without an alarm?

A fleet flies at once, and each aircraft has a pair of its own. What a pair does is known from the names of its alarms.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations

import pytest

from skyrange.assembly.acts import defences
from skyrange.assembly.build import build
from skyrange.contracts.plugins.registry import DEFENCES, kinds
from skyrange.core.errors import InputError
from skyrange.core.time import NS_PER_S
from skyrange.defence.contract import DefencePlugin
from skyrange.kernel import Kernel
from skyrange.record import MemoryObserver
from skyrange.scenario.toml_files import load_text
from tests.tiers import examples

pytestmark = pytest.mark.slow

Variant = tuple[str, str]
"""A kind, and the parameters in which it is not what its name says."""
GNSS: list[Variant] = [(kind, 'action = "reject"') for kind in ("gnss.barometer", "gnss.innovation", "gnss.receiver")]
ON_LINKS: list[Variant] = [
    ("mavlink.firewall", ""),
    ("mavlink.firewall", 'at = "proxy"'),
    ("mavlink.sequence", "drop = true"),
    ("mavlink.signing", ""),
    ("mission.hash", ""),
    ("mission.hash", 'at = "proxy"'),
    ("mission.read_back", "every_s = 2"),
    ("parameter.watch", ""),
    ("parameter.watch", 'at = "companion"'),
]
ON_BROADCASTS: list[Variant] = [
    (kind, "")
    for kind in ("remote_id.appearance", "remote_id.drip", "remote_id.motion", "remote_id.replay", "remote_id.signal")
]
SHARED = {
    "control_link.channel_change": ON_LINKS,
    "gnss.integrity": GNSS,
    "gnss.multi_receiver": ON_LINKS,
    "remote_id.ground": ON_BROADCASTS,
}
"""Kinds that are about the links or the receivers of all aircraft, and what they share them with."""
PLACES = {"sensors": GNSS, "links": ON_LINKS, "broadcasts": ON_BROADCASTS}
"""Kinds that may share a place; those of two places have nothing in common."""
CHUNKS = 4
LOSSY = "loss = 0.05\nlatency_ms = 30\njitter_ms = 20\n"
VERY_LOSSY = "loss = 0.25\nlatency_ms = 30\njitter_ms = 20\n"
RECEIVERS = "".join(
    f'[[radio.receivers]]\nid = "r{n}"\noperator = "blue"\nplace = {place}\n'
    for n, place in enumerate(([-60, 0, 6], [160, 0, 6], [0, 160, 6]))
)


def duration_s() -> int:
    """Long enough for all aircraft to land; the fast tier has fewer pairs, of which none is so late."""
    return 37 if examples(CHUNKS) < CHUNKS else 40


def scenario(count: int, channel: str, more: str, radio: bool = False) -> str:
    """Aircraft blue/b1 … that fly ten metres and land, 15 m apart."""
    fleet = "".join(
        f"""
  [[operators.vehicles]]
  id = "b{n + 1}"
  start = [{n % 10 * 15}, {n // 10 * 15}]
  plan = {{ path = {{ points = [[0, 0], [0, 10]], alt_m = 5 }}, speed_mps = 5, end = "land" }}
"""
        for n in range(count)
    )
    head = f'name = "pairs"\nseed = 5\nduration_s = {duration_s()}\norigin = [47.3977, 8.5456]\n'
    head += f"[radio]\n{RECEIVERS}" if radio else ""
    signs = 'remote_id = { auth = "drip" }\n' if radio else ""
    return f'{head}[[links]]\nmatch = "gcs:*"\n{channel}[[operators]]\nid = "blue"\n{signs}{fleet}{more}'


def declare(number: int, place: str, variant: Variant) -> str:
    """A defence of aircraft b`number` + 1."""
    kind, params = variant
    params = f'vehicles = ["blue/b{number + 1}"]{", " if params else ""}{params}'
    return f'[[defences]]\nid = "{place}_b{number + 1}"\nkind = "{kind}"\nparams = {{ {params} }}\n'


def fly(text: str, count: int) -> tuple[dict[str, str], set[str]]:
    """What went wrong: alarms by the defence that raised them, and the aircraft that did not land by themselves."""
    seen = MemoryObserver()
    kernel = Kernel(build(load_text(text)).wiring, [seen])
    kernel.advance(duration_s() * NS_PER_S)
    kernel.finish()
    landed = {note.note.about for note in seen.notes if note.note.kind == "event.landed"}
    return {one.detector: one.alert.kind for one in seen.alerts}, {f"blue/b{n + 1}" for n in range(count)} - landed


def is_refused(pair: Sequence[Variant]) -> bool:
    """Whether two defences in this order are an error before the run."""
    tables = "".join(declare(0, f"d{n}", one) for n, one in enumerate(pair))
    return is_wrong(scenario(1, "", tables, pair[0] in ON_BROADCASTS))


def is_wrong(text: str) -> bool:
    """Whether a scenario is an error before the run."""
    try:
        build(load_text(text))
    except InputError:
        return True
    return False


def test_every_kind_is_flown() -> None:
    shipped = {kind for kind in kinds(DEFENCES) if " in skyrange." in DefencePlugin.find(kind).source}
    assert {kind for place in PLACES.values() for kind, _ in place} | set(SHARED) == shipped


@pytest.mark.parametrize("place", PLACES)
def test_pairs_fly_and_raise_no_alarm(place: str) -> None:
    accepted = [pair for pair in permutations(PLACES[place], 2) if not is_refused(pair)]
    for chunk in range(examples(CHUNKS)):
        pairs = accepted[chunk::CHUNKS]
        tables = [declare(n, name, one) for n, pair in enumerate(pairs) for name, one in zip("xy", pair, strict=True)]
        text = scenario(len(pairs), LOSSY, "".join(tables), place == "broadcasts")
        assert fly(text, len(pairs)) == ({}, set()), pairs


def test_pairs_that_are_refused_disturb_each_other(monkeypatch: pytest.MonkeyPatch) -> None:
    refused = [pair for pair in permutations(ON_LINKS, 2) if pair[0][0] != pair[1][0] and is_refused(pair)]
    pairs = refused[:: CHUNKS // examples(CHUNKS)]
    monkeypatch.setattr(defences, "check_paths", lambda declared, signing: ())
    tables = [declare(n, name, one) for n, pair in enumerate(pairs) for name, one in zip("xy", pair, strict=True)]
    alarms, down = fly(scenario(len(pairs), VERY_LOSSY, "".join(tables)), len(pairs))
    disturbed = {f"blue/{name[2:]}" for name in alarms} | down
    assert disturbed == {f"blue/b{n + 1}" for n in range(len(pairs))}, pairs


@pytest.mark.parametrize("shared", SHARED)
def test_kinds_for_all_aircraft_go_with_every_other(shared: str) -> None:
    others = SHARED[shared][:: CHUNKS // examples(CHUNKS)]
    own = "".join(declare(n, "x", one) for n, one in enumerate(others))
    table = f'[[defences]]\nid = "shared"\nkind = "{shared}"\n'
    channel = 'channel = "wifi"\n' if shared == "control_link.channel_change" else ""
    texts = [scenario(len(others), channel, tables, radio=True) for tables in (f"{own}{table}", f"{table}{own}")]
    accepted = [text for text in texts if not is_wrong(text)]
    # in the other order what a kind sends or reads may be refused, as before signing or after a check of fixes
    assert texts[1 if shared == "gnss.integrity" else 0] in accepted
    for text in accepted[: examples(2)]:
        assert fly(text, len(others)) == ({}, set())
