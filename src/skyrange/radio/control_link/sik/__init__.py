"""SiK telemetry radios as a channel of control links: modem, time slots, radios, and the reports of radios."""
