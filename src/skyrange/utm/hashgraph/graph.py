"""Graph of the events that one member knows, and their consensus order: rounds, witnesses, fame, time.

Virtual voting after Baird, The Swirlds Hashgraph Consensus Algorithm (2016, ch. 5), with stake instead of heads, in the
form that Crary proved (Verifying the Hashgraph Consensus Algorithm, arXiv 2102.01167): an event is *seen* only if no
fork of its creator is known, a supermajority is more than two thirds of all stake, and of two famous witnesses of one
member neither is unique. Members of which less than a third of the stake is byzantine compute the same order.

All that is computed of an event depends on its ancestors alone, so that it is the same wherever the event is known.
State is lists of numbers and bytes, by the index at which an event was added.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from skyrange.core.time import Time
from skyrange.utm.hashgraph.events import NO_PARENT, Event

COIN_ROUNDS: Final = 10
"""Every so many rounds of an election votes that no supermajority supports are drawn (Baird's c)."""
_NONE: Final = -1


_DISTANCES: Final = (1, 4, 16, 64, 256, 1_024)
"""Distances of self-ancestors that a member tells: what is sent in vain is at most four times what is missing."""


class GraphError(ValueError):
    """An event that cannot be added: a parent is unknown or wrong, or its creator is no member."""


class UnknownParentError(GraphError):
    """An event whose parents are not known, as when a message before it was lost."""


@dataclass(frozen=True, slots=True)
class Fork:
    """Two events of one member with the same self-parent: proof that it equivocates, since it has signed both."""

    member: str
    first: Event
    second: Event


class Ordered(NamedTuple):
    """An event with its place in the consensus order."""

    event: Event
    round: int
    """The round in which it was received."""
    time: Time
    """Median of the times at which members, by their own clocks, had received it."""


class Hashgraph:
    """The graph of one member. `add` takes events, `ordered` lists those whose order is final. Deep-copyable."""

    def __init__(self, stakes: Mapping[str, int]) -> None:
        """`stakes`: the members with their stakes, the same for all. Raises `ValueError` where the total is 0."""
        self.members: tuple[str, ...] = tuple(sorted(stakes))
        self._stakes = [stakes[member] for member in self.members]
        self._total = sum(self._stakes)
        if self._total <= 0 or min(self._stakes) < 0:
            raise ValueError(f"stakes of a hashgraph must be at least 0 and not all 0, got {dict(stakes)}")
        self._number = {member: number for number, member in enumerate(self.members)}
        self.events: list[Event] = []
        """Every event, parents before children."""
        self.ordered: list[Ordered] = []
        """The events in consensus order, as far as it is final."""
        self.forks: list[Fork] = []
        """One proof for each member that was found to equivocate."""
        self._index: dict[bytes, int] = {}
        self._creator: list[int] = []
        self._self_parent: list[int] = []
        self._other_parent: list[int] = []
        self._height: list[int] = []
        """How many self-ancestors each has."""
        self._tips: list[tuple[int, ...]] = []
        """By member: the newest of its events that each descends from; any of them where it knows of a fork."""
        self._forked: list[int] = []
        """Members of whose forks each knows, as bits."""
        self._round: list[int] = []
        self._witnesses: list[list[int]] = []
        """By round."""
        self._famous: dict[int, bool] = {}
        self._votes: dict[tuple[int, int], bool] = {}
        self._received: set[int] = set()
        self._next_round = 0
        """The first round whose fame is not decided."""
        self._children: dict[tuple[int, int], int] = {}
        """By self-parent and member: the first event."""
        self._forkers: set[int] = set()
        self._latest: list[int] = [_NONE] * len(self.members)
        self._chains: list[list[int]] = [[] for _ in self.members]
        """By member: its events by height, of one that does not fork."""
        self._heads: set[int] = set()

    def __contains__(self, event: bytes) -> bool:
        """Whether the event with this hash is known."""
        return event in self._index

    def __len__(self) -> int:
        return len(self.events)

    def latest(self, member: str) -> Event | None:
        """The event of a member that was added last."""
        index = self._latest[self._number[member]]
        return None if index == _NONE else self.events[index]

    @property
    def known(self) -> list[bytes]:
        """What another member has to know to tell what is missing here.

        These are the events without a self-child, of all members, and some of their self-ancestors, at distances that
        grow: the other member may not know the newest ones.
        """
        hashes = []
        for head in sorted(self._heads):
            hashes.append(self.events[head].hash)
            for distance in _DISTANCES:
                if distance > self._height[head]:
                    break
                hashes.append(self.events[self._self_ancestor(head, distance)].hash)
        return hashes

    def _self_ancestor(self, index: int, distance: int) -> int:
        """The self-ancestor of an event at a distance that is at most its height."""
        member = self._creator[index]
        if member not in self._forkers:
            return self._chains[member][self._height[index] - distance]
        for _ in range(distance):
            index = self._self_parent[index]
        return index

    def missing(self, known_there: Sequence[bytes]) -> list[Event]:
        """The events that a member which has told what is `known` there may not know, parents before children."""
        known = [self._index[hash_] for hash_ in known_there if hash_ in self._index]
        tips_by_member: dict[int, list[int]] = {}
        for index in known:
            tips_by_member.setdefault(self._creator[index], []).append(index)

        def is_known(index: int) -> bool:
            return any(self._is_self_ancestor(index, tip) for tip in tips_by_member.get(self._creator[index], ()))

        unknown_there: set[int] = set()
        waiting = list(self._heads)
        while waiting:
            at = waiting.pop()
            if at == _NONE or at in unknown_there or is_known(at):
                continue
            unknown_there.add(at)
            waiting += [self._self_parent[at], self._other_parent[at]]
        return [self.events[index] for index in sorted(unknown_there)]

    def round_of(self, event: bytes) -> int:
        """The round in which an event was created."""
        return self._round[self._index[event]]

    # --- adding --------------------------------------------------------------------------------------------

    def add(self, event: Event) -> bool:
        """Add an event, and extend the order; false if it is known. Raises `GraphError` for one that does not fit.

        Its signature must have been checked.
        """
        if event.hash in self._index:
            return False
        member, self_parent, other_parent = self._check(event)
        index = len(self.events)
        self.events.append(event)
        self._index[event.hash] = index
        self._creator.append(member)
        self._self_parent.append(self_parent)
        self._other_parent.append(other_parent)
        self._height.append(0 if self_parent == _NONE else self._height[self_parent] + 1)
        self._find_fork(index, member, self_parent)
        self._merge(index, member, self_parent, other_parent)
        self._latest[member] = index
        if member not in self._forkers:
            self._chains[member].append(index)
        self._heads.discard(self_parent)
        self._heads.add(index)
        self._assign_round(index, self_parent, other_parent)
        self._order_decided_rounds()
        return True

    def _check(self, event: Event) -> tuple[int, int, int]:
        member = self._number.get(event.creator)
        if member is None:
            raise GraphError(f"{event.creator!r} is no member")
        if event.self_parent == NO_PARENT and event.other_parent == NO_PARENT:
            return member, _NONE, _NONE
        parents = []
        for name, parent in (("self-parent", event.self_parent), ("other-parent", event.other_parent)):
            if parent not in self._index:
                raise UnknownParentError(f"the {name} of an event of {event.creator} is not known")
            parents.append(self._index[parent])
        if self._creator[parents[0]] != member or self._creator[parents[1]] == member:
            raise GraphError(f"the parents of an event of {event.creator} are not one of its own and one of another")
        return member, parents[0], parents[1]

    def _find_fork(self, index: int, member: int, self_parent: int) -> None:
        first = self._children.setdefault((self_parent, member), index)
        if first != index and member not in self._forkers:
            self._forkers.add(member)
            self.forks.append(Fork(self.members[member], self.events[first], self.events[index]))

    def _merge(self, index: int, member: int, self_parent: int, other_parent: int) -> None:
        """The newest events that it descends from, and the forks that it knows of."""
        tips, forked = [_NONE] * len(self.members), 0
        if self_parent != _NONE:
            own_tips, other_tips = self._tips[self_parent], self._tips[other_parent]
            forked = self._forked[self_parent] | self._forked[other_parent]
            for number, (tip, other_tip) in enumerate(zip(own_tips, other_tips, strict=True)):
                if other_tip == _NONE or (tip != _NONE and self._is_self_ancestor(other_tip, tip)):
                    tips[number] = tip
                elif tip == _NONE or self._is_self_ancestor(tip, other_tip):
                    tips[number] = other_tip
                else:
                    tips[number], forked = tip, forked | 1 << number
            if tips[member] != self_parent:  # it descends from an event of its own that its self-parent does not
                forked |= 1 << member
        tips[member] = index
        self._tips.append(tuple(tips))
        self._forked.append(forked)

    def _is_self_ancestor(self, ancestor: int, descendant: int) -> bool:
        """Whether `ancestor` is `descendant` or a self-ancestor of it; both are of one member."""
        if self._creator[ancestor] not in self._forkers:
            return self._height[ancestor] <= self._height[descendant]
        while self._height[descendant] > self._height[ancestor]:
            descendant = self._self_parent[descendant]
        return ancestor == descendant

    # --- seeing --------------------------------------------------------------------------------------------

    def _sees(self, index: int, event: int) -> bool:
        """Whether `event` is an ancestor of the event `index`, which knows of no fork of its creator."""
        member = self._creator[event]
        if self._forked[index] >> member & 1:
            return False
        tip = self._tips[index][member]
        return tip != _NONE and self._is_self_ancestor(event, tip)

    def _strongly_sees(self, index: int, event: int) -> bool:
        """Whether events by a supermajority, which the event `index` sees, see `event`, and it sees `event` itself.

        It is enough to look at the newest event of each member: they know of no fork that `index` does not know of.
        """
        if not self._sees(index, event):
            return False
        forked, stake = self._forked[index], 0
        for member, tip in enumerate(self._tips[index]):
            if tip != _NONE and not forked >> member & 1 and self._sees(tip, event):
                stake += self._stakes[member]
        return self._is_supermajority(stake)

    def _is_supermajority(self, stake: int) -> bool:
        return 3 * stake > 2 * self._total

    def _stake_of(self, events: Sequence[int]) -> int:
        """The stake of the members that have created some events."""
        return sum(self._stakes[member] for member in {self._creator[event] for event in events})

    # --- rounds and fame -----------------------------------------------------------------------------------

    def _assign_round(self, index: int, self_parent: int, other_parent: int) -> None:
        if self_parent == _NONE:
            number = 0
        else:
            number = max(self._round[self_parent], self._round[other_parent])
            strongly_seen = [witness for witness in self._witnesses[number] if self._strongly_sees(index, witness)]
            number += self._is_supermajority(self._stake_of(strongly_seen))
        self._round.append(number)
        if self_parent == _NONE or number > self._round[self_parent]:
            while len(self._witnesses) <= number:
                self._witnesses.append([])
            self._witnesses[number].append(index)
            self._hold_votes(index, number)

    def _hold_votes(self, voter: int, number: int) -> None:
        """The votes of a new witness on the fame of earlier ones, and the elections that it decides."""
        if number == 0:
            return
        seen_before = [witness for witness in self._witnesses[number - 1] if self._strongly_sees(voter, witness)]
        for round_ in range(self._next_round, number):
            for candidate in self._witnesses[round_]:
                self._vote(voter, candidate, number - round_, seen_before)

    def _vote(self, voter: int, candidate: int, distance: int, seen_before: Sequence[int]) -> None:
        if distance == 1:
            self._votes[voter, candidate] = self._sees(voter, candidate)
            return
        # a witness that was added after the voters' votes were cast was seen by none of them
        yes = self._stake_of([witness for witness in seen_before if self._votes.get((witness, candidate), False)])
        no = self._stake_of([witness for witness in seen_before if not self._votes.get((witness, candidate), False)])
        vote = yes >= no
        supported = self._is_supermajority(max(yes, no))
        if distance % COIN_ROUNDS == 0:
            if not supported:
                signature = self.events[voter].signature or self.events[voter].hash
                vote = bool(signature[len(signature) // 2] & 1)
        elif supported:
            self._famous.setdefault(candidate, vote)
        self._votes[voter, candidate] = vote

    def _order_decided_rounds(self) -> None:
        """Order the events of each round whose elections are all decided."""
        while self._next_round + 2 < len(self._witnesses):
            witnesses = self._witnesses[self._next_round]
            if not all(witness in self._famous for witness in witnesses):
                return
            self._order_round(self._next_round, self._unique_famous(witnesses))
            self._next_round += 1

    def _unique_famous(self, witnesses: Sequence[int]) -> list[int]:
        famous = [witness for witness in witnesses if self._famous[witness]]
        creators = [self._creator[witness] for witness in famous]
        return [witness for witness in famous if creators.count(self._creator[witness]) == 1]

    # --- order ---------------------------------------------------------------------------------------------

    def _order_round(self, number: int, judges: Sequence[int]) -> None:
        """Order the events that all unique famous witnesses of a round descend from, and that are not ordered yet."""
        if not judges:
            return
        heard = [self._list_receive_times(judge) for judge in judges]
        events = [event for event in heard[0] if all(event in times for times in heard)]
        whitening = bytes(len(self.events[judges[0]].hash))
        for judge in judges:
            whitening = _xor(whitening, self.events[judge].hash)
        stakes = [self._stakes[self._creator[judge]] for judge in judges]
        ordered = [
            (_median([times[event] for times in heard], stakes), _xor(self.events[event].hash, whitening), event)
            for event in events
        ]
        for time, _, event in sorted(ordered):
            self._received.add(event)
            self.ordered.append(Ordered(self.events[event], number, time))

    def _list_receive_times(self, judge: int) -> dict[int, Time]:
        """Events not ordered yet from which `judge` descends, and the time of its first self-ancestor that does."""
        chain = []
        at = judge
        while at != _NONE and at not in self._received:
            chain.append(at)
            at = self._self_parent[at]
        times: dict[int, Time] = {}
        for self_ancestor in reversed(chain):
            time = self.events[self_ancestor].time
            for event in self._unordered_ancestors(self_ancestor, times):
                times[event] = time
        return times

    def _unordered_ancestors(self, index: int, but: Mapping[int, Time]) -> Iterator[int]:
        """The event and its ancestors that are not ordered yet, without those in `but`, which grows meanwhile."""
        waiting = [index]
        while waiting:
            at = waiting.pop()
            if at == _NONE or at in self._received or at in but:
                continue
            yield at
            waiting += [self._self_parent[at], self._other_parent[at]]


def _xor(first: bytes, second: bytes) -> bytes:
    return bytes(a ^ b for a, b in zip(first, second, strict=True))


def _median(times: Sequence[Time], stakes: Sequence[int]) -> Time:
    """The least time that members with half of the stake have reached."""
    total, reached = sum(stakes), 0
    for time, stake in sorted(zip(times, stakes, strict=True)):
        reached += stake
        if 2 * reached >= total:
            return time
    return max(times)
