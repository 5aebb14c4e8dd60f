"""Reading files that others wrote: one function per format.

Sizes, names and nesting that a file declares are checked before memory is taken for them; what third-party
libraries parse is tried in a child process with limited time and memory first. Whatever is wrong with a file
is a ``FungraspError`` of one line.
"""
