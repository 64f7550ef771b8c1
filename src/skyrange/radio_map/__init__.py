"""Radio maps: losses of a city that a ray tracer computes once, for scenarios that fly on them."""
