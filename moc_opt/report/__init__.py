"""Numbers and traces as tables and pages.

Nothing is loaded here, so that a terminal table does not wait for a plotting library. Import from

- ``report.tables``: ``Column``, ``Table``, ``Missing``
- ``report.page``: ``Page``, a self-contained HTML file
- ``report.export``: ``save_figures``, figures as SVG and PDF
- ``report.console``: the terminal
- ``report.map_page``: the manipulability map as a figure, and on a page with what it says
- ``report.replay``: runs in 3-D, as a file

Imports figures, trace, robots and planning; comparison, live, the command line and benchmarks
import it.
"""
