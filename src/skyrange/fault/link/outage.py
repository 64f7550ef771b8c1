"""Lost link: no frame arrives for as long as the fault acts."""

from __future__ import annotations

import skyrange.plugin as sky


@sky.fault(
    "link.outage",
    surface=sky.EVERY_LINK,
    effect="the ends lose each other: failsafes for a lost link fire, and recover when it is back",
    cause="a modem without power, an unplugged cable, or an aircraft out of range",
    not_modelled="the time that a modem takes to register again: the link is back at once",
    realism={"the link": "assumed: every frame is lost while the fault acts, and none before or after"},
)
class LostLink(sky.OnLinks):
    """Takes links down for as long as it acts."""

    act = sky.drop()
