"""Memory card of an aircraft: files, directories and flight logs."""
