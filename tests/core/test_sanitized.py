"""The core under sanitizers: random arms, extreme inputs and damaged memory."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DIGEST = "041fbbc03cff2896"  # of 300 random runs, equal for every compiler
FILL = "-ftrivial-auto-var-init="  # compiler flag that initializes unset variables


@pytest.fixture(scope="module")
def sanitized(tmp_path_factory):
    """Return a module built with sanitizers, its object files, and the sanitizers' libraries."""
    if shutil.which("gcc") is None:
        pytest.skip("no GCC on the path")
    libraries = [subprocess.run(["gcc", f"-print-file-name=lib{name}.so"], capture_output=True, text=True,
                                check=True).stdout.strip() for name in ("asan", "ubsan")]  # fmt: skip
    if not all(Path(library).is_absolute() for library in libraries):
        pytest.skip("GCC has no sanitizers here")
    place = tmp_path_factory.mktemp("sanitized")
    flags = "-Og -fsanitize=address,undefined -fno-sanitize-recover=undefined -fno-builtin-sin -fno-builtin-cos"
    (place / "cc").write_text(f'#!/bin/sh\nexec gcc "$@" {FILL}pattern {flags}\n')  # -Og compiles faster than -O1
    (place / "cc").chmod(0o755)
    built = subprocess.run([sys.executable, "setup.py", "-q", "build_ext", "--build-lib", place, "--build-temp", place],
                           cwd=ROOT, env=os.environ | {"CC": str(place / "cc")}, capture_output=True, text=True,
                           check=False)  # fmt: skip
    assert built.returncode == 0, built.stderr
    (module,) = (place / "moc_opt/core").glob("_core*")
    return module, list((place / "moc_opt/core").glob("*.o")), libraries


def extremes(program, *options):
    built = subprocess.run(["make", "-C", ROOT, "--no-print-directory", f"EXTREMES={program}", *options, program],
                           capture_output=True, text=True, check=False)  # fmt: skip
    assert built.returncode == 0, built.stdout + built.stderr
    ran = subprocess.run([program, "300", "7"], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout


def test_torque_of_the_safety_filter_is_finite_for_extreme_inputs(sanitized, tmp_path):
    core = [str(file) for file in sanitized[1] if not file.name.startswith(("python", "arguments", "plant."))]
    shown = extremes(tmp_path / "extremes", "CC=gcc", f"CORE={' '.join(core)}")
    counted = {name: int(count) for name, count in re.findall(r"^  (.+): (\d+)$", shown, re.MULTILINE)}
    for reason in ("running", "not started", "the controller's state is damaged", "measurements not believed",
                   "the tip has been off its reference", "the controller's torque is not finite"):  # fmt: skip
        assert counted[reason] > 0, reason
    assert f"digest {DIGEST}\n" in shown, "the core's results have changed"
    plain = extremes(tmp_path / "plain", "CC=gcc", f"SANITIZERS={FILL}zero")
    assert plain == shown, "an unset variable changes a result"


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


def test_binding_makes_no_access_outside_an_array(sanitized):
    command = [sys.executable, "-c", UNDER_THE_SANITIZER, sanitized[0], *(f"tests/{name}" for name in TESTS)]
    options = {"LD_PRELOAD": ":".join(sanitized[2]), "ASAN_OPTIONS": "detect_leaks=0"}
    ran = subprocess.run(command, cwd=ROOT, env=os.environ | options, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout[-2000:] + ran.stderr[-4000:]
