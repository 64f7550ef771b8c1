"""Scenarios: the models that TOML files and Python build, and functions that read and write them.

The names that this package exports are public; its modules are private and may change.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from skyrange.core.lazy_exports import export_lazily

if TYPE_CHECKING:
    from skyrange.radio.control_link.params import BaseStation, CellularParams, WifiParams
    from skyrange.radio.control_link.sik.params import SikParams
    from skyrange.scenario.model.attacks import AttackTable, FaultTable, When
    from skyrange.scenario.model.defences import DefenceCost, DefenceTable, DetectorTable
    from skyrange.scenario.model.fleet import Autopilots, Fleet, Start, Vehicle
    from skyrange.scenario.model.links import Link, Processing
    from skyrange.scenario.model.manual_acts import ManualActTable
    from skyrange.scenario.model.operators import Operator
    from skyrange.scenario.model.plan import (
        Fence,
        FenceCircle,
        FencePolygon,
        Path,
        Plan,
        Route,
        Square,
        mission_file,
        path,
        route,
        square,
    )
    from skyrange.scenario.model.radio import Avoidance, Radio, Receiver, RemoteId, Verify
    from skyrange.scenario.model.scenario import City, Grid, Live, Origin, Record, Scenario, Sensors, Wind, json_schema
    from skyrange.scenario.shipped import SHIPPED
    from skyrange.scenario.toml_files import to_toml

__all__ = [
    "SHIPPED",
    "AttackTable",
    "Autopilots",
    "Avoidance",
    "BaseStation",
    "CellularParams",
    "City",
    "DefenceCost",
    "DefenceTable",
    "DetectorTable",
    "FaultTable",
    "Fence",
    "FenceCircle",
    "FencePolygon",
    "Fleet",
    "Grid",
    "Link",
    "Live",
    "ManualActTable",
    "Operator",
    "Origin",
    "Path",
    "Plan",
    "Processing",
    "Radio",
    "Receiver",
    "Record",
    "RemoteId",
    "Route",
    "Scenario",
    "Sensors",
    "SikParams",
    "Square",
    "Start",
    "Vehicle",
    "Verify",
    "When",
    "WifiParams",
    "Wind",
    "json_schema",
    "mission_file",
    "path",
    "route",
    "square",
    "to_toml",
]

if not TYPE_CHECKING:
    __getattr__ = export_lazily(
        __name__,
        {
            "skyrange.radio.control_link.params": "BaseStation CellularParams WifiParams",
            "skyrange.radio.control_link.sik.params": "SikParams",
            "skyrange.scenario.model.attacks": "AttackTable FaultTable When",
            "skyrange.scenario.model.defences": "DefenceCost DefenceTable DetectorTable",
            "skyrange.scenario.model.fleet": "Autopilots Fleet Start Vehicle",
            "skyrange.scenario.model.links": "Link Processing",
            "skyrange.scenario.model.manual_acts": "ManualActTable",
            "skyrange.scenario.model.operators": "Operator",
            "skyrange.scenario.model.plan": (
                "Fence FenceCircle FencePolygon Path Plan Route Square mission_file path route square"
            ),
            "skyrange.scenario.model.radio": "Avoidance Radio Receiver RemoteId Verify",
            "skyrange.scenario.model.scenario": "City Grid Live Origin Record Scenario Sensors Wind json_schema",
            "skyrange.scenario.shipped": "SHIPPED",
            "skyrange.scenario.toml_files": "to_toml",
        },
    )


def __dir__() -> list[str]:
    return sorted(__all__)
