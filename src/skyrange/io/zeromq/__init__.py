"""ZeroMQ: transport, context and CURVE keys."""
