"""Frames: singly, in blocks, their payloads as columns, and references to them."""
