"""What the benchmarks share: command line, configuration, workers, clock, and how results are written and shown.

`cli` is the tail of every command: it parses, writes what was found and prints it. `config` is the base of every
configuration; `processes` and `crew` are workers with a limit of time; `store` keeps finished parts; `output`,
`answer`, `markdown`, `index` and `look` are what is left behind. Nothing here imports another room of the benchmarks.
"""
