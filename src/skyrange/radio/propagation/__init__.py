"""Propagation at 2.4 GHz: path loss, obstruction by buildings, fading, and the link budget made of them."""
