"""Arms and poses that several test files share."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import settings
from numpy.typing import NDArray

import moc_opt
from moc_opt.model.robot_model import RobotModel, load_robot

Array = NDArray[np.float64]
Draw = Callable[..., list[Array]]
PACKAGE = Path(moc_opt.__file__).parent

# Properties are tested on the same examples in every run, however busy the machine; `benchmarks.fuzz` looks for others.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.load_profile("repeatable")


def stale_kernels(package: Path) -> list[Path]:
    """Cached kernels (.nbi, .nbc) that are older than something they may have been compiled from.

    A cache knows the file of its own kernel only: it is not compiled anew when a kernel in another file that it
    calls, or a constant that it froze, has changed. What counts is every file with a kernel, and every module of the
    package that such a file imports from.
    """
    texts = {path: path.read_text(encoding="utf-8") for path in package.rglob("*.py")}
    sources = {path for path, text in texts.items() if "njit" in text}
    for path in list(sources):
        for name in re.findall(r"^from moc_opt(\.[\w.]+)? import", texts[path], re.MULTILINE):
            module = package.joinpath(*name.strip(".").split("."))
            sources |= {module.with_suffix(".py"), module / "__init__.py"} & texts.keys()
    newest = max((path.stat().st_mtime for path in sources), default=0.0)
    cached = [path for kind in ("*.nbi", "*.nbc") for path in package.rglob(f"__pycache__/{kind}")]
    return [path for path in cached if path.stat().st_mtime < newest]


def pytest_configure(config: pytest.Config) -> None:
    """Before any worker starts: no test may run a kernel that is no longer in the source."""
    if not hasattr(config, "workerinput"):
        for path in stale_kernels(PACKAGE):
            path.unlink(missing_ok=True)


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    """A headless browser for the module."""
    from moc_opt.errors import BrowserMissingError
    from moc_opt.report import export  # late: few tests draw

    try:
        with export.browser() as running:
            yield running
    except BrowserMissingError as missing:
        pytest.skip(str(missing))


@pytest.fixture(scope="session")
def robot() -> RobotModel:
    """The LWR4+ with its default tool."""
    return load_robot()


@pytest.fixture(scope="session")
def regular_poses(robot: RobotModel) -> Draw:
    """A function `draw(count=20, seed=0)`: random poses away from joint limits, with mu > 0.05."""

    def draw(count: int = 20, seed: int = 0) -> list[Array]:
        rng = np.random.default_rng(seed)
        return [robot.random_regular_pose(rng) for _ in range(count)]

    return draw


@pytest.fixture(scope="session")
def odd_robot(tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    """Seven oblique joints, the third one prismatic, and a tool that is not on the last axis."""
    folder: Path = tmp_path_factory.mktemp("odd")
    rng = np.random.default_rng(7)
    parts = ['<robot name="odd"><link name="link_0"/>']
    for j in range(1, 8):
        xyz, rpy, com = rng.uniform(-0.3, 0.3, 3), rng.uniform(-2, 2, 3), rng.uniform(-0.1, 0.1, 3)
        axis, mass, moments = rng.normal(size=3), rng.uniform(0.5, 3), rng.uniform(0.010, 0.015, 3)
        kind, reach = ("prismatic", 0.3) if j == 3 else ("revolute", 2.5)
        parts.append(
            f'<link name="link_{j}"><inertial><origin xyz="{_join(com)}" rpy="0 0 0"/><mass value="{mass}"/>'
            f'<inertia ixx="{moments[0]}" ixy="0" ixz="0" iyy="{moments[1]}" iyz="0" izz="{moments[2]}"/>'
            f'</inertial></link><joint name="joint_{j}" type="{kind}"><parent link="link_{j - 1}"/>'
            f'<child link="link_{j}"/><origin xyz="{_join(xyz)}" rpy="{_join(rpy)}"/>'
            f'<axis xyz="{_join(axis / np.linalg.norm(axis))}"/>'
            f'<limit lower="{-reach}" upper="{reach}" velocity="2" effort="50"/></joint>'
        )
    (folder / "odd.urdf").write_text("".join(parts) + "</robot>", encoding="utf-8")
    (folder / "odd.toml").write_text(
        'name = "odd"\nurdf = "odd.urdf"\n[frames]\nlast_link = "link_7"\nwrist_xyz_m = [0.02, 0.03, 0.01]\n'
        "tool_mount_xyz_m = [0.02, 0.03, 0.01]\ntool_mount_rpy_rad = [0.5, -0.4, 0.3]\n"
        "[home]\nq_rad = [0.3, 0.2, 0.1, -0.4, 0.5, -0.3, 0.2]\n",
        encoding="utf-8",
    )
    return load_robot(folder / "odd.toml")


def _join(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)
