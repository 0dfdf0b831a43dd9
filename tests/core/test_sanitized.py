"""The core under sanitizers: random arms, extreme inputs and damaged memory."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


DIGEST = "041fbbc03cff2896"
"""Digest of 300 random runs, equal for every compiler."""

FILL = "-ftrivial-auto-var-init="  # compiler flag that initializes unset variables


def extremes(program, sanitizers=None):
    """Return the output of 300 random runs."""
    flags = [] if sanitizers is None else [f"SANITIZERS={sanitizers}"]
    built = subprocess.run(["make", "-C", ROOT, "--no-print-directory", f"EXTREMES={program}", *flags, program],
                           capture_output=True, text=True, check=False)  # fmt: skip
    assert built.returncode == 0, built.stdout + built.stderr
    ran = subprocess.run([program, "300", "7"], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler on the path")
def test_torque_of_the_safety_filter_is_finite_for_extreme_inputs(tmp_path):
    shown = extremes(tmp_path / "extremes")
    counted = {name: int(count) for name, count in re.findall(r"^  (.+): (\d+)$", shown, re.MULTILINE)}
    for reason in ("running", "not started", "the controller's state is damaged", "measurements not believed",
                   "the tip has been off its reference", "the controller's torque is not finite"):  # fmt: skip
        assert counted[reason] > 0, reason
    assert f"digest {DIGEST}\n" in shown, "the core's results have changed"
    knows = subprocess.run(["cc", f"{FILL}zero", "-xc", "-fsyntax-only", "-"], input=b"", check=False)
    for filling in () if knows.returncode else ("zero", "pattern"):
        assert extremes(tmp_path / filling, FILL + filling) == shown, "an unset variable changes a result"


UNDER_THE_SANITIZER = """
import importlib.util, sys, pytest
spec = importlib.util.spec_from_file_location("moc_opt.core._core", sys.argv[1])
sys.modules[spec.name] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(sys.modules[spec.name])
sys.exit(pytest.main(["-xq", "-p", "no:cacheprovider", *sys.argv[2:]]))
"""
TESTS = ("core/test_binding.py", "core/test_law.py", "control/test_levels.py", "sim/test_plant.py",
         "sim/test_contact.py", "planning/test_self_motion.py", "robots/test_inverse_kinematics.py",
         "solvers/test_rnn.py")  # fmt: skip


def test_binding_makes_no_access_outside_an_array(tmp_path):
    """Run `TESTS` with an extension module that is built with sanitizers."""
    if shutil.which("gcc") is None:
        pytest.skip("no GCC on the path")
    libraries = [subprocess.run(["gcc", f"-print-file-name=lib{name}.so"], capture_output=True, text=True,
                                check=True).stdout.strip() for name in ("asan", "ubsan")]  # fmt: skip
    if not all(Path(library).is_absolute() for library in libraries):
        pytest.skip("GCC has no sanitizers here")
    flags = f"-O1 -fsanitize=address,undefined -fno-sanitize-recover=undefined {FILL}pattern"
    built = subprocess.run([sys.executable, "setup.py", "-q", "build_ext", "--build-lib", tmp_path, "--build-temp",
                            tmp_path], cwd=ROOT, env=os.environ | {"CC": "gcc", "CFLAGS": flags}, capture_output=True,
                           text=True, check=False)  # fmt: skip
    assert built.returncode == 0, built.stderr
    (module,) = (tmp_path / "moc_opt/core").glob("_core*")
    ran = subprocess.run(
        [sys.executable, "-c", UNDER_THE_SANITIZER, module, *(f"tests/{name}" for name in TESTS)], cwd=ROOT,
        env=os.environ | {"LD_PRELOAD": ":".join(libraries), "ASAN_OPTIONS": "detect_leaks=0"}, capture_output=True,
        text=True, check=False,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stdout[-2000:] + ran.stderr[-4000:]
