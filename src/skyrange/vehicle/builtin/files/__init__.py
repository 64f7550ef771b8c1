"""Files of an aircraft: its memory card, its logs, and the files that stand for parameters and missions."""
