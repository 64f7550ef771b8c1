"""The medium `omnetpp`: Wi-Fi by INET on OMNeT++, in a process of its own."""

from __future__ import annotations

from typing import Final, Literal

from pydantic import Field

from skyrange.contracts.medium import Medium
from skyrange.contracts.params import Number, Params
from skyrange.radio.contract import MediumContext, MediumPlugin
from skyrange.radio.external.engine import encode_params, find_engine
from skyrange.radio.external.medium import ExternalMedium

VARIABLE: Final = "SKYRANGE_OMNETPP_ENGINE"
"""Environment variable with the path of the compiled engine."""
INSTALL: Final = "skyrange install omnetpp --omnetpp DIR --inet DIR"


class OmnetppParams(Params):
    """Parameters of INET's Wi-Fi. Their defaults are those of INET."""

    error_model: Literal["nist", "yans"] = Field(
        default="nist", description="Error model: Ieee80211NistErrorModel, INET's default, or Ieee80211YansErrorModel."
    )
    sensitivity_dbm: Number = Field(
        default=-85.0, ge=-150, le=60, description="Weakest signal that is received, in dBm (receiver.sensitivity)."
    )
    energy_detection_dbm: Number = Field(
        default=-85.0,
        ge=-150,
        le=60,
        description="Power of signals and noise from which the channel is busy, in dBm (receiver.energyDetection).",
    )
    snir_threshold_db: Number = Field(
        default=4.0,
        ge=-50,
        le=100,
        description="Least SNIR at which a frame can be decoded, in dB; above it the error model decides "
        "(receiver.snirThreshold).",
    )
    snir_mode: Literal["min", "mean"] = Field(
        default="min",
        description="Which SNIR of a frame both of them take: its least or its mean over the frame "
        "(receiver.snirThresholdMode and receiver.errorModel.snirMode).",
    )
    path_loss: Literal["free_space", "two_ray", "two_ray_interference"] = Field(
        default="free_space",
        description="Path loss model for losses = 'engine': FreeSpacePathLoss, INET's default, TwoRayGroundReflection, "
        "or TwoRayInterference.",
    )
    path_loss_exponent: Number = Field(
        default=2.0, gt=0, le=10, description="Exponent of the distance in FreeSpacePathLoss (alpha)."
    )
    obstacle_loss: Literal["none", "ideal", "dielectric"] = Field(
        default="none",
        description="Obstacle loss model for losses = 'engine'. none, INET's default: buildings are ignored; ideal: "
        "IdealObstacleLoss, a building blocks everything; dielectric: DielectricObstacleLoss.",
    )
    material: Literal["concrete", "brick", "glass", "wood"] = Field(
        default="concrete", description="Material of all buildings for dielectric, from INET's MaterialRegistry."
    )
    deadline_s: Number = Field(
        default=60.0, gt=0, le=86_400, description="Wall time in seconds within which OMNeT++ must answer a step."
    )


def find_command() -> list[str]:
    """The command line that runs the engine. Raises `InputError`, with the command to install it, if there is none."""
    return [str(find_engine("omnetpp", "OMNeT++", VARIABLE, INSTALL))]


def make_omnetpp(params: Params, context: MediumContext) -> Medium:
    """Start OMNeT++ and return its medium. Raises `InputError` if the engine is not installed."""
    assert isinstance(params, OmnetppParams)
    return ExternalMedium("omnetpp", find_command(), context, encode_params(params), deadline_s=params.deadline_s)


OMNETPP = MediumPlugin(
    OmnetppParams, make_omnetpp, "Wi-Fi by INET on OMNeT++, in a process of its own; Bluetooth stays with the builtin."
)
"""The medium `omnetpp`."""
