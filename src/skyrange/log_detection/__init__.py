"""Detection in logs: frames of logs, captures and runs as monitors see them, alerts, and rates of false alarms."""
