"""Where obstacles stand beside the body: one fit to every frame of all sweeps of a side."""
