"""The solver's loops, compiled by Numba; the NumPy code beside this room is what they are
tested against."""
