"""From files and Python to a checked scenario, and from a scenario to a wired range."""
