"""Acts of a kernel: attacks, sensor faults and body faults at run time, when each acts and on what."""
