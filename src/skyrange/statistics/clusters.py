"""Clusters of runs that are not independent: those that share a flight or a seed, directly or through others.

Runs of one seed share all chance, whatever differs in their scenarios; runs with the same frames and the same truth are
one flight. Splits, resampling and hours of flight count clusters, not runs.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import TypeVar

Name = TypeVar("Name", bound=Hashable)


def find_clusters(shared: Mapping[Name, Iterable[Hashable]]) -> dict[Name, Name]:
    """The cluster of each member, by name of its first member in the order of `shared`.

    `shared` has, for each member, what it shares with others, such as its seed and its flights.
    Members are in one cluster if a chain of shared things leads from one to the other.
    """
    first: dict[Hashable, Name] = {}
    parent: dict[Name, Name] = {name: name for name in shared}
    place = {name: number for number, name in enumerate(shared)}

    def root(name: Name) -> Name:
        while parent[name] != name:
            parent[name] = parent[parent[name]]
            name = parent[name]
        return name

    for name, things in shared.items():
        for thing in things:
            other = root(first.setdefault(thing, name))
            mine = root(name)
            earlier, later = sorted((mine, other), key=place.__getitem__)
            parent[later] = earlier
    return {name: root(name) for name in shared}


def keep_first(keys: Sequence[Hashable]) -> list[bool]:
    """(n,) whether each key is there for the first time."""
    seen: set[Hashable] = set()
    kept = []
    for key in keys:
        kept.append(key not in seen)
        seen.add(key)
    return kept
