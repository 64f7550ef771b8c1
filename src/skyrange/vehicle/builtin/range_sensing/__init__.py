"""Range sensing: rangefinder, proximity sensor, and the avoidance of what it sees."""
