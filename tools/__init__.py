"""Programs for developers: checks of the sources, records of what tests execute, and planted faults."""
