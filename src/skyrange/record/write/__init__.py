"""Writing of a record: observers, encoding of rows, and conversion to the final files."""
