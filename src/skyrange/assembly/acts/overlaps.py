"""Overlaps of acts: what each alters or decides as the only one, checked again when one is started by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from skyrange.assembly.acts.conflicts import Acting, Window, find_exclusions
from skyrange.assembly.acts.defences import Declared, check_paths
from skyrange.core.errors import Problem


@dataclass(frozen=True, slots=True)
class Overlaps:
    """All acts of a scenario that are not muted, as far as they exclude or disturb each other."""

    attacks: Sequence[Acting]
    """Attacks and faults."""
    defences: Sequence[Acting]
    declared: Sequence[Declared]
    """Defences on the paths of frames, in the order of declaration."""
    signing: Sequence[str]
    """Operators that sign their MAVLink."""

    def find_problems(self, windows: Mapping[str, Window]) -> list[Problem]:
        """What is wrong if these acts, by id, act in these windows and the others do not act."""
        attacks, defences = (_act_in(acting, windows) for acting in (self.attacks, self.defences))
        declared = [one._replace(window=windows.get(one.id, _NEVER)) for one in self.declared]
        return [
            *find_exclusions(attacks),
            *find_exclusions(defences, "a defence", "decide"),
            *check_paths(declared, self.signing),
        ]


_NEVER: Window = (0, 0)


def _act_in(acting: Sequence[Acting], windows: Mapping[str, Window]) -> list[Acting]:
    """The same acts in other windows; each is declared at `attacks.ID`, `faults.ID` or `defences.ID`."""
    return [(where, windows.get(where.partition(".")[2], _NEVER), parts) for where, _, parts in acting]
