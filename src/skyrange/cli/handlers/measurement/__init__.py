"""Handlers of the commands `skyrange bench` and `skyrange parity`."""
