"""Physical layer: waveforms, channels, and the framing of Remote ID transports."""
