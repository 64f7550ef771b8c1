"""Parameters: the table and the names of other firmware versions."""
