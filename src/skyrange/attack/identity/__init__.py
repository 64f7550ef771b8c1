"""Attacks on MAVLink identities: heartbeats suppressed, kept up or doubled in the name of a station or an aircraft."""
