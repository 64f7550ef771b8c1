"""Who hears whom? The air: propagation among buildings, radios, access, and the oracle between them and links."""
