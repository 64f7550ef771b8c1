"""Base of kinds that act at a USS of a federated approval, and checks of its services."""

from __future__ import annotations

from collections.abc import Collection
from typing import ClassVar

from skyrange.attack.bases.approval.links import OnApproval, service_links
from skyrange.attack.contract import Attack, AttackContext
from skyrange.codec.f3548.frames import UssRequest, UssResponse, decode
from skyrange.contracts.plugins.form import param
from skyrange.core.errors import DecodeError, InputError, nearest
from skyrange.utm.contract import AIRSPACE, DSS


class AtUss(OnApproval):
    """Acts at the end of a USS on its links to other services."""

    alters: ClassVar[str] = ""
    """What of the USS it alters as the only one, before its name: such as "details of"."""
    others: ClassVar[Collection[str] | None] = None
    """The services on whose links it acts; `None` for all."""

    uss: str = param("Name of the USS: the operator's id, unless the federation names others.")

    def build(self, context: AttackContext) -> Attack:
        """Taps at the USS. Raises `InputError` for a USS that the scenario does not have."""
        known = sorted({other for service, other in service_links(context) if service == DSS and other != AIRSPACE})
        if self.uss not in known:
            hint = nearest(self.uss, known) or 'Set approval = "federated" for its operator.'
            raise InputError.one(context.id, "uss", repr(self.uss), "a USS of the scenario", hint)
        alters = f"{self.alters} {self.uss}" if self.alters else ""
        return self.at_service(self.uss, context, alters=alters, others=self.others)


def read_uss(payload: bytes) -> UssRequest | UssResponse | None:
    """The message of a USS or a DSS in a frame; `None` for what is not one."""
    try:
        return decode(payload)
    except DecodeError:
        return None


def check_constraint_manager(context: AttackContext) -> None:
    """Raise `InputError` for a scenario without a constraint manager."""
    if (DSS, AIRSPACE) not in service_links(context):
        hint = 'Add [[constraints]], and set approval = "federated" for an operator.'
        raise InputError.one(context.id, "kind", "approval.poisoned_constraint", "a scenario with constraints", hint)
