"""Flight plans: construction, checks, route, and airspace volumes."""
