"""Whether this machine can time anything now."""

from __future__ import annotations

import os


def busy() -> str:
    """Return a sentence where more threads want to run than there are cores, to stand beside times; else empty."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    try:
        load = os.getloadavg()[0]  # over the last minute
    except OSError:
        return ""
    if load <= cores:
        return ""
    return f"The machine was busy (load {load:.1f} on {cores} cores): times are longer than on an idle one."
