"""Range readings: what the rangefinder and the proximity sensor of an aircraft have reported."""
