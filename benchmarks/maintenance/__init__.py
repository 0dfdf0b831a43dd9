"""What only the maintainers run. The commands are called like all others: ``python -m benchmarks.NAME``.

    readme        the figures of README.md, from results
    pictures      its pictures
    errata        docs/errata.md, with the numbers of errata_numbers
    tune          the search that found the preset `tuned`, in the space of tune_space
    mutation      how many small errors in the source the tests find, with mutants/
    sweep_speed   what the engine of a sweep costs, and what more workers bring
    sweep_memory  what the summary of a sweep takes

Nothing that users run imports from here.
"""
