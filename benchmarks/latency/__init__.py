"""Where the time goes: what `python -m benchmarks.speed` and `python -m benchmarks.realtime` are made of.

For ``speed`` read ``run`` first (the parts one after the other): ``solve``, ``bare``, ``tick``, ``loop``, ``limit``,
``embedded`` and ``setup`` measure one thing each, ``goals`` has what is wanted, ``report`` shows it, ``config`` is the
TOML. For ``realtime``: ``wire`` runs plant and controller as processes, ``clock`` shows what was found, and
``clock_page`` writes it into docs/realtime.md.
"""
