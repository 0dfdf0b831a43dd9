"""How much memory this process may still take."""

from __future__ import annotations

import resource
from pathlib import Path

_STATUS = {resource.RLIMIT_AS: "VmSize", resource.RLIMIT_DATA: "VmData"}
_CGROUP = Path("/sys/fs/cgroup")


def available_bytes() -> int:
    """Return the free bytes of the machine, of the process's limits and of its control group, whichever is least.

    What cannot be found out (another system than Linux) counts as without limit.
    """
    found = [2**62]
    found += [_kilobytes("/proc/meminfo").get("MemAvailable", 2**62)]
    used = _kilobytes("/proc/self/status")
    for limit, name in _STATUS.items():
        soft, _ = resource.getrlimit(limit)
        if soft != resource.RLIM_INFINITY:
            found.append(soft - used.get(name, 0))
    group = [_number(_CGROUP / name) for name in ("memory.max", "memory.current")]
    if group[0] is not None and group[1] is not None:
        found.append(group[0] - group[1])
    return max(0, min(found))


def _kilobytes(path: str) -> dict[str, int]:
    """Return the lines "name: 123 kB" of a file of the kernel, in bytes."""
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except OSError:
        return {}  # another system: nothing is known
    pairs = [line.split(":", 1) for line in lines if line.endswith(" kB")]
    return {name: 1024 * int(value.split()[0]) for name, value in pairs}


def _number(path: Path) -> int | None:
    try:
        return int(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None  # no control group, or one without a limit ("max")
