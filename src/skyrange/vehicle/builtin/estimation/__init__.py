"""Where does each aircraft believe it is? ArduPilot's EKF3, reduced to what decides how a flight goes on."""
