"""How does a scenario run as processes on real sockets? A node per component, one clock, one record at the end."""
