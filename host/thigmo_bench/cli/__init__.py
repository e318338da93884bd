"""The commands `thigmo bench`, `thigmo experiment` and `thigmo score`."""
