"""benchmarks/configs/speed.toml: what is measured, and how long it may take."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, field_validator

from benchmarks.common.config import Configuration
from moc_opt.inputs.settings import Settings
from moc_opt.scenario import Scenario

Count = Annotated[int, Field(ge=1)]


class TickTable(Settings):
    """Whole ticks and their parts."""

    KIND: ClassVar[str] = "[tick]"
    solvers: list[str] = Field(["exact", "daqp", "proxqp", "osqp"], min_length=1)
    ticks: int = Field(2000, ge=100)
    rounds: Count = 4

    @field_validator("solvers")
    @classmethod
    def _with_exact(cls, value: list[str]) -> list[str]:
        if "exact" not in value:
            raise ValueError("'exact' must be among them: the others are compared with it")
        return value


class ExactTable(Settings):
    """The solver ``exact`` on its own."""

    KIND: ClassVar[str] = "[exact]"
    joints: list[Annotated[int, Field(ge=6, le=20)]] = Field([6, 7, 8, 9])
    problems: int = Field(500, ge=100)
    batch: Count = 1_000_000


class AdapterTable(Settings):
    """Adapters against their libraries."""

    KIND: ClassVar[str] = "[adapters]"
    names: Literal["all"] | list[str] = "all"
    rounds: Count = 4


class LoopTable(Settings):
    """The closed loop."""

    KIND: ClassVar[str] = "[loop]"
    duration_s: float = Field(8.0, gt=0.0, le=60.0)
    runs: Count = 5
    two_process_rounds: int = Field(3, ge=0)
    memory_s: tuple[float, float] = (2.0, 8.0)

    @field_validator("memory_s")
    @classmethod
    def _shorter_first(cls, value: tuple[float, float]) -> tuple[float, float]:
        if not 0.1 <= value[0] < value[1]:
            raise ValueError("give the shorter length first, 0.1 s or more")
        return value


class SetupTable(Settings):
    """New processes."""

    KIND: ClassVar[str] = "[setup]"
    processes: int = Field(5, ge=0)


class PeerTable(Settings):
    """Other libraries."""

    KIND: ClassVar[str] = "[peers]"
    names: Literal["all"] | list[str] = "all"
    rounds: Count = 4


class Config(Configuration):
    """benchmarks/configs/speed.toml."""

    tick: TickTable = TickTable()
    exact: ExactTable = ExactTable()
    adapters: AdapterTable = AdapterTable()
    loop: LoopTable = LoopTable()
    setup: SetupTable = SetupTable()
    peers: PeerTable = PeerTable()
    scenario: Scenario = Scenario()

    def quick(self) -> Self:
        """Return the same on less data: for a first look and for the tests."""
        few = {
            "tick": {"ticks": min(self.tick.ticks, 400), "rounds": 1},
            "exact": {"problems": 100, "batch": min(self.exact.batch, 20_000)},
            "adapters": {"rounds": 1},
            "loop": {"duration_s": 1.0, "runs": 1, "two_process_rounds": 1, "memory_s": (0.5, 1.0)},
            "setup": {"processes": min(self.setup.processes, 1)},
            "peers": {"rounds": 1},
        }
        tables = {name: getattr(self, name).model_copy(update=values) for name, values in few.items()}
        return self.model_copy(update=tables)
