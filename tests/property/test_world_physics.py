"""Does any command whatever keep the state sane and each aircraft to itself?"""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from skyrange.world import Body, Wind, World
from tests.tiers import examples

QUANTUM_NS = 2_500_000
Place = tuple[float, float, float, float]  # east, north, up, heading
Script = list[tuple[int, list[float]]]  # for how many ticks, and what the four motors are commanded
COMMAND = st.floats(-0.5, 1.5) | st.sampled_from([0.0, 1.0, float("nan"), float("inf"), 5e-324])
SCRIPT = st.lists(st.tuples(st.integers(1, 60), st.lists(COMMAND, min_size=4, max_size=4)), min_size=1, max_size=12)
PLACE = st.tuples(st.floats(-5e3, 5e3), st.floats(-5e3, 5e3), st.sampled_from([0.0, 0.3, 40.0]), st.floats(-720, 720))
WIND = st.tuples(st.floats(-25, 25), st.floats(-25, 25), st.floats(-3, 3))


def _play(worlds: list[World], script: Script) -> list[list[str]]:
    notes: list[list[str]] = [[] for _ in worlds]
    for world in worlds:
        world.advance(0)
    tick = 0
    for ticks, commands in script:
        tick += ticks
        for world, said in zip(worlds, notes, strict=True):
            world.actuate(slice(0, 1), np.array([commands]))
            said += [f"{note.kind} {note.about}" for note in world.advance(tick * QUANTUM_NS)]
    return notes


@settings(deadline=None, max_examples=examples(60))
@given(place=PLACE, wind=WIND, script=SCRIPT)
def test_state_stays_sane(place: Place, wind: tuple[float, float, float], script: Script) -> None:
    world = World([Body("blue/b1", "iris", *place)], wind=Wind(wind))
    (notes,) = _play([world], script)
    truth = {name: float(column[0]) for name, column in world.truth().items()}
    assert all(np.isfinite(value) for value in truth.values())
    assert abs(sum(truth[k] ** 2 for k in ("qw", "qx", "qy", "qz")) - 1.0) < 1e-12
    assert truth["up_m"] >= 0.0
    assert 0.0 <= truth["throttle"] <= 1.0
    assert truth["crashed"] == float("event.crash blue/b1" in notes)
    if truth["on_ground"]:
        assert truth["up_m"] == truth["vel_up_mps"] == 0.0


@settings(deadline=None, max_examples=30)
@given(place=PLACE, wind=WIND, script=SCRIPT, others=st.integers(1, 7))
def test_company_changes_no_bit(place: Place, wind: tuple[float, float, float], script: Script, others: int) -> None:
    body = Body("blue/b1", "iris", *place)
    company = [Body(f"blue/x{i}", "iris", 8e3 + 3.0 * i, 0.0, 5.0) for i in range(others)]
    alone, among = World([body], wind=Wind(wind)), World([body, *company], wind=Wind(wind))
    _play([alone, among], script)
    for name, column in alone.truth().items():
        assert column.tobytes() == among.truth()[name][:1].tobytes(), name
