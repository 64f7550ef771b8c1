"""Compilation of kernels before they are called: which ones flights use, and how to compile them on all cores."""
