"""MAVLink over sockets and serial devices: transports, connections to autopilots, ports for viewers."""
