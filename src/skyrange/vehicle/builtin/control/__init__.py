"""Controllers: attitude and position control, input shaping, and their gains."""
