"""Models of a scenario: one pydantic model for TOML files and Python."""
