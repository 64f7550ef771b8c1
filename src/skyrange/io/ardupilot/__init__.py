"""ArduPilot SITL processes: serial ports and lockstep exchanges."""
