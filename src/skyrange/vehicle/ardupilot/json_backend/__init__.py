"""ArduPilot's JSON physics backend: motion values, their text, and the batches in which they are exchanged."""
