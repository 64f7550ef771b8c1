"""Node of a live range: one process, and the agent of a machine that starts such processes."""
