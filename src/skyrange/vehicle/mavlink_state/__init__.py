"""State of an aircraft derived from its MAVLink reports: poses and events, shared by engines of real autopilots."""
