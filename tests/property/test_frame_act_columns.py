"""Acts on blocks of frames against the same acts on one frame after the other: verdicts, times and what they keep."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

import skyrange.plugin as sky
from skyrange.attack.bases.frame_acts import RowVerdicts
from skyrange.attack.bases.links import OnLinks
from skyrange.contracts.frames import DirectedLinkName, Fate, FrameBlock, LinkTable, Payloads
from skyrange.contracts.verdicts import Delay, Drop, Inject
from skyrange.core.chance import Chance
from skyrange.core.time import NEVER, NS_PER_S, Time
from tests.registered_kinds import registered
from tests.unit.test_attack_link import LINK, context

with registered():

    @sky.attack("test.any_drop", technique="T0814")
    class AnyDrop(sky.OnLinks):
        """Drops frames."""

        share: sky.Number = sky.param("Probability.")
        act = sky.drop("share")

    @sky.attack("test.any_delay", technique="T0830")
    class AnyDelay(sky.OnLinks):
        """Delays frames."""

        delay_s: sky.Number = sky.param("Delay in seconds.")
        jitter_s: sky.Number = sky.param("Longest extra delay in seconds.")
        act = sky.delay("delay_s", "jitter_s")

    @sky.attack("test.any_duplicate", technique="T0830")
    class AnyDuplicate(sky.OnLinks):
        """Copies frames."""

        share: sky.Number = sky.param("Probability.")
        copies: sky.Whole = sky.param("Number of copies.")
        after_s: sky.Number = sky.param("Time between copies in seconds.")
        act = sky.duplicate("copies", "after_s", "share")


NAMES = [
    DirectedLinkName(f"gcs:blue/b{number}", direction, source, "there")
    for number in (1, 2)
    for direction in ("fwd", "rev")
    for source in ("here", "relay")
]
SHARES = st.floats(0.01, 1.0) | st.just(1.0)
SPANS = st.floats(0.0, 3.0) | st.just(0.0)
KINDS: st.SearchStrategy[tuple[Any, dict[str, Any]]] = st.one_of(
    st.tuples(st.just(AnyDrop), st.fixed_dictionaries({"share": SHARES})),
    st.tuples(st.just(AnyDelay), st.fixed_dictionaries({"delay_s": SPANS, "jitter_s": SPANS})),
    st.tuples(
        st.just(AnyDuplicate),
        st.fixed_dictionaries({"share": SHARES, "copies": st.integers(1, 3), "after_s": st.floats(0.001, 2.0)}),
    ),
)
ROWS = st.lists(st.tuples(st.integers(0, len(NAMES) - 1), st.integers(0, 2**40), st.binary(max_size=20)), max_size=12)
BLOCKS = st.lists(st.tuples(st.integers(0, 3 * NS_PER_S), st.integers(0, NS_PER_S), ROWS), max_size=6)
"""Time since the block before, age of the frames, and their links, serials and payloads."""


def block_of(sent_ns: Time, rows: list[tuple[int, int, bytes]]) -> FrameBlock:
    numbers, serials = (np.array([row[place] for row in rows], dtype=np.int64) for place in (0, 1))
    table = LinkTable(NAMES, np.zeros(len(NAMES), dtype=np.int64))
    return FrameBlock(
        table, numbers, serials, sent_ns, sent_ns, Fate.DELIVERED, payloads=Payloads.of([row[2] for row in rows])
    )


def made(kind: Any, params: dict[str, Any], seed: int, sham: bool) -> OnLinks:
    own = replace(context(sham=sham), chance=Chance(seed))
    (placement,) = kind.plugin(kind.params_model.model_validate({"links": [LINK], **params}), own).taps
    tap = placement.make(LINK)
    assert isinstance(tap, OnLinks)
    return tap


def answer_one_by_one(tap: OnLinks, now: Time, block: FrameBlock) -> tuple[list[bool], list[Time], list[set[Time]]]:
    """By frame: whether it is dropped, until when it is held, and when copies of it are due."""
    dropped, until, copies = [], [], []
    for frame in block.frames():
        before = tap.waiting_frames.added
        verdicts = tap.act(now, frame)
        dropped.append(Drop() in verdicts)
        until.append(next((verdict.until for verdict in verdicts if isinstance(verdict, Delay)), NEVER))
        copies.append({due for due, number, _ in tap.waiting_frames.heap if number >= before})
    return dropped, until, copies


def waiting(tap: OnLinks) -> list[tuple[Time, int, Inject]]:
    return sorted(tap.waiting_frames.heap, key=lambda one: one[:2])


@given(KINDS, BLOCKS, st.integers(0, 2**64 - 1), st.booleans())
def test_a_block_is_answered_as_its_frames_are(
    kind: tuple[Any, dict[str, Any]], blocks: list[Any], seed: int, sham: bool
) -> None:
    single, batch = made(*kind, seed, sham), made(*kind, seed, sham)
    now: Time = 0
    for gap, age, rows in blocks:
        now += gap
        block = block_of(now - age, rows)
        found: RowVerdicts = kind[0].act.columns(batch, now, block)
        dropped, until, copies = answer_one_by_one(single, now, block)
        assert found.dropped.tolist() == dropped
        assert found.until_ns.tolist() == until
        assert [set(row) - {NEVER} for row in found.copies_ns.tolist()] == copies
        assert batch.delayed_until == single.delayed_until
        assert waiting(batch) == waiting(single)


@given(ROWS, st.integers(0, 2**64 - 1))
def test_rows_have_the_draws_of_their_frames(rows: list[tuple[int, int, bytes]], seed: int) -> None:
    tap, block = made(AnyDrop, {"share": 1.0}, seed, False), block_of(NS_PER_S, rows)
    assert [tuple(row) for row in tap.draws(block).tolist()] == [tap.draw(frame) for frame in block.frames()]
