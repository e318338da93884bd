"""Calibration: each step a pure function from readings to a fit with errors and a verdict.

`flex`, `actuator`, `buckling`, `hysteresis`, `stiffness`, `noise`, `encoder` (with the pressure
zeros) and `check` hold the fits; `steps` drives a robot and a camera through them, or reads a CSV.
"""
