"""Commands for maintainers. They are called like all others: ``python -m benchmarks.NAME``.

    readme        the figures of README.md, from results
    pictures      its pictures
    errata        docs/errata.md
    tune          the search that found the preset `tuned`
    coverage      how often the intervals of the study of solvers hold the true change

Nothing that users run imports from here.
"""
