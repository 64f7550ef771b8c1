"""Receiver side of DRIP: whom an observer of Remote ID believes, and why (RFC 9575, section 6.4.2 and appendix A)."""
