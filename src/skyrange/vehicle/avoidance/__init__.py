"""Avoidance: what an aircraft does about others that it hears, by kinds of one contract."""
