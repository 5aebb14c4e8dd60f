"""The solver's loops, compiled by Numba (extra ``fast``); the NumPy code beside this room is what they are
tested against."""
