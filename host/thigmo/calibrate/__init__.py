"""Calibration: each step a module, from readings to a fit with errors, a verdict and robot.toml.

`steps` names them all. A step has `guided`, which takes on a `bench` the readings that its folder
(`session`) lacks and fits them, `of_csv` for readings that a lab already has, and the fit itself, a
pure function. Rows (n, m) have a column for each sensor, in the order of `columns`. A fit raises
DataError where readings are too few, or have not the columns that robot.toml asks for.
"""
