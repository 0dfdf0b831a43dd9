"""Numbers and traces as tables and pages.

``tables`` and ``console`` write to the terminal, and ``page`` makes an HTML file. ``run_page``, ``map_page`` and
``replay`` make HTML files of saved runs. ``export`` saves figures as SVG and PDF. Nothing is imported here, because a
plotting library would delay a table in a terminal.
"""
