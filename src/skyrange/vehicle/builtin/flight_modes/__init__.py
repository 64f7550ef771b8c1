"""Flight modes with a module of their own: GUIDED, RTL and AUTO_RTL."""
