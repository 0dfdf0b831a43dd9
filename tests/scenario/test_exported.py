"""The exported folder: what is in it builds without a warning, passes its own tests, and bears any number."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from moc_opt.__main__ import main
from moc_opt.embedded.compiler import FLAGS, find_compiler
from moc_opt.errors import ControlError, ScenarioError
from moc_opt.scenario import Scenario
from moc_opt.scenario.exported import Exported, export_scenario

STATES = 50_000
STRICT = f"CFLAGS={' '.join(FLAGS)} -Werror"

pytestmark = pytest.mark.skipif(
    shutil.which("make") is None or not any(map(shutil.which, ("cc", "gcc", "clang"))), reason="no make or C compiler"
)

LAWS: dict[str, dict[str, Any]] = {
    "default": {},
    "damping": {"control": {"fallback": "damping"}},
    "hold": {"control": {"fallback": "hold", "supervisor": {"hold_ticks": 2}}},
    "budget": {"control": {"supervisor": {"budget_us": 1000.0, "late": "iterate"}}},
    "dcac": {"control": {"law": "dcac"}},
    "dcac-damped": {"control": {"law": "dcac", "dcac_damping": 2.0, "limit_torque": False},
                    "guard": {"trocar_force_N": None, "patience_ticks": 1}},
}  # fmt: skip

FARTHEST = ("default", "dcac-damped")
"""The laws that differ most: an error put into the guard, which all share, is found with each of them."""


@pytest.fixture(scope="module", params=LAWS)
def exported(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Exported]:
    """One law's folder."""
    out = tmp_path_factory.mktemp(request.param)
    return out, export_scenario(Scenario(**LAWS[request.param], duration_s=1.0), out)


def make(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["make", "-C", str(folder), *words], capture_output=True, text=True, timeout=300)


def test_it_compiles_without_a_warning_and_repeats_what_python_did(exported: tuple[Path, Exported]) -> None:
    folder, found = exported
    assert sorted(found.files) == sorted(folder.iterdir())
    done = make(folder, "test", STRICT)
    assert "-Wconversion" in done.stdout
    assert done.returncode == 0, done.stdout + done.stderr
    said = re.search(r"(\d+) ticks with faults, (\d+) limited, measurements not believed \(tick (\d+)\)", done.stdout)
    assert said is not None, done.stdout
    ticks, limited, stopped_at = map(int, said.groups())
    assert ticks == 50
    assert limited > 0
    assert 10 <= stopped_at < ticks


@pytest.mark.parametrize("exported", FARTHEST, indirect=True)
def test_the_test_of_the_whole_controller_can_fail(exported: tuple[Path, Exported], tmp_path: Path) -> None:
    """With a guard that believes other jumps, or a recorded torque that is off; only what has changed is compiled."""
    folder = exported[0]
    for name, old, new in (
        ("moc_guard.c", "state->bad++;", "state->bad--;"),
        ("moc_constants.h", "MOC_TORQUE_STEP ", "MOC_TORQUE_STEP 0.01 * "),
        ("moc_motion.c", "return newer ? MOC_FRESH : MOC_REPEAT;", "return MOC_FRESH;"),
    ):
        wrong = Path(shutil.copytree(folder, tmp_path / name))
        text = (wrong / name).read_text()
        assert old in text
        (wrong / name).write_text(text.replace(old, new))
        done = make(wrong, "test")
        assert done.returncode != 0, (name, done.stdout)
        assert "ticks with faults" in done.stdout, done.stderr


def sanitizers_missing(folder: Path) -> str:
    """Why no program with the sanitizers can be built or run here; empty where it can."""
    (folder / "probe.c").write_text("int main(void) { return 0; }\n")
    try:
        compiler = find_compiler()
        subprocess.run(
            [*compiler, "-fsanitize=address,undefined", "probe.c", "-o", "probe"],
            cwd=folder, check=True, capture_output=True, text=True, timeout=60,
        )  # fmt: skip
        subprocess.run([str(folder / "probe")], check=True, capture_output=True, text=True, timeout=60)
    except (OSError, subprocess.SubprocessError) as error:
        return f"{error} {getattr(error, 'stderr', '')}"[-300:]
    return ""


def test_random_and_extreme_states_give_finite_torques_within_limits(
    exported: tuple[Path, Exported], tmp_path: Path
) -> None:
    """`make sanitize` at a twentieth of its length: addresses and undefined behaviour are watched."""
    missing = sanitizers_missing(tmp_path)
    if missing:
        pytest.skip(f"the compiler's sanitizers do not work here: {missing}")
    flags = re.search(r"^SANITIZE = (.*-O1.*)$", (exported[0] / "Makefile").read_text(), re.MULTILINE)
    assert flags is not None
    # Compiled without optimization, in a third of the time: the sanitizers see no less.
    done = make(exported[0], "sanitize", f"STATES={STATES}", STRICT, f"SANITIZE={flags[1].replace('-O1', '-O0')}")
    assert done.returncode == 0, done.stdout + done.stderr
    assert "every torque finite and within its limits" in done.stdout
    counted = {name: int(count) for name, count in re.findall(r"^  (.+): (\d+)$", done.stdout, re.MULTILINE)}
    # Neither all sound nor all stopped at once: the inside of the controller was reached, and every way out of it.
    assert counted["running"] > STATES // 2
    for reason in ("measurements not believed", "the controller's state is damaged",
                   "the RCM error has been above its limit", "the tip has been off its reference",
                   "the controller's torque is not finite"):  # fmt: skip
        assert counted[reason] > 0, reason
    if "fault 1" in counted:
        assert min(counted["fault 0"], counted["fault 1"], counted["fault 2"]) > 0


@pytest.mark.parametrize("exported", FARTHEST, indirect=True)
def test_the_program_finds_a_torque_beyond_the_limits(exported: tuple[Path, Exported], tmp_path: Path) -> None:
    """Without the last clip and the guard's own limit, some state gets through."""
    wrong = Path(shutil.copytree(exported[0], tmp_path / "wrong"))
    text = (wrong / "moc_guard.c").read_text()
    line = "        tau[i] = fmin(fmax(tau[i], -moc_tau_max[i]), moc_tau_max[i]);\n"
    assert line in text
    (wrong / "moc_guard.c").write_text(text.replace(line, ""))
    text = (wrong / "moc_safe.c").read_text()
    clip = "moc_clip(tau[i], -moc_tau_max[i], moc_tau_max[i])"
    assert clip in text
    (wrong / "moc_safe.c").write_text(text.replace(clip, "tau[i]"))
    done = make(wrong, "sanitize", f"STATES={STATES}", "SANITIZE=-O1")
    assert done.returncode != 0, done.stdout


# Constants, and sizes that are n at most: of a system (m), a null space (rows, count, rank), a loop outside (i, j).
BOUNDS = {
    *(f"< {bound}" for bound in (
        "2", "3", "6", "7", "9", "12", "MOC_N", "MOC_FAULTS", "SWEEPS", "2 * MOC_N", "MOC_N - plane->rank", "m", "rows",
        "count", "plane->rank", "i", "j", "one - one % 2",
    )),
    ">= 0",
}  # fmt: skip


def test_no_heap_no_recursion_and_every_loop_is_bounded(exported: tuple[Path, Exported]) -> None:
    folder = exported[0]
    calls: dict[str, set[str]] = {}
    for path in folder.glob("moc_*.c"):
        text = re.sub(r"/\*.*?\*/", "", path.read_text(), flags=re.DOTALL)
        assert not re.search(r"\b(malloc|calloc|realloc|free|alloca|setjmp|longjmp)\s*\(|\bgoto\b", text), path.name
        bodies = re.findall(r"^(?:static )?[\w *]+?(\w+)\([^;{]*\)\s*\{(.*?)^\}", text, re.DOTALL | re.MULTILINE)
        for name, body in bodies:
            calls[name] = set(re.findall(r"\b(\w+)\s*\(", body))
        if path.name == "moc_tick.c" or path.name == "moc_arm.c":
            continue
        for head in re.findall(r"\bfor \((.*?)\)(?=\s)", text):
            start, bound, step = (part.strip() for part in head.split(";"))
            variable = start.split(" =")[0].split()[-1]
            assert step in (f"{variable}++", f"{variable}--"), (path.name, head)
            assert bound.removeprefix(f"{variable} ").split(" &&")[0] in BOUNDS, (path.name, head)
        for loop in re.findall(r"\bwhile \((.*?)\)(?=\s)", text):
            assert loop == "plane.rank < 5", (path.name, loop)  # every turn adds to the rank, or breaks off
    assert {"moc_safe_step", "moc_tick_levels", "moc_guard_limit"} <= set(calls)

    def reaches(name: str, seen: frozenset[str] = frozenset()) -> None:
        assert name not in seen, f"{name} calls itself"
        for called in calls.get(name, set()) & set(calls):
            reaches(called, seen | {name})

    for name in calls:
        reaches(name)


@pytest.mark.parametrize(
    ("tables", "kind", "words"),
    [
        ({"solver": {"replay_us": [10.0]}}, ScenarioError, r"\[solver\] replay_us = \(10.0,\).*leave it out"),
        ({"solver": {"name": "rnn"}}, ControlError, r"\[solver\] name = 'rnn'.*'exact' only"),
    ],
)  # fmt: skip
def test_what_c_cannot_do_is_refused_by_name(tmp_path: Path, tables: Any, kind: Any, words: str) -> None:
    with pytest.raises(kind, match=words):
        export_scenario(Scenario(**tables), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_command_says_what_it_wrote_and_how_long_a_step_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenario = tmp_path / "scenario.toml"
    scenario.write_text("duration_s = 0.5\n")
    out = tmp_path / "c"
    assert main(["export-c", str(scenario), "--out", str(out)]) == 0
    said = capsys.readouterr().out
    stated = re.search(r"longest step: (\d+) floating-point operations", said)
    assert stated is not None
    assert f"MOC_OPERATIONS {stated[1]} " in " ".join((out / "moc_constants.h").read_text().split())
    for path in out.iterdir():
        assert str(path) in said
