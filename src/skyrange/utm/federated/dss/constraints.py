"""Operations of a DSS on references of constraints: areas in which a constraint manager restricts flight."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from uas_standards.astm.f3548.v21.api import OperationID as Op

from skyrange.codec.f3548.values import ConstraintReference
from skyrange.contracts.mailboxes import Turn
from skyrange.utm.federated.dss.coverings import Extent
from skyrange.utm.federated.dss.requests import DssState, Handler, RefusalError, check_version
from skyrange.utm.federated.dss.store import StoredConstraint
from skyrange.utm.federated.exchanges import Asked


def _query(dss: DssState, turn: Turn, asked: Asked) -> tuple[int, Any]:
    found = dss.store.constraints_in(dss.area(asked))
    return 200, {"constraint_references": [dss.shown(one, asked.claims.uss) for one in found]}


def _get(dss: DssState, turn: Turn, asked: Asked) -> tuple[int, Any]:
    return 200, {"constraint_reference": dss.shown(_stored(dss, asked), asked.claims.uss)}


def _put(dss: DssState, turn: Turn, asked: Asked) -> tuple[int, Any]:
    body, uss, id_ = asked.body, asked.claims.uss, asked.parameters["entityid"]
    ovn = asked.parameters.get("ovn")
    extent = dss.extent(turn.now, body["extents"], heights=False)
    old = dss.store.constraint(id_)
    check_version("constraint", uss, old.reference if old is not None else None, ovn, missing=409)
    version = 1 if old is None else old.reference.version + 1
    reference = ConstraintReference(
        id=id_,
        manager=uss,
        version=version,
        ovn=dss.make_ovn(id_, version, turn.now),
        start_ns=extent.start_ns,
        end_ns=extent.end_ns,
        uss_base_url=body["uss_base_url"],
    )
    stored = StoredConstraint(reference, extent)
    dss.store.put_constraint(stored)
    turn.note("decision.dss_constraint", uss, {"constraint": id_, "version": version})
    return (201 if old is None else 200), _changed(dss, stored, extent if old is None else extent.joined(old.extent))


def _delete(dss: DssState, turn: Turn, asked: Asked) -> tuple[int, Any]:
    stored = _stored(dss, asked)
    check_version("constraint", asked.claims.uss, stored.reference, asked.parameters["ovn"], missing=404)
    dss.store.delete_constraint(stored.id)
    return 200, _changed(dss, stored, stored.extent)


def _changed(dss: DssState, stored: StoredConstraint, extent: Extent) -> dict[str, Any]:
    """The response to its manager, with the subscribers that it has to notify."""
    subscriptions = [one for one in dss.store.subscriptions_in(extent) if one.notify_for_constraints]
    return {
        "subscribers": dss.notify(subscriptions),
        "constraint_reference": dss.shown(stored, stored.reference.manager),
    }


def _stored(dss: DssState, asked: Asked) -> StoredConstraint:
    stored = dss.store.constraint(asked.parameters["entityid"])
    if stored is None:
        raise RefusalError(404, f"there is no constraint {asked.parameters['entityid']}")
    return stored


HANDLERS: Final[Mapping[Op, Handler]] = {
    Op.QueryConstraintReferences: _query,
    Op.GetConstraintReference: _get,
    Op.CreateConstraintReference: _put,
    Op.UpdateConstraintReference: _put,
    Op.DeleteConstraintReference: _delete,
}
