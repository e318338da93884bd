"""Calibration: each step a pure function from readings to a fit with errors and a verdict.

`flex`, `actuator`, `buckling`, `hysteresis`, `stiffness`, `noise`, `encoder` (with the pressure
zeros) and `check` hold the steps; `guided` drives a robot and a camera through them. Names load on
first use.
"""
