"""Commands for maintainers. They are called like all others: ``python -m benchmarks.NAME``.

    readme        the figures of README.md, from results
    pictures      its pictures
    errata        docs/errata.md, with the numbers of errata_numbers
    tune          the search that found the preset `tuned`, in the space of tune_space
    mutation      how many small errors in the source the tests find, with mutants/
    sweep_speed   the cost of a sweep's engine, and the gain of more workers
    sweep_memory  what the summary of a sweep takes

Nothing that users run imports from here.
"""
