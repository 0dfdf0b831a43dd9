"""Input from outside: files, names and settings, checked where they are read.

Read first: ``settings`` (the base of every table of a TOML; errors name field, value and range). ``files`` reads and
writes files (TOML, JSON, numpy's arrays) within limits of size, ``names`` holds the allow-list of characters and
escapes any other text, ``plugins`` finds entry points. Any room but core, figures, qp, model and redundancy may
import it; it imports ``errors`` alone.
"""
