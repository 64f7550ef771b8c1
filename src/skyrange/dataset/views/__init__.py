"""Views of one run: what a sensor at a place sees of it, as tables with labels."""
