"""Design of a study: its file, factors, points, draws and blocks."""
