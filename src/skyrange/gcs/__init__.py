"""Ground control station: flight plans, mission transfer, flight sequencing, telemetry and the traffic picture."""
