"""A scenario whose plant and controller are two processes, connected over UDP."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

from moc_opt.inputs.files import to_json
from moc_opt.realtime.clock import WallClock, give_back_realtime
from moc_opt.realtime.ends import INCOMING, Answering, RemoteController
from moc_opt.realtime.wire import Address, Kind, Link, WireError, parse_address, read_key
from moc_opt.robots.model import RobotModel, carried
from moc_opt.scenario.config import Scenario
from moc_opt.scenario.setup import Setup, make_safety_filter
from moc_opt.sim.protocols import LoggedController
from moc_opt.trace.trace import Trace

SLOWEST_S, FASTEST_S = 0.004, 0.001  # longest and shortest control period in real time [s]


def fingerprint(scenario: Scenario, robot: RobotModel) -> int:
    """Return a hash (63 bits) of task, control period and arm; the gains do not count."""
    whole = scenario.model_dump(mode="json", include={"robot", "start", "trocar", "task", "seed", "duration_s"})
    del whole["robot"]["name"]  # may be a path, which may differ at the other end
    whole["arm"] = {name: value for name, value in carried(robot).items() if name != "gains"}
    text = to_json([whole, scenario.plant.period_s], sort_keys=True)
    return int.from_bytes(hashlib.blake2s(text.encode(), digest_size=8).digest(), "little") >> 1


class PlantServer(Setup):
    """The plant of a scenario, for a controller in another process.

    It listens at ``listen``, "HOST:PORT" (port 0: any free port; ``address`` has its number). In lock-step, it
    waits for each command. In real time, the caller sets ``system`` to what `ask_for_realtime` returns.

    Raises:
        MocOptError: the scenario or the address is not usable.
    """

    def __init__(
        self, scenario: Scenario, listen: str, key_file: Path | None = None, *, lock_step: bool = False
    ) -> None:
        super().__init__(scenario)
        if scenario.control.follows:
            scenario.control.check_guided()
        where, period = parse_address(listen, "--listen"), scenario.plant.period_s
        if not lock_step and not FASTEST_S <= period <= SLOWEST_S:
            raise WireError(
                f"[plant] period_s = {period}: real time needs {FASTEST_S} to {SLOWEST_S} s (1 kHz to 250 Hz); "
                "change the period, or run in lock-step"
            )
        self.system: dict[str, str] = {}
        link = Link(self.robot.n, read_key(key_file, where[0], "--listen"), INCOMING, listen=where)
        self.address: Address = link.address
        self._remote = RemoteController(
            link, scenario.wire, make_safety_filter(self.robot, scenario), super().controller().columns,
            self.plant.applied_torque, self.robot.tau_max, scenario=fingerprint(scenario, self.robot),
            clock=None if lock_step else WallClock(period),
        )  # fmt: skip

    @cached_property
    def _new_guide(self) -> None:
        """None: the controller's process plans the course."""

    def controller(self) -> LoggedController:
        """Return the remote controller."""
        return self._remote  # type: ignore[return-value]

    def _judged(self, found: Trace) -> Trace:
        counts: dict[str, Any] = self._remote.close()  # before judging, which is slow
        if self.system:
            give_back_realtime()
            counts["system"] = self.system
        return super()._judged(found.with_meta(wire=counts))

    def trace(self, watch: Callable[[int], None] | None = None, to: str | os.PathLike[str] | None = None) -> Trace:
        """Wait for the controller, and run. ``watch`` is not called."""
        try:
            return super().trace(self._remote.pace, to)
        finally:
            self._remote.close()


def answer(
    scenario: Scenario, connect: str, key_file: Path | None = None, ready: Callable[[], None] = lambda: None
) -> dict[str, Any]:
    """Act as the controller of the plant at ``connect`` ("HOST:PORT") until the run ends.

    ``ready`` is called when the controller has started.

    Raises:
        MocOptError: the scenario is not usable, no plant answers, or the plant has another `fingerprint`.
    """
    where = parse_address(connect, "--connect")
    key = read_key(key_file, where[0], "--connect")
    setup = Setup(scenario, realtime=True)
    controller = setup.controller()  # before the link, because planning may take seconds
    link = Link(setup.robot.n, key, (Kind.MEASUREMENT,), peer=where)
    try:
        return Answering(
            link, scenario.wire, controller, make_safety_filter(setup.robot, scenario), *setup.inputs(),
            fingerprint(scenario, setup.robot), ready,
        ).run()  # fmt: skip
    finally:
        link.close()
