"""Fixtures that several test files share."""

import contextlib
import os
import signal
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import settings
from numpy.typing import NDArray

from moc_opt.robots.model import RobotModel, load_robot
from moc_opt.robots.urdf import Joint, Link, Urdf
from moc_opt.trace.metrics import METRICS

Array = NDArray[np.float64]
Draw = Callable[..., list[Array]]

# The profile "long" draws new examples in every run.
settings.register_profile("repeatable", deadline=None, derandomize=True)
settings.register_profile("long", deadline=None, max_examples=5000, print_blob=True)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))

# A shell starts background jobs with SIGINT ignored.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

SLOW = (  # slowest first
    "tests/test_documents.py", "tests/test_wheel.py", "tests/planning/test_follow.py", "tests/study/test_engine.py",
    "tests/test_site.py", "tests/study/test_solvers.py", "tests/live/test_page.py", "tests/benchmarks/test_robots.py",
    "tests/benchmarks/test_speed.py", "tests/solvers/test_isolated.py", "tests/export/test_folder.py",
    "tests/benchmarks/test_paper.py", "tests/study/test_command.py",
)  # fmt: skip


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Return 1.5 workers per core, because tests often wait for a process."""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return cores + cores // 2


@pytest.hookimpl(tryfirst=True)  # before pytest selects by `-m slow`
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    place = {file: k for k, file in enumerate(SLOW, start=1)}
    assert all((config.rootpath / file).is_file() for file in place), "SLOW names a file that does not exist"
    order = {item: place.get(item.nodeid.partition("::")[0], 0) for item in items}
    for item in items:
        if order[item]:
            item.add_marker("slow")
    items.sort(key=order.__getitem__)


@pytest.fixture(autouse=True)
def registered_metrics() -> Iterator[None]:
    before = dict(METRICS)
    yield
    METRICS.clear()
    METRICS.update(before)


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    from moc_opt.errors import BrowserMissingError
    from moc_opt.report import export

    try:
        with export.browser() as running, pytest.MonkeyPatch.context() as patch:
            patch.setattr(export, "browser", lambda: contextlib.nullcontext(running))
            yield running
    except BrowserMissingError as missing:
        pytest.skip(str(missing))


@contextlib.contextmanager
def opened(
    chromium: Any, address: str, ready: str, own: str = "", kinds: tuple[str, ...] = (), script: str = "", **more: Any
) -> Iterator[Any]:
    """Yield an open page. Fail if it logs a message of `kinds` (default: any), or requests a URL not below `own`."""
    page, said, asked = chromium.new_page(**more), list[str](), list[str]()
    page.add_init_script(script)  # runs before the page's own scripts

    def hear(message: Any) -> None:
        # The graphics driver warns that reading pixels back is slow.
        if (not kinds or message.type in kinds) and "GPU stall due to ReadPixels" not in message.text:
            said.append(f"{message.type}: {message.text}")

    page.on("console", hear)
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto(address)
    page.wait_for_selector(ready, timeout=60_000)
    yield page
    page.close()
    assert said == []
    assert [url for url in asked if not url.startswith((own or address, "data:", "blob:"))] == []


@pytest.fixture(scope="session")
def robot() -> RobotModel:
    return load_robot()


@pytest.fixture(scope="session")
def regular_poses(robot: RobotModel) -> Draw:

    def draw(count: int = 20, seed: int = 0) -> list[Array]:
        rng = np.random.default_rng(seed)
        return [robot.random_regular_pose(rng) for _ in range(count)]

    return draw


@pytest.fixture(scope="session")
def odd_robot(tmp_path_factory: pytest.TempPathFactory) -> RobotModel:
    """An arm with seven oblique joints (the third is prismatic) and an off-axis tool."""
    folder, rng = tmp_path_factory.mktemp("odd"), np.random.default_rng(7)
    links, joints = [Link("link_0")], []
    for j in range(1, 8):
        xyz, rpy, com = rng.uniform(-0.3, 0.3, 3), rng.uniform(-2, 2, 3), rng.uniform(-0.1, 0.1, 3)
        axis, mass, moments = rng.normal(size=3), rng.uniform(0.5, 3), rng.uniform(0.010, 0.015, 3)
        kind, reach = ("prismatic", 0.3) if j == 3 else ("revolute", 2.5)
        limits = {"lower": -reach, "upper": reach, "velocity": 2.0, "effort": 50.0}
        links.append(Link(f"link_{j}", mass, (*moments, 0.0, 0.0, 0.0), com))
        axis /= np.linalg.norm(axis)
        joints.append(Joint(f"joint_{j}", kind, f"link_{j - 1}", f"link_{j}", xyz, rpy, axis, limits))
    (folder / "odd.urdf").write_text(Urdf(links, joints).to_text("odd"), encoding="utf-8")
    (folder / "odd.toml").write_text(
        'name = "odd"\nurdf = "odd.urdf"\n[frames]\nlast_link = "link_7"\nwrist_xyz_m = [0.02, 0.03, 0.01]\n'
        "tool_mount_xyz_m = [0.02, 0.03, 0.01]\ntool_mount_rpy_rad = [0.5, -0.4, 0.3]\n"
        "[home]\nq_rad = [0.3, 0.2, 0.1, -0.4, 0.5, -0.3, 0.2]\n",
        encoding="utf-8",
    )
    return load_robot(folder / "odd.toml")
