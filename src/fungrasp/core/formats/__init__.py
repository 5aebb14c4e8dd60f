"""Reading files from unknown sources: one function per format.

Declared sizes, names and nesting are checked before memory is allocated. Files for third-party parsers are
first parsed in a child process with limited time and memory. Every problem raises a one-line
``FungraspError``.
"""
