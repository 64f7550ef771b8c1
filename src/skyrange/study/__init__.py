"""Look at runs after they flew: compare them, measure, draw and report."""
