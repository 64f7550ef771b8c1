"""Export of runs as packet captures."""
