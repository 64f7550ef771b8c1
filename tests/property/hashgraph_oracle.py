"""Consensus order of a set of events, straight from the definitions: slow, and without any state.

Baird, The Swirlds Hashgraph Consensus Algorithm (2016), ch. 5; forks and unique famous witnesses after Crary, arXiv
2102.01167.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

from skyrange.utm.hashgraph.events import NO_PARENT, Event
from skyrange.utm.hashgraph.graph import COIN_ROUNDS


class Oracle:
    """What the definitions say about some events, which contain all their ancestors."""

    def __init__(self, stakes: Mapping[str, int], events: Sequence[Event]) -> None:
        self.stakes = stakes
        self.total = sum(stakes.values())
        self.known = {event.hash: event for event in events}
        self.parents = lru_cache(None)(self._parents)
        self.ancestors = lru_cache(None)(self._ancestors)
        self.self_ancestors = lru_cache(None)(self._self_ancestors)
        self.sees = lru_cache(None)(self._sees)
        self.strongly_sees = lru_cache(None)(self._strongly_sees)
        self.round = lru_cache(None)(self._round)
        self.vote = lru_cache(None)(self._vote)
        self.witnesses: dict[int, list[bytes]] = {}
        for event in events:
            first = event.self_parent == NO_PARENT
            if first or self.round(event.hash) > self.round(event.self_parent):
                self.witnesses.setdefault(self.round(event.hash), []).append(event.hash)

    def _parents(self, x: bytes) -> tuple[bytes, ...]:
        event = self.known[x]
        return tuple(parent for parent in (event.self_parent, event.other_parent) if parent != NO_PARENT)

    def _ancestors(self, x: bytes) -> frozenset[bytes]:
        """The event itself among them."""
        return frozenset({x}).union(*(self.ancestors(parent) for parent in self.parents(x)))

    def _self_ancestors(self, x: bytes) -> frozenset[bytes]:
        parent = self.known[x].self_parent
        return frozenset({x}) | (self.self_ancestors(parent) if parent != NO_PARENT else frozenset())

    def forked(self, x: bytes, member: str) -> bool:
        """Whether two ancestors of x by `member` are no self-ancestors of each other."""
        mine = [y for y in self.ancestors(x) if self.known[y].creator == member]
        return any(
            y not in self.self_ancestors(z) and z not in self.self_ancestors(y)
            for k, y in enumerate(mine)
            for z in mine[:k]
        )

    def _sees(self, x: bytes, y: bytes) -> bool:
        return y in self.ancestors(x) and not self.forked(x, self.known[y].creator)

    def _strongly_sees(self, x: bytes, y: bytes) -> bool:
        members = {self.known[z].creator for z in self.ancestors(x) if self.sees(x, z) and self.sees(z, y)}
        return self.sees(x, y) and self.many(members)

    def many(self, members: set[str]) -> bool:
        return 3 * sum(self.stakes[member] for member in members) > 2 * self.total

    def creators(self, events: Sequence[bytes]) -> set[str]:
        return {self.known[x].creator for x in events}

    def _round(self, x: bytes) -> int:
        parents = self.parents(x)
        if not parents:
            return 0
        r = max(map(self.round, parents))
        below = [
            y
            for y in self.ancestors(x) - {x}
            if self.round(y) == r
            and (self.known[y].self_parent == NO_PARENT or self.round(self.known[y].self_parent) < r)
            and self.strongly_sees(x, y)
        ]
        return r + self.many(self.creators(below))

    def _vote(self, x: bytes, y: bytes) -> tuple[bool, bool]:
        """The vote of a witness x on the fame of y, and whether it decides."""
        distance = self.round(x) - self.round(y)
        if distance == 1:
            return self.sees(x, y), False
        voters = [z for z in self.witnesses[self.round(x) - 1] if self.strongly_sees(x, z)]
        yes = self.creators([z for z in voters if self.vote(z, y)[0]])
        no = self.creators([z for z in voters if not self.vote(z, y)[0]])
        stake_yes, stake_no = (sum(self.stakes[member] for member in each) for each in (yes, no))
        supported = self.many(yes) or self.many(no)
        if distance % COIN_ROUNDS == 0 and not supported:
            signature = self.known[x].signature or x
            return bool(signature[len(signature) // 2] & 1), False
        return stake_yes >= stake_no, supported and distance % COIN_ROUNDS != 0

    def famous(self, y: bytes) -> bool | None:
        """Whether a witness is famous; `None` while that is not decided."""
        decided = set()
        for r in range(self.round(y) + 2, max(self.witnesses) + 1):
            for x in self.witnesses.get(r, []):
                vote, decides = self.vote(x, y)
                if decides:
                    decided.add(vote)
        assert len(decided) < 2, "two witnesses decide differently"
        return decided.pop() if decided else None

    def order(self) -> list[tuple[bytes, int, int]]:
        """(hash, round received, consensus time) of the events whose order is final."""
        found: list[tuple[bytes, int, int]] = []
        done: set[bytes] = set()
        for r in range(max(self.witnesses) - 1):
            fame = {y: self.famous(y) for y in self.witnesses[r]}
            if None in fame.values():
                break
            famous = [y for y in self.witnesses[r] if fame[y]]
            creators = [self.known[y].creator for y in famous]
            judges = [y for y in famous if creators.count(self.known[y].creator) == 1]
            if not judges:
                continue
            received = set.intersection(*(set(self.ancestors(y)) for y in judges)) - done
            white = 0
            for y in judges:
                white ^= int.from_bytes(y, "big")
            rows = []
            for x in received:
                times = sorted((self.heard(y, x), self.stakes[self.known[y].creator]) for y in judges)
                half = sum(stake for _, stake in times)
                time = next(
                    when for k, (when, _) in enumerate(times) if 2 * sum(stake for _, stake in times[: k + 1]) >= half
                )
                rows.append((time, int.from_bytes(x, "big") ^ white, x))
            found += [(x, r, time) for time, _, x in sorted(rows)]
            done |= received
        return found

    def heard(self, y: bytes, x: bytes) -> int:
        """The time of the first self-ancestor of y that descends from x."""
        return min(
            (len(self.self_ancestors(z)), self.known[z].time) for z in self.self_ancestors(y) if x in self.ancestors(z)
        )[1]
