"""HTTP: the transports of the approval link."""
