"""MAVLink command and mission protocols, ground station side."""
