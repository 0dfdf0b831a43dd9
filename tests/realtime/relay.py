"""A relay that damages packets, and a scripted controller."""

import select
import socket
import threading
from collections import Counter
from types import SimpleNamespace
from typing import Any, Self

import numpy as np

from moc_opt.realtime.ends import INCOMING, RemoteController
from moc_opt.realtime.wire import ENDED, Kind, Link, WireSettings, make_packet, seal, written
from moc_opt.scenario import Scenario, make_safety_filter
from moc_opt.sim.sensors import Measurement

TO_PLANT, TO_CONTROLLER = 0, 1
END, BYE = (Kind.MEASUREMENT, ENDED), (Kind.BYE, 0)
FAULTS = ("drop", "double", "cut", "forge")


class Relay:
    """Pass packets between controller and plant. Each fault of FAULTS hits a packet with probability ``share``.

    ``lost(kind, number)`` is true for packets that never arrive.
    """

    def __init__(self, plant, share=0.0, lost=lambda kind, number: False, seed=0) -> None:
        self._plant, self._share, self._lost = plant, share, lost
        self._rng = np.random.default_rng(seed)
        self._ends = [socket.socket(socket.AF_INET, socket.SOCK_DGRAM) for _ in range(2)]
        for end in self._ends:
            end.bind(("127.0.0.1", 0))
        self._controller: tuple[str, int] | None = None
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self.done: list[Counter[str]] = [Counter(), Counter()]  # counts of faults, per direction
        self.whole: list[Counter[tuple[Kind, int]]] = [Counter(), Counter()]  # counts of whole packets, per direction

    @property
    def address(self) -> str:
        return written(self._ends[0].getsockname())

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._over.set()
        self._thread.join()
        for end in self._ends:
            end.close()

    def _run(self) -> None:
        while not self._over.is_set():
            for end in select.select(self._ends, [], [], 0.05)[0]:
                data, sender = end.recvfrom(4096)
                way = self._ends.index(end)
                if way == TO_PLANT:
                    self._controller = sender
                self._pass_on(data, way)

    def _pass_on(self, data: bytes, way: int) -> None:
        kind, number = Kind(data[5]), int.from_bytes(data[24:32], "little")
        if self._lost(kind, number):
            self.done[way]["lost"] += 1
            return
        fault = int(self._rng.uniform() / self._share) if self._share > 0.0 else len(FAULTS)
        name = FAULTS[fault] if fault < len(FAULTS) and not self._ended(way) else ""
        self.done[way][name] += 1
        if name == "cut":
            self._send(data[: len(data) // 2], way)
        elif name == "forge":
            at = int(self._rng.integers(0, len(data)))
            at += at == 5  # byte 5, the packet's kind, stays
            self._send(data[:at] + bytes([data[at] ^ 0x10]) + data[at + 1 :], way)
        for _ in range(0 if name in ("drop", "cut", "forge") else 2 if name == "double" else 1):
            if not self._ended(way):
                self.whole[way][kind, data[7]] += 1
            self._send(data, way)

    def _ended(self, way: int) -> bool:
        return (BYE if way == TO_PLANT else END) in self.whole[way]

    def _send(self, data: bytes, way: int) -> None:
        target = self._plant if way == TO_PLANT else self._controller
        if target is not None:
            self._ends[1 - way].sendto(data, target)


KEY, SCENARIO = b"k" * 16, 9
SETTINGS = WireSettings(hold_ticks=2, damp_ticks=3, wait_s=0.1)
NOTHING = np.zeros((3, 3)), np.zeros((2, 3))
NO_TIME: Any = SimpleNamespace(late_us=0.0, overruns=0, wait_for=lambda tick: 0.0)
"""A clock that never waits; the deadline of every tick has passed."""


class Peer:
    """A scripted controller (`say`) and the plant's end of the link (`plant`)."""

    def __init__(self, robot) -> None:
        self.n, self.k = robot.n, 0
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.link = Link(self.n, KEY, INCOMING, listen=("127.0.0.1", 0))
        self.hold = robot.gravity(robot.data.q_home)
        self.plant = RemoteController(
            self.link, SETTINGS, make_safety_filter(robot, Scenario()),
            lambda ticks: {"solve_us": np.full(ticks, np.nan)}, self.hold, robot.tau_max, SCENARIO, NO_TIME,
        )  # fmt: skip
        self.columns = self.plant.columns(50)
        self.session = int(self.plant._packet["session"])
        self.seen = Measurement(np.array(robot.data.q_home), np.zeros(self.n), np.zeros(6))

    def say(self, kind: Kind, number: int = 0, **values) -> None:
        packet = make_packet(kind, self.n, 0 if kind is Kind.HELLO else self.session, SCENARIO)
        for name, value in ({"sequence": number} | values).items():
            packet[name] = value
        self.socket.sendto(seal(packet, KEY), self.link.address)

    def start(self) -> None:
        self.say(Kind.HELLO)
        self.say(Kind.START)
        self.plant.start(self.seen, *NOTHING)

    def tick(self, v=0.0):
        self.plant.pace(self.k)
        tau = self.plant.tick(self.seen._replace(v=np.full(self.n, v), stamp=self.k), *NOTHING)
        self.plant.note(self.k, self.columns)
        self.k += 1
        return tau

    def close(self) -> None:
        self.socket.close()
        self.link.close()
