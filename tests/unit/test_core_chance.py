"""Addressed chance equals numpy's Philox and does not depend on how it is called."""

from __future__ import annotations

import numpy as np
import pytest

from skyrange.core.chance import Chance, philox, uniform4
from skyrange.core.compiled import compiled
from skyrange.core.ids import hash64


@pytest.mark.parametrize(
    ("key", "counter"),
    [((5, 9), (1, 2, 3, 4)), ((2**64 - 1, 2**63), (2**64 - 2, 2**64 - 1, 0, 7)), ((0, 0), (0, 0, 0, 0))],
)
def test_philox_equals_numpys(key: tuple[int, int], counter: tuple[int, int, int, int]) -> None:
    # numpy increments the 256-bit counter before its first block
    reference = np.random.Philox(key=np.array(key, dtype=np.uint64), counter=np.array(counter, dtype=np.uint64))
    value = (sum(c << (64 * i) for i, c in enumerate(counter)) + 1) % 2**256
    words = [np.uint64((value >> (64 * i)) & (2**64 - 1)) for i in range(4)]
    assert list(philox(np.uint64(key[0]), np.uint64(key[1]), *words)) == list(reference.random_raw(4))


def test_known_answer_of_the_published_library() -> None:
    # Random123's kat_vectors, philox4x64 10 rounds, counter and key all zero
    zero = np.uint64(0)
    assert [int(w) for w in philox(zero, zero, zero, zero, zero, zero)] == [
        0x16554D9ECA36314C,
        0xDB20FE9D672D0FDC,
        0xD7E772CEE186176B,
        0x7E68B68AEC7BA23B,
    ]


@compiled
def _inside(seed: np.uint64, stream: np.uint64, who: np.uint64, when: np.uint64) -> float:
    return uniform4(seed, stream, who, when, np.uint64(0))[0]


def test_scalar_array_and_kernel_callers_agree_to_the_bit() -> None:
    chance = Chance(77)
    who = np.array([hash64(f"v{i}") for i in range(50)], dtype=np.uint64)
    when = np.arange(-25, 25, dtype=np.int64) * 1_000_003
    k = np.arange(50, dtype=np.uint64) % 3
    table = chance.uniforms("gnss", who, when, k)
    for i in range(50):
        assert tuple(table[i]) == chance.uniform4("gnss", int(who[i]), int(when[i]), int(k[i]))
    direct = _inside(np.uint64(77), np.uint64(hash64("gnss")), who[0], np.uint64(int(when[0]) & (2**64 - 1)))
    assert direct == table[0, 0]


def test_every_part_of_the_address_counts() -> None:
    base = Chance(1).uniform4("a", 2, 3, 4)
    others = [
        Chance(2).uniform4("a", 2, 3, 4),
        Chance(1).uniform4("b", 2, 3, 4),
        Chance(1).uniform4("a", 3, 3, 4),
        Chance(1).uniform4("a", 2, 4, 4),
        Chance(1).uniform4("a", 2, 3, 5),
    ]
    assert len({base, *others}) == 6


def test_uniforms_are_uniform() -> None:
    n = 20_000
    table = Chance(9).uniforms(
        "u", np.full(n, 1, dtype=np.uint64), np.arange(n, dtype=np.int64), np.zeros(n, dtype=np.uint64)
    )
    assert table.min() >= 0.0
    assert table.max() < 1.0
    counts = np.histogram(table.ravel(), bins=20, range=(0.0, 1.0))[0]
    expected = 4 * n / 20
    # chi-square with 19 degrees of freedom: 43.8 is its 99.9 % point; the draw is fixed, so this never flickers
    assert float((((counts - expected) ** 2) / expected).sum()) < 43.8
