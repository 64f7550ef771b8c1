"""Attack `signing.setup_key`, orders with that key, and timestamps that GNSS sets."""

from __future__ import annotations

import pytest

from skyrange.core.errors import InputError
from skyrange.record import RunRecord
from skyrange.scenario.toml_files import load_text
from tests.flights import shared_run
from tests.integration.test_signed_flights import notes, outcome

pytestmark = pytest.mark.slow

KEY = 'vehicles = ["blue/b1"]'


def text(attacks: str, signing: str = "off", duration_s: float = 40.0, depart_s: float = 10.0) -> str:
    return f"""
        name = "key"
        duration_s = {duration_s}
        origin = [-35.3633280, 149.1652241]
        [[operators]]
        id = "blue"
        signing = "{signing}"
          [[operators.vehicles]]
          id = "b1"
          plan = {{ square = {{ side_m = 15, alt_m = 10 }} }}
          depart_s = {depart_s}
        {attacks}
    """


def attack(kind: str, params: str, start_s: float, stop_s: float = 0.0) -> str:
    stop = f"stop_s = {stop_s}" if stop_s else ""
    return f"""
        [[attacks]]
        id = "{kind.rpartition(".")[2]}-{start_s:.0f}"
        kind = "{kind}"
        start_s = {start_s}
        {stop}
        params = {{ {params} }}
    """


def flown(attacks: str, **flight: float | str) -> RunRecord:
    return shared_run(load_text(text(attacks, **flight)))  # type: ignore[arg-type]


def test_before_take_off_the_operator_is_locked_out_and_the_holder_of_the_key_takes_off() -> None:
    orders = attack("signing.stolen_key", 'links = ["gcs:blue/b1"], order = "take_off", passphrase = "PASS"', 20, 24)
    key = attack("signing.setup_key", KEY, 3)
    record = flown(key + orders.replace("PASS", "attacker"))
    assert [row["signs"] for row in notes(record, "event.signing_key")] == [True]
    refused = {row["message"] for row in notes(record, "event.signature_refused")}
    assert "HEARTBEAT" in refused
    assert len(notes(record, "decision.connected")) == 1, "telemetry still arrives"
    (armed,) = notes(record, "event.armed")
    assert 20.0 <= armed["time_ns"] / 1e9 < 25.0
    assert len(notes(record, "event.takeoff")) == 1
    guessed = flown(key + orders.replace("PASS", "another"))
    assert notes(guessed, "event.armed") == notes(guessed, "event.takeoff") == []


def test_in_flight_it_refuses_the_key() -> None:
    clean = flown("", duration_s=60.0, depart_s=0.0)
    record = flown(attack("signing.setup_key", KEY, 20), duration_s=60.0, depart_s=0.0)
    assert outcome(record) == outcome(clean) == ("complete", "")
    assert notes(record, "event.signing_key") == []
    assert record.manifest["digests"]["truth"] == clean.manifest["digests"]["truth"]
    assert [row["action"] for row in record.table("labels").to_pylist()] == ["inject"]


def test_a_timestamp_of_the_far_future_locks_out_the_holder_of_the_key_too() -> None:
    orders = attack(
        "signing.stolen_key", 'links = ["gcs:blue/b1"], order = "take_off", passphrase = "attacker"', 20, 24
    )
    record = flown(attack("signing.setup_key", f"{KEY}, ahead_s = 1e10", 3) + orders)
    reasons = {row["reason"] for row in notes(record, "event.signature_refused")}
    assert "timestamp more than a minute behind" in reasons
    assert notes(record, "event.armed") == []


def test_removing_a_key_needs_an_unsigned_way_in() -> None:
    remove = attack("signing.setup_key", f'{KEY}, form = "remove"', 3)
    for signing, removed in (("on", []), ("exempt", [False]), ("gateway", [False])):
        record = flown(remove, signing=signing, duration_s=15.0)
        assert [row["signs"] for row in notes(record, "event.signing_key")] == removed


def test_gnss_time_moves_timestamps_and_locks_out_a_station_that_does_not_hear_the_aircraft() -> None:
    """ArduPilot's issue 13860: a receiver sets the clock, and the clock the timestamp, while the aircraft is disarmed.

    The station connects after the jump. It is refused until it hears the aircraft, whose timestamps it follows.
    """
    ahead = attack("gnss.time", f"{KEY}, offset_s = 3600", 0)
    late = attack("link.drop", 'links = ["gcs:blue/b1"], direction = "fwd", probability = 1.0', 0, 3)
    deaf = attack("link.drop", 'links = ["gcs:blue/b1"], direction = "rev", probability = 1.0', 0, 8)
    deaf = deaf.replace("drop-0", "deaf")

    def refused(record: RunRecord) -> list[tuple[str, str]]:
        return [(row["reason"], row["message"]) for row in notes(record, "event.signature_refused")]

    connected = flown(ahead, signing="on", depart_s=0.0)
    assert refused(connected) == []
    assert notes(connected, "event.takeoff")
    unspoofed = flown(late + deaf, signing="on", depart_s=0.0, duration_s=30.0)
    assert refused(unspoofed) == []
    record = flown(ahead + late + deaf, signing="on", depart_s=0.0, duration_s=30.0)
    assert set(refused(record)) == {("timestamp more than a minute behind", "HEARTBEAT")}
    assert notes(record, "event.signature_refused")[-1]["time_ns"] < 9e9
    assert notes(record, "event.takeoff"), "it hears the aircraft at last"


def test_bad_parameters_are_named() -> None:
    with pytest.raises(InputError, match="ahead_s"):
        load_text(text(attack("signing.setup_key", f"{KEY}, ahead_s = -1", 3)))
