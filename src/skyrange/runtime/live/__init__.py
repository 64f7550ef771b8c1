"""Live range: a scenario in real time, its components as processes that communicate over sockets."""
