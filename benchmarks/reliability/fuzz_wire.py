"""Sealed packets of hostile contents, and any bytes, at the plant's end of the wire."""

from __future__ import annotations

import socket
from functools import cache
from typing import Any

import hypothesis.strategies as st
import numpy as np

from benchmarks.reliability.fuzz_case import Kind, Verdict, Wrong
from moc_opt.model.robot_model import RobotModel, load_robot
from moc_opt.realtime import packets
from moc_opt.realtime.link import Link
from moc_opt.realtime.packets import Packet, layout
from moc_opt.realtime.remote import INCOMING, RemoteController
from moc_opt.realtime.settings import WireSettings
from moc_opt.scenario import Scenario, Setup, make_safety_filter
from moc_opt.sim.sensors import Measurement

KEY = b"k" * 16
TICKS = 3
_SCENARIO = 9
_FIELDS = {
    kind: [name for name in layout(kind, 7).names or () if name not in ("magic", "tag", "kind")]
    for kind in (packets.Kind.COMMAND, packets.Kind.REPORT, packets.Kind.BYE)
}
_VALUES = st.one_of(
    st.sampled_from([0, 1, -1, 7, 127, 128, 300, 2**31, 2**32 - 1, 2**62, 1e300, -1e308, 5e-324]),
    st.sampled_from([float("nan"), float("inf"), -float("inf"), 200.0, -36.0]), st.integers(0, 255),
    st.binary(max_size=20),
)  # fmt: skip


@st.composite
def _packets(draw: st.DrawFn) -> tuple[int, dict[str, Any]]:
    kind = draw(st.sampled_from(sorted(_FIELDS)))
    return int(kind), draw(st.dictionaries(st.sampled_from(_FIELDS[kind]), _VALUES, max_size=3))


wire_packets = st.lists(st.one_of(_packets(), st.binary(max_size=400)), min_size=1, max_size=8)
"""What arrives before each of the ticks: sealed packets with these fields changed, or bytes."""


class _NoTime:
    """A clock whose ticks are over as soon as they begin: only what has arrived already counts."""

    late_us, overruns, spare_until = 0.0, 0, 0.0

    def start(self) -> None:
        """Begin."""

    def wait_for(self, tick: int) -> float:
        """Return the end of a tick."""
        return 0.0


@cache
def _arm() -> tuple[RobotModel, Scenario, Setup]:
    scenario = Scenario()
    return load_robot(), scenario, Setup(scenario)


def wire_packet(case: list[Any]) -> Verdict:
    """Check ticks of the plant's end: "accepted" where a command was followed.

    Raises:
        Wrong: a torque or a column that the arm, or a trace, cannot have.
    """
    robot, scenario, setup = _arm()
    link = Link(robot.n, KEY, INCOMING, listen=("127.0.0.1", 0))
    peer, hold = socket.socket(socket.AF_INET, socket.SOCK_DGRAM), robot.gravity(robot.data.q_home)
    plant = RemoteController(
        link, WireSettings(hold_ticks=1, damp_ticks=1, wait_s=1.0), make_safety_filter(robot, scenario),
        setup.adapter().columns, hold, robot.tau_max, scenario=_SCENARIO, clock=_NoTime(),  # type: ignore[arg-type]
    )  # fmt: skip
    columns, limited = plant.columns(TICKS), np.zeros(TICKS, dtype=np.int8)
    seen = Measurement(np.array(robot.data.q_home), np.zeros(robot.n), np.zeros(6))
    nothing = (np.zeros((3, 3)), np.zeros((2, 3)))
    try:
        session = int(plant._packet["session"])
        for kind in (packets.Kind.HELLO, packets.Kind.START):
            hand = Packet(kind, robot.n, session if kind is packets.Kind.START else 0, _SCENARIO)
            peer.sendto(hand.seal(KEY), link.address)
        plant.start(seen, *nothing)
        for tick in range(TICKS):
            for what in case:
                data = what if isinstance(what, bytes) else _sealed(what, robot.n, session, tick)
                peer.sendto(data, link.address)
            tau = plant.tick(seen._replace(stamp=tick), *nothing)
            plant.note(tick, columns)
            limited[tick] = plant.limited
            if not (np.abs(tau) <= robot.tau_max).all():
                raise Wrong(f"a torque of {tau.tolist()} Nm was followed")
            if not plant.stop_reason.isprintable():
                raise Wrong(f"the reason {plant.stop_reason!r} steers a terminal")
        return "accepted" if link.quality.received else "refused"
    finally:
        peer.close()
        link.close()


def _sealed(what: tuple[int, dict[str, Any]], n: int, session: int, tick: int) -> bytes:
    packet = Packet(packets.Kind(what[0]), n, session, _SCENARIO)
    packet["sequence"] = tick
    for name, value in what[1].items():
        try:
            packet[name] = value
        except (ValueError, OverflowError, TypeError):
            continue  # nothing that the field's bytes can hold
    return bytes(packet.seal(KEY))


KINDS = {"wire_packet": Kind(wire_packet, wire_packets)}
