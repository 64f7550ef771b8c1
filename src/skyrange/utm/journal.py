"""Journals: what is told of each change that has to outlast the process; a database behind one makes it durable."""

from __future__ import annotations

from typing import Protocol, TypeVar

_T = TypeVar("_T", contravariant=True)


class Journal(Protocol[_T]):
    """What is told of changes of entities with an id."""

    def put(self, entity: _T) -> None:
        """An entity is new, or has replaced the one with its id."""
        ...

    def delete(self, id_: str) -> None:
        """The entity with an id is there no more."""
        ...


class NoJournal:
    """The journal of what lives as long as its process."""

    def put(self, entity: object) -> None:
        """Nothing is kept."""

    def delete(self, entity: object) -> None:
        """Nothing is kept."""
