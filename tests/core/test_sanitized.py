"""The core under sanitizers: random chains, extreme inputs and damaged memory (`make sanitize` makes more of them)."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


FILL = "-ftrivial-auto-var-init="  # what new variables hold, for GCC from 12 on and Clang


def extremes(program, sanitizers=None):
    """What 800 courses print, built with other flags than `make sanitize` has."""
    flags = [] if sanitizers is None else [f"SANITIZERS={sanitizers}"]
    built = subprocess.run(["make", "-C", ROOT, "--no-print-directory", f"EXTREMES={program}", *flags, program],
                           capture_output=True, text=True, check=False)  # fmt: skip
    assert built.returncode == 0, built.stdout + built.stderr
    ran = subprocess.run([program, "800", "7"], capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    return ran.stdout


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler on the path")
def test_whatever_goes_in_the_torque_is_finite_and_no_array_is_left(tmp_path):
    shown = extremes(tmp_path / "extremes")
    counted = {name: int(count) for name, count in re.findall(r"^  (.+): (\d+)$", shown, re.MULTILINE)}
    for reason in ("running", "not started", "the controller's state is damaged", "measurements not believed",
                   "the tip has been off its reference", "the controller's torque is not finite"):  # fmt: skip
        assert counted[reason] > 0, reason
    knows = subprocess.run(["cc", f"{FILL}zero", "-xc", "-fsyntax-only", "-"], input=b"", check=False)
    for filling in () if knows.returncode else ("zero", "pattern"):
        assert extremes(tmp_path / filling, FILL + filling) == shown, "what a new variable holds decides something"
