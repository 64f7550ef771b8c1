"""Page of a run: its contents, sections, tables and scene."""
