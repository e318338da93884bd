"""Studies, experiments, baselines and the public benchmark behind the project's figures.

A checkout has this package and a wheel does not. It imports `thigmo`, and nothing there imports it:
its commands (`thigmo bench`, `experiment`, `score`) are entry points of the group
`thigmo.commands`.
"""
