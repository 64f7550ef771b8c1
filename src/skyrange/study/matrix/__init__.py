"""Matrix of attacks and defences: its file, its flights, its measures and its page."""
