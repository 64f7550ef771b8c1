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
from skyrange.utm.federated.exchanges import IncomingRequest


def _query(dss: DssState, turn: Turn, request: IncomingRequest) -> tuple[int, Any]:
    constraints = dss.store.constraints_in(dss.area(request))
    return 200, {
        "constraint_references": [dss.describe_reference(constraint, request.claims.uss) for constraint in constraints]
    }


def _get(dss: DssState, turn: Turn, request: IncomingRequest) -> tuple[int, Any]:
    return 200, {"constraint_reference": dss.describe_reference(_stored_constraint(dss, request), request.claims.uss)}


def _put(dss: DssState, turn: Turn, request: IncomingRequest) -> tuple[int, Any]:
    body, uss, id_ = request.body, request.claims.uss, request.parameters["entityid"]
    ovn = request.parameters.get("ovn")
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
    return (201 if old is None else 200), _describe_change(
        dss, stored, extent if old is None else extent.joined(old.extent)
    )


def _delete(dss: DssState, turn: Turn, request: IncomingRequest) -> tuple[int, Any]:
    stored = _stored_constraint(dss, request)
    check_version("constraint", request.claims.uss, stored.reference, request.parameters["ovn"], missing=404)
    dss.store.delete_constraint(stored.id)
    return 200, _describe_change(dss, stored, stored.extent)


def _describe_change(dss: DssState, stored: StoredConstraint, extent: Extent) -> dict[str, Any]:
    """The response to its manager, with the subscribers that it has to notify."""
    subscriptions = [
        subscription for subscription in dss.store.subscriptions_in(extent) if subscription.notify_for_constraints
    ]
    return {
        "subscribers": dss.notify(subscriptions),
        "constraint_reference": dss.describe_reference(stored, stored.reference.manager),
    }


def _stored_constraint(dss: DssState, request: IncomingRequest) -> StoredConstraint:
    stored = dss.store.constraint(request.parameters["entityid"])
    if stored is None:
        raise RefusalError(404, f"there is no constraint {request.parameters['entityid']}")
    return stored


HANDLERS: Final[Mapping[Op, Handler]] = {
    Op.QueryConstraintReferences: _query,
    Op.GetConstraintReference: _get,
    Op.CreateConstraintReference: _put,
    Op.UpdateConstraintReference: _put,
    Op.DeleteConstraintReference: _delete,
}
