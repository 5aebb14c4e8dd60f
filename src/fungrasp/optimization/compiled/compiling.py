"""How loops are compiled.

Numba's cache beside the sources knows when a file has changed, but not when a function of another file has that its
loops call: after a change of a loop that others call, remove ``__pycache__`` of this folder.
"""

from __future__ import annotations

import numba

# Sums may be reordered and multiplications joined to additions; NaN and infinity keep their meaning. The global
# interpreter lock is not held, so that threads work side by side; machine code is kept in a cache on disk.
compiled = numba.njit(
    cache=True, nogil=True, error_model="numpy", fastmath={"reassoc", "contract", "nsz", "arcp"}
)
