"""The made fleet by which the viewer is measured."""

from __future__ import annotations

import numpy as np

from skyrange.view.stream.events import EventTables
from skyrange.view.stream.messages import decode_file
from skyrange.view.stream.positions import Samples
from tools.viewer_fleet import CORRIDOR_M, HEIGHT_M, WOBBLE_M, encode_fleet, make_city, make_flights


def test_a_made_fleet_flies_in_its_airspace_over_its_city() -> None:
    city = make_city(100)
    assert len(city.buildings) == 100
    scene, *messages = decode_file(encode_fleet(make_flights(7, city, 40.0), city))
    assert len(scene.head["vehicles"]) == 7
    assert len(scene.arrays["heights"]) == 100
    truth = [Samples.decode(message) for message in messages if message.head.get("layer") == "truth"]
    assert [samples.grid.count for samples in truth] == [151, 51]
    for samples in truth:
        assert np.all(np.abs(samples.enu_m[:, 2] - np.mean(HEIGHT_M)) <= np.ptp(HEIGHT_M) / 2 + WOBBLE_M + 0.01)
        for place, time_ns in enumerate(samples.grid.times):
            claimed = {
                row["vehicle"]: row for row in scene.head["volumes"] if row["from_s"] <= time_ns / 1e9 <= row["until_s"]
            }
            for vehicle, row in claimed.items():
                at = samples.enu_m[vehicle, :, place]
                middle = np.mean(row["ring"], axis=0)
                reach = np.linalg.norm(np.array(row["ring"][0]) - middle)
                assert np.linalg.norm(at[:2] - middle) <= reach + CORRIDOR_M
                assert row["lower_m"] <= at[2] <= row["upper_m"]
    heard = [EventTables.decode(message).rows["receptions"] for message in messages if message.kind == "E"]
    assert [len(rows) for rows in heard] == [7 * 30 * 2, 7 * 10 * 2]
