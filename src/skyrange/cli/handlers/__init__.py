"""Handlers of the commands: call the library, then print the result."""
