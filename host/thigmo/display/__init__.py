"""How results look: HTML in a notebook, and figures of matplotlib.

Functions here take plain values, so that a result of any layer above can show itself.
"""
