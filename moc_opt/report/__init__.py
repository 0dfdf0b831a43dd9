"""Numbers and traces as tables and pages.

Nothing is imported here, so that a table in a terminal does not wait for a plotting library. ``tables`` and ``console``
write to the terminal, ``page`` makes an HTML file, ``run_page``, ``map_page`` and ``replay`` make HTML files of saved
runs, and ``export`` saves figures as SVG and PDF.
"""
