"""MAVLink FTP: the server, and the files that stand for parameters and missions."""
