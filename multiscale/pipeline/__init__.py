"""What needs more than one layer: cases, and the run from surface to joint."""
