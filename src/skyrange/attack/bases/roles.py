"""Links of some roles, by patterns, and the base of kinds on control links."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from typing import ClassVar

from skyrange.attack.bases.on_path import LinkNames, PathPlace, on_path_place
from skyrange.attack.bases.rounds import RoundsOnLink
from skyrange.attack.contract import Attack, AttackContext
from skyrange.attack.declaration import Facts
from skyrange.attack.tapped_links import CONTROL_LINKS
from skyrange.contracts.plugins.form import param
from skyrange.core.errors import InputError, nearest


class OnControlLinks(RoundsOnLink):
    """Has a tap on each control link that the parameters name: it filters what passes, or sends in rounds, or both."""

    attack_facts: ClassVar[Facts] = {
        "surface": CONTROL_LINKS,
        "persists": "acts",
        "position": "on the path between ground station and aircraft",
    }

    place: PathPlace | None = on_path_place()
    links: LinkNames = param("Links gcs, log or autopilot by name or pattern, such as ['gcs:blue/b1'].")

    def build(self, context: AttackContext) -> Attack:
        """A tap on each link. Raises `InputError` for links that the scenario does not have, or of another role."""
        return Attack(taps=self.make_taps(find_links(self.links, context, CONTROL_LINKS), context), shown=self.marks())


def find_links(patterns: Sequence[str], context: AttackContext, roles: Sequence[str]) -> list[str]:
    """The links that match, each once.

    Raises `InputError` for a pattern without a link, and for a link of another role than `roles`.
    """
    chosen = []
    for place, pattern in enumerate(patterns):
        found = [name for name in context.links if fnmatchcase(name, pattern)]
        wrong = [name for name in found if name.partition(":")[0] not in roles]
        if not found or wrong:
            usable = [name for name in context.links if name.partition(":")[0] in roles]
            expected = f"a link of the scenario: {', '.join(roles)}"
            raise InputError.one(
                context.id, f"links.{place}", wrong[0] if wrong else pattern, expected, nearest(pattern, usable)
            )
        chosen += found
    return list(dict.fromkeys(chosen))
