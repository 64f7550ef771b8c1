"""Sockets, subprocesses and ports: the only room where the outside world gets in."""
