"""Sockets, subprocesses and ports: the only package that communicates with other programs."""
