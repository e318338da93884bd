"""The public benchmark: frozen frames with truth, and the scorer; nothing else of thigmo.

`frames.csv` and `readings.csv` are what a method gets, `truth.csv` what it is scored against. The
held-back frames have no truth here: the keeper of their seed scores them. docs/benchmark.md has the
format.
"""
