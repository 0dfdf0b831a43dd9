"""Input from outside: files, names, settings and plug-ins, checked where they are read.

``settings`` is the base of every table of a TOML. ``files`` reads files within limits of size, and writes every file
of the package. ``names`` says what a name may look like. ``plugins`` loads the entry points of other packages.
"""
