"""ArduPilots whose bodies Gazebo moves: the world made from a scenario, and the exchange with the Gazebo process."""
