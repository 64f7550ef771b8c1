"""Radio: the 2.4 GHz medium, its propagation and access, and the oracle that connects it to the Remote ID links."""
