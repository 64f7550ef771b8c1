"""Scenario options of external vehicles: the table `[autopilots.options.external]`."""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import Field, model_validator

from skyrange.contracts.params import Number, Params, refuse
from skyrange.core.errors import InputError, Problem, nearest
from skyrange.io.mavlink.connections import ADDRESS_FORMS, Address


class Options(Params):
    """Options of the external vehicles of a scenario: addresses, and whether they may be moved."""

    connect: dict[str, str] = Field(
        default_factory=dict,
        description=f"MAVLink address of each vehicle, by operator/vehicle: {', '.join(ADDRESS_FORMS.values())}.",
    )
    allow_motion: bool = Field(
        default=False,
        strict=True,
        description="Whether to pass arming and motion commands to them; this also needs --allow-motion on the "
        "command line.",
    )
    rate_hz: Number = Field(
        default=10.0,
        ge=5,
        le=50,
        description="Rate in Hz at which position and attitude are requested of each vehicle.",
    )
    boot_s: Number = Field(
        default=20.0,
        gt=0,
        le=120,
        description="Wall time in seconds before time 0, within which each vehicle must connect and report its "
        "position.",
    )

    @model_validator(mode="after")
    def _check_addresses(self) -> Options:
        problems: list[Problem] = []
        held: dict[Address, str] = {}
        for vehicle, text in self.connect.items():
            try:
                address = Address.of(text, f"connect.{vehicle}")
            except InputError as error:
                problems += error.problems
                continue
            other = held.setdefault(address, vehicle)
            if other != vehicle:
                problems.append(
                    Problem(f"connect.{vehicle}", text, f"an address that no other vehicle has; {other} already has it")
                )
        if problems:
            raise refuse(*problems)
        return self

    def addresses(self, vehicles: Sequence[str]) -> list[Address]:
        """The address of each of `vehicles`. Raises `InputError` for vehicles without an address, and for unknown
        ones.
        """
        known = "autopilots.options.external.connect"
        problems = [
            Problem(f"{known}.{name}", text, "an external vehicle of the scenario", nearest(name, vehicles))
            for name, text in self.connect.items()
            if name not in vehicles
        ]
        problems += [
            Problem(
                known,
                f"no address for {vehicle}",
                "an address for each external vehicle",
                f'Such as "{vehicle}" = "tcp:127.0.0.1:5760".',
            )
            for vehicle in vehicles
            if vehicle not in self.connect
        ]
        if problems:
            raise InputError("external vehicles", problems)
        return [Address.of(self.connect[vehicle]) for vehicle in vehicles]
