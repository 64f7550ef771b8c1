"""The medium `ns3`: Wi-Fi by ns-3, in a process of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Final, Literal

from pydantic import Field, Strict

from skyrange.contracts.medium import Medium
from skyrange.contracts.params import Number, Params
from skyrange.radio.contract import MediumContext, MediumPlugin
from skyrange.radio.external.engine import encode_params, find_engine
from skyrange.radio.external.medium import ExternalMedium

VARIABLE: Final = "SKYRANGE_NS3_ENGINE"
"""Environment variable with the path of the compiled engine."""
INSTALL: Final = "skyrange install ns3"
HOW_TO_GET: Final = "pip install 'skyrange[ns3]'; or on Debian: sudo apt-get install libns3-dev"
"""How to get the libraries that the engine is compiled with."""


class Ns3Params(Params):
    """Parameters of ns-3's Wi-Fi. Their defaults are those of ns-3."""

    error_model: Literal["table", "nist", "yans"] = Field(
        default="table",
        description="Error rate model. table: ns3::TableBasedErrorRateModel, ns-3's default; nist: NistErrorRateModel, "
        "whose formula the builtin medium uses too; yans: YansErrorRateModel.",
    )
    preamble_detection: Annotated[bool, Strict()] = Field(
        default=True, description="Whether ns3::ThresholdPreambleDetectionModel decides if a preamble is detected."
    )
    preamble_rssi_dbm: Number = Field(
        default=-82.0, ge=-150, le=60, description="Weakest signal whose preamble is detected, in dBm (MinimumRssi)."
    )
    preamble_snr_db: Number = Field(
        default=4.0, ge=-50, le=100, description="Least SNR at which a preamble is detected, in dB (Threshold)."
    )
    capture_margin_db: Number | None = Field(
        default=None,
        ge=0,
        le=100,
        description="Margin in dB of ns3::SimpleFrameCaptureModel; default: no frame capture, as in ns-3.",
    )
    sensitivity_dbm: Number = Field(
        default=-101.0, ge=-150, le=60, description="Weakest signal that is processed at all, in dBm (RxSensitivity)."
    )
    energy_detection_dbm: Number = Field(
        default=-62.0, ge=-150, le=60, description="Energy from which the channel is busy, in dBm (CcaEdThreshold)."
    )
    carrier_sense_dbm: Number = Field(
        default=-82.0, ge=-150, le=60, description="Signal from which the channel is busy, in dBm (CcaSensitivity)."
    )
    path_loss: Literal["three_gpp_umi", "friis", "two_ray", "itu_r_1411_los", "itu_r_1411_over_rooftop"] = Field(
        default="three_gpp_umi",
        description='ns-3\'s propagation model, used with losses = "engine". three_gpp_umi: 3GPP TR 38.901 UMi street '
        "canyon, with line of sight by the buildings, without shadowing.",
    )
    deadline_s: Number = Field(
        default=60.0, gt=0, le=86_400, description="Wall time in seconds within which ns-3 must answer a step."
    )


def make_ns3(params: Params, context: MediumContext) -> Medium:
    """Start ns-3 and return its medium. Raises `InputError` if the engine is not installed."""
    assert isinstance(params, Ns3Params)
    return ExternalMedium("ns3", [str(find_program())], context, encode_params(params), deadline_s=params.deadline_s)


def find_program() -> Path:
    """The compiled engine. Raises `InputError` if it is not installed."""
    return find_engine("ns3", "ns-3", VARIABLE, INSTALL)


NS3 = MediumPlugin(Ns3Params, make_ns3, "Wi-Fi by ns-3, in a process of its own; Bluetooth stays with the builtin.")
"""The medium `ns3`."""
