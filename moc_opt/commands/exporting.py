"""moc-opt export-c: the controller of a scenario as C."""

from __future__ import annotations

import argparse


def export_c(given: argparse.Namespace) -> int:
    """Write the whole controller, with recorded ticks for its self-tests; say how long its longest step is."""
    from moc_opt.commands.running import read_scenario
    from moc_opt.scenario.exported import export_scenario

    out, udp = given.out, given.main == "udp"
    scenario, _ = read_scenario(given.scenario)
    files, operations = export_scenario(scenario, out, udp=udp)
    for file in files:
        print(file)
    parts = ", ".join(f"{part} {count}" for part, count in operations.items() if part != "in all")
    print(f"longest step: {operations['in all']} floating-point operations ({parts})")
    print(f"next: make -C {out} test, make -C {out} sanitize")
    if udp:
        print(f"then: make -C {out} moc_udp, {out}/moc_udp 127.0.0.1 30200 {out}/reference.bin")
    return 0
