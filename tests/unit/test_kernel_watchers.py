"""Does the kernel show the world to those who may see it, when they ask, and to nobody else?"""

from __future__ import annotations

from collections.abc import Sequence
from copy import deepcopy

import pytest

from skyrange.contracts.components import World as WorldContract
from skyrange.contracts.mailboxes import Inbox, Outbox
from skyrange.core.errors import InputError
from skyrange.core.ids import Port
from skyrange.core.time import NS_PER_MS, NS_PER_S, Time
from skyrange.kernel import Kernel, Wiring
from skyrange.world import Body, World


class Witness:
    """Writes down when it looked and what it saw, and when it was stepped."""

    service_ns: Time = 10 * NS_PER_MS
    ports: Sequence[Port] = ()

    def __init__(self, name: str = "witness", observe_period_ns: Time = 10 * NS_PER_MS) -> None:
        self.name = name
        self.observe_period_ns = observe_period_ns
        self.seen: list[tuple[Time, float]] = []
        self.steps: list[Time] = []

    def observe(self, now: Time, world: WorldContract) -> None:
        self.seen.append((now, float(world.truth()["up_m"][0])))

    def step(self, now: Time, inbox: Inbox) -> Outbox:
        self.steps.append(now)
        return Outbox()

    def next_wakeup(self) -> Time | None:
        return self.steps[-1] + self.observe_period_ns if self.steps else 0


def world() -> World:
    """One aircraft that falls from 100 m."""
    return World([Body("a/b", "iris", 0.0, 0.0, 100.0)])


def test_it_looks_at_each_multiple_of_its_period_after_the_worlds_tick_and_before_it_is_stepped() -> None:
    witness = Witness()
    kernel = Kernel(Wiring(seed=1, links=(), truth_subscribers=[witness], world=world()))
    kernel.advance(NS_PER_S)
    assert [at for at, _ in witness.seen] == [n * witness.observe_period_ns for n in range(101)]
    assert witness.steps == [at for at, _ in witness.seen]
    fallen = [100.0 - up for _, up in witness.seen]
    assert fallen == sorted(fallen)
    assert fallen[-1] > 1.0


def test_a_fork_looks_on_with_its_own_copy() -> None:
    witness = Witness()
    kernel = Kernel(Wiring(seed=1, links=(), truth_subscribers=[witness], world=world()))
    kernel.advance(NS_PER_S // 2)
    before = deepcopy(witness.seen)
    twin = kernel.fork([])
    twin.advance(NS_PER_S)
    assert witness.seen == before
    kernel.advance(NS_PER_S)
    assert len(witness.seen) == 101


@pytest.mark.parametrize("observe_period_ns", [0, -1, 4 * NS_PER_MS])
def test_a_period_that_is_not_of_whole_ticks_is_refused(observe_period_ns: Time) -> None:
    with pytest.raises(InputError, match=r"witness\.observe_period_ns"):
        Kernel(
            Wiring(seed=1, links=(), truth_subscribers=[Witness(observe_period_ns=observe_period_ns)], world=world())
        )


def test_without_a_world_there_is_nothing_to_see() -> None:
    with pytest.raises(InputError, match="whole ticks of a world"):
        Kernel(Wiring(seed=1, links=(), truth_subscribers=[Witness()]))
