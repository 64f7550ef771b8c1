"""Radio media that are other programs: the client of the medium protocol, and the engines for network simulators."""
