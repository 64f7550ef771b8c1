"""Avoidance: how an aircraft avoids others whose broadcasts it receives, in several kinds with one contract."""
