"""The builtin radio medium: channel access, transmissions and reception decisions in compiled kernels."""
