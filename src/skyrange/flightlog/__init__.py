"""Logs of flights: readers of telemetry logs, DataFlash logs and ULogs, the flights in them, and scenarios of these."""

from skyrange.flightlog.flights import Flight, split_flights
from skyrange.flightlog.model import FlightLog, Remark
from skyrange.flightlog.reading import read_log

__all__ = ["Flight", "FlightLog", "Remark", "read_log", "split_flights"]
