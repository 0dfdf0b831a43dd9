"""Input from outside: files, names and settings, checked where they are read.

Read first: ``settings`` (the base of every table of a TOML; errors name field, value and range). ``files``
reads TOML and JSON within limits of size, ``parquet_footer`` reads the sizes that a Parquet file declares, ``toml``
writes tables, ``names`` holds the allow-list of characters, ``memory`` estimates whether data fit, ``plugins`` finds
entry points, ``notebook`` makes HTML of objects. Any room but numerics, figures, qp, model and redundancy may import
it; it imports ``errors`` alone.
"""
