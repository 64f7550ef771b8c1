"""Several defences on one aircraft: the flight goes on while nobody attacks, in whatever order they are declared."""

from __future__ import annotations

from itertools import permutations

import pytest

from skyrange.assembly.build import build
from skyrange.core.time import NS_PER_S
from skyrange.kernel import Kernel
from skyrange.record import MemoryObserver
from skyrange.scenario.toml_files import load_text

SQUARE = """
name = "several"
duration_s = 40
origin = [47.3977, 8.5456]
[[operators]]
id = "blue"
  [[operators.vehicles]]
  id = "b1"
  plan = { square = { side_m = 10, alt_m = 8 } }
"""
KINDS = ("mavlink.firewall", "mission.hash", "parameter.watch", "gnss.innovation")


def fly(kinds: tuple[str, ...]) -> MemoryObserver:
    tables = [f'[[defences]]\nid = "d{n}"\nkind = "{kind}"\n' for n, kind in enumerate(kinds)]
    seen = MemoryObserver()
    kernel = Kernel(build(load_text(SQUARE + "".join(tables))).wiring, [seen])
    kernel.advance(40 * NS_PER_S)
    kernel.finish()
    return seen


@pytest.mark.parametrize(
    "kinds",
    [KINDS, KINDS[::-1], *(pytest.param(kinds, marks=pytest.mark.slow) for kinds in permutations(KINDS[:3]))],
    ids="+".join,
)
def test_an_aircraft_with_several_defences_takes_off_and_raises_no_alarm(kinds: tuple[str, ...]) -> None:
    seen = fly(kinds)
    assert "event.takeoff" in {note.note.kind for note in seen.notes}
    assert [alert.alert.kind for alert in seen.alerts] == []
