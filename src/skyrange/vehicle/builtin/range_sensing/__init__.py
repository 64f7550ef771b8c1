"""Range sensing: readings taken in from MAVLink, and the avoidance of obstacles."""
