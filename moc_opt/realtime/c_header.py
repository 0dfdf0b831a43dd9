"""The packets as C structs: ``wire_packets.h`` of an exported controller, written from the same layouts."""

from __future__ import annotations

import numpy as np

from moc_opt.realtime.key import LOOPBACK_KEY
from moc_opt.realtime.packets import COUNTERS, HEADER, MAGIC, VERSION, Kind, layout
from moc_opt.realtime.settings import WireSettings

_TYPES = {
    "<u8": "uint64_t", "<i8": "int64_t", "<f8": "double", "<u4": "uint32_t", "<i4": "int32_t", "|u1": "uint8_t",
}  # fmt: skip
_STRUCTS = {
    "measurement": Kind.MEASUREMENT, "command": Kind.COMMAND, "report": Kind.REPORT, "plain": Kind.HELLO,
}  # fmt: skip


def c_header(n: int, ticks: int, scenario: int, settings: WireSettings) -> str:
    """Write the header for n joints and a run of so many ticks; ``scenario`` is its fingerprint."""
    defines = {
        "JOINTS": n, "TICKS": ticks, "SCENARIO": f"UINT64_C({scenario})", "VERSION": VERSION,
        "MAGIC": f'"{MAGIC.decode()}"', "LOOPBACK_KEY": f'"{LOOPBACK_KEY.decode()}"', "WAIT_S": settings.wait_s,
        "SILENCE_S": settings.silence_s,
        "COUNTER_NAMES": "{" + ", ".join(f'"{name}"' for name in COUNTERS) + "}",
    }  # fmt: skip
    kinds = ", ".join(f"WIRE_KIND_{kind.name} = {int(kind)}" for kind in Kind)
    counters = ", ".join(f"WIRE_{name.upper()}" for name in COUNTERS)
    parts = [
        "/* Generated: the packets of the wire, see docs/realtime.md. Little-endian machines only. */",
        "#ifndef WIRE_PACKETS_H\n#define WIRE_PACKETS_H\n\n#include <stdint.h>\n",
        *(f"#define WIRE_{name} {value}" for name, value in defines.items()),
        f"\nenum {{{kinds}}};\nenum {{{counters}, WIRE_COUNTERS}};",
        "enum {WIRE_WAITING, WIRE_RUNNING, WIRE_ENDED}; /* flags of a measurement */",
        "enum {WIRE_STOP = 1, WIRE_REPORTED = 2};       /* flags of a command */\n",
        _struct("header", np.dtype(HEADER)),
    ]
    for name, kind in _STRUCTS.items():
        dtype = layout(kind, n)
        parts += [_struct(name, dtype, len(HEADER)), _check(f"sizeof(wire_{name}) == {dtype.itemsize}", name)]
    parts.append(
        "#if defined(__BYTE_ORDER__) && __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__\n"
        '#error "the packets are little-endian"\n#endif\n\n#endif'
    )
    return "\n".join(parts) + "\n"


def _check(condition: str, name: str) -> str:
    return f"typedef char wire_{name}_has_its_size[{condition} ? 1 : -1];\n"


def _struct(name: str, dtype: np.dtype[np.void], begin: int = 0) -> str:
    lines = ["    wire_header head;"] if begin else []
    for field in (dtype.names or ())[begin:]:
        base, shape = dtype[field].base, dtype[field].shape
        if base.kind in "SV":
            kind, shape = ("char" if base.kind == "S" else "uint8_t"), (base.itemsize,)
        else:
            kind = _TYPES[base.str]
        lines.append(f"    {kind} {field}{''.join(f'[{size}]' for size in shape)};")
    return "typedef struct {\n" + "\n".join(lines) + f"\n}} wire_{name};"
