"""moc-opt export-c: the controller of a scenario as C."""

from __future__ import annotations

import argparse


def export_c(given: argparse.Namespace) -> int:
    """Write the whole controller, with recorded ticks for its self-test."""
    from moc_opt.commands.running import read_scenario
    from moc_opt.export import export_scenario

    out, udp = given.out, given.main == "udp"
    scenario, _ = read_scenario(given.scenario)
    for file in export_scenario(scenario, out, udp=udp, force=given.force):
        print(file)
    print(f"next: make -C {out} test")
    if udp:
        print(f"then: make -C {out} moc_udp, {out}/moc_udp 127.0.0.1 30200 {out}/reference.bin")
    return 0
