"""State estimation: ArduPilot's EKF3, reduced to what determines the course of a flight."""
