"""Scan hooks: what attacks and faults make of the light of LiDARs and depth cameras before these measure it."""

from __future__ import annotations

from collections.abc import Sequence

from skyrange.contracts.components import World
from skyrange.contracts.scan_light import ScanHook, ScanLight, ScannerKind
from skyrange.core.errors import attribute_error
from skyrange.core.ids import FrameId
from skyrange.core.time import Time
from skyrange.kernel.acts.act_states import ActCounter, ActState, check_faults, takes_effect

ScanAct = tuple[Time, ActState, ScanHook, FrameId]
"""When the scan began, the act, its hook, and the act's own id."""


class ScanHookInjector:
    """The scan hooks of one run (contract: `contracts.scan_light.LightSource`).

    One that does not act is not called: hooks are pure, so it would leave nothing.
    """

    def __init__(self, attacks: Sequence[ActState], world: World | None) -> None:
        """Raises `InputError` for a vehicle that the world does not have, or a name used twice."""
        self._owned = [(attack, hook) for attack in attacks for hook in attack.plan.scan_hooks]
        self._owned.sort(key=lambda pair: (pair[0].id, pair[1].name))
        check_faults("scan hook", self._owned, list(world.vehicles) if world is not None else [])
        self.present = bool(self._owned)
        """Whether there are any."""
        self._counter = ActCounter("scan hook")
        self._acts: list[ScanAct] = []

    def has_hooks(self, vehicle: str, kind: ScannerKind) -> bool:
        """See `LightSource`."""
        return any(vehicle in hook.vehicles and kind in hook.kinds for _, hook in self._owned)

    def alter(self, now: Time, light: ScanLight) -> None:
        """See `LightSource`. Raises `ComponentError` for a hook that fails."""
        for attack, hook in self._owned:
            concerned = light.vehicle in hook.vehicles and light.kind in hook.kinds
            if not concerned or hook.sensor not in (None, light.sensor) or not takes_effect(attack, now):
                continue
            try:
                acted = hook.on_scan(now, light)
            except Exception as error:
                raise attribute_error(f"scan hook {hook.name}", now, error) from error
            if acted:
                self._acts.append((now, attack, hook, self._counter.number(hook, light.vehicle, light.kind)))

    def take_acts(self) -> list[ScanAct]:
        """Each act since the last call, by an id of its own."""
        acts, self._acts = self._acts, []
        return acts
