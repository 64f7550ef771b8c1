"""Child processes: start and end, single runs, sharing of a processor core."""
