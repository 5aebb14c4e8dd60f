"""What measures fungrasp and makes the paper's tables; not part of the installed package.

Run from the repository's root: ``python -m benchmarks`` lists them, ``python -m benchmarks.<name> --help``
says what one measures.
"""
