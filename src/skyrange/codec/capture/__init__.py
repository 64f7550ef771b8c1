"""Capture files: pcapng blocks, and the packets that go into them."""
