"""Detectors that read MAVLink: senders, commands, rates, sequence numbers and times of arrival."""
