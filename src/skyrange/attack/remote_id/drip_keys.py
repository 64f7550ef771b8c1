"""Keys with which an adversary signs Remote ID: its own, a stolen one, or one that no registry endorses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from skyrange.attack.contract import AttackContext, RemoteIdKeys
from skyrange.attack.radio import check_vehicle
from skyrange.core.errors import InputError

if TYPE_CHECKING:  # its imports are slow, and only authenticated broadcasts need them
    from skyrange.remoteid.drip.registry import Registration

KeyOrigin = Literal["registered", "stolen", "unregistered"]


def find_keys(context: AttackContext) -> RemoteIdKeys:
    """The keys of the scenario; raises `InputError` if it has no registry."""
    if context.keys is None:
        raise InputError.one(context.id, "kind", "an attack on DRIP", "a scenario with a registry of DRIP keys")
    return context.keys


def find_root(context: AttackContext) -> bytes:
    """The entity tag of the root of the registry, 16 bytes: it is public. Raises `InputError` without a registry."""
    anchors = context.anchors("apex")
    if not anchors:
        raise InputError.one(context.id, "kind", "an attack on DRIP", "a scenario with a registry of DRIP keys")
    return anchors[0].tag


def find_registration(context: AttackContext, origin: KeyOrigin, vehicle: str | None) -> Registration:
    """The key, tag and Links of an adversary; raises `InputError` for a vehicle that has no key to steal."""
    keys = find_keys(context)
    if origin == "registered":
        return keys.registered(context.id)
    if origin == "unregistered":
        return keys.unregistered(context.id)
    assert vehicle is not None  # the parameters' own check
    check_vehicle(context, "vehicle", vehicle)
    stolen = keys.stolen(vehicle)
    if stolen is None:
        raise InputError.one(context.id, "vehicle", vehicle, 'an aircraft with remote_id.auth = "drip"')
    return stolen
