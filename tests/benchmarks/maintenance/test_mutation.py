"""The mutation tester: mutants are real, run instead of the source, and are told apart by what becomes of them."""

from __future__ import annotations

import ast
import json
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from benchmarks.common.output import default_config
from benchmarks.maintenance import mutation
from benchmarks.maintenance.mutants import make, trial
from moc_opt.errors import UnknownNameError

ROOT = Path(__file__).resolve().parents[3]
DENSE = "moc_opt.numerics.dense"
TEXT = (ROOT / "moc_opt" / "numerics" / "dense.py").read_text()
TESTS = ["tests/numerics/test_dense.py"]
needs_operators = pytest.mark.skipif(
    find_spec("cosmic_ray") is None, reason="cosmic-ray is not installed: pip install 'moc-opt[mutation]'"
)


@pytest.fixture(scope="module")
def plain():
    return trial.dependents(ROOT, DENSE)


def judge(source, plain, limit_s=240.0):
    return trial.run_tests(ROOT, DENSE, source, plain, TESTS, limit_s)


def changed(old, new):
    assert TEXT.count(old) >= 1
    return TEXT.replace(old, new, 1)


def test_kernels_run_as_plain_python_in_every_module_that_could_have_frozen_the_mutated_one(plain):
    ours = {"moc_opt.control.tick", "moc_opt.control.solution_check", "moc_opt.scenario", "tests.numerics.test_dense"}
    assert ours <= plain
    assert not {"moc_opt.model.kinematics_kernels", "moc_opt.solvers.exact.solver", "moc_opt.sim.plant"} & plain


@pytest.mark.parametrize("module", ["moc_opt.qp.residuals", "moc_opt.qp.extremes"])
def test_a_plain_function_is_in_no_kernel_and_a_constant_may_be(module):
    """The judge's tests ask the compiled exact solver, which cannot run as plain Python."""
    lines = make.module_file(ROOT, module).read_text().splitlines()
    constant = next(k for k, line in enumerate(lines, start=1) if " = 1e-" in line and not line.startswith(" "))
    body = next(k for k, line in enumerate(lines, start=1) if line.startswith("    return "))
    assert trial.may_hold(ROOT, module, constant) == trial.dependents(ROOT, module)
    assert trial.may_hold(ROOT, module, body) == set()
    in_a_kernel = TEXT.splitlines().index("    m = S.shape[0]") + 1
    assert trial.may_hold(ROOT, DENSE, in_a_kernel) == trial.dependents(ROOT, DENSE)


def test_the_source_itself_survives(plain):
    found = judge(TEXT, plain)
    assert (found.result, found.by) == ("survived", "")
    assert len(found.tests) > 5


@pytest.mark.parametrize(
    ("module", "test"),
    [("moc_opt.sim.period", "tests/sim/test_period.py"),
     ("moc_opt.control.safety_tick", "tests/control/test_safety_tick.py")],
)  # fmt: skip
def test_plain_python_calls_c_and_hands_read_only_arrays_to_compiled_kernels(module, test):
    found = trial.run_tests(ROOT, module, None, trial.dependents(ROOT, module), [test], 240.0, keep_going=True)
    assert found.tests
    assert all(passed for passed, _ in found.tests.values()), found.by


@pytest.mark.parametrize(
    ("old", "new"),
    [("d -= L[j, k] * L[j, k]", "d += L[j, k] * L[j, k]"), ("import numpy as np", "import no_such_module as np")],
)
def test_an_error_is_found_although_a_compiled_kernel_is_in_the_cache(old, new, plain):
    found = judge(changed(old, new), plain)
    assert found.result == "killed"
    assert "test_dense" in found.by
    assert (ROOT / "moc_opt" / "numerics" / "dense.py").read_text() == TEXT  # nothing was written


def test_one_that_never_ends_is_timed_out(plain):
    found = judge(changed("    m = S.shape[0]\n", "    while True:\n        pass\n"), plain, limit_s=8.0)
    assert found.result == "timed out"
    assert found.seconds >= 8.0


def test_one_that_ends_the_process_is_killed(plain):
    found = judge(changed("import numpy as np", "import numpy as np\nimport os\nos._exit(0)"), plain)
    assert (found.result, found.by) == ("killed", "the process ended")


@needs_operators
def test_mutants_compile_differ_in_one_line_and_leave_decorators_alone():
    found = make.sample(ROOT, make.places(ROOT, DENSE), 40, np.random.default_rng(3))
    assert len(found) == 40
    idle = make._idle_lines(TEXT)
    for one in found:
        ast.parse(one.source)
        old, new = TEXT.splitlines(), one.source.splitlines()
        assert [k + 1 for k, (a, b) in enumerate(zip(old, new, strict=True)) if a != b] == [one.line]
        assert one.before != one.after
        assert one.line not in idle
    again = make.sample(ROOT, make.places(ROOT, DENSE), 40, np.random.default_rng(3))
    assert again == found
    assert found != make.sample(ROOT, make.places(ROOT, DENSE), 40, np.random.default_rng(4))


@needs_operators
def test_augmented_assignments_are_mutated_too():
    places = [place for place in make.places(ROOT, DENSE) if place.operator == "ReplaceAugmented"]
    assert len(places) == sum(isinstance(node, ast.AugAssign) for node in ast.walk(ast.parse(TEXT)))
    made = {(one.before, one.after) for place in places if (one := make.mutant(ROOT, place))}
    assert ("d -= L[j, k] * L[j, k]", "d += L[j, k] * L[j, k]") in made


@needs_operators
def test_the_command(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "160")  # a narrow table breaks its headings
    config = f'sample = 3\nslowest_s = 60.0\n[modules]\n"{DENSE}" = ["tests/numerics/test_dense.py"]\n'
    (tmp_path / "small.toml").write_text(config)
    assert mutation.main([str(tmp_path / "small.toml"), "--out", str(tmp_path / "out"), "--seed", "5"]) == 0
    found = json.loads((tmp_path / "out" / "summary.json").read_text())
    total = found["total"]
    assert total["killed"] + total["timed_out"] + total["survived"] == 3
    assert found["modules"][DENSE]["places"] > 100
    assert len(found["modules"][DENSE]["survivors"]) == total["survived"]
    assert "share found" in capsys.readouterr().out


def test_a_share_counts_what_was_timed_out_and_leaves_out_what_is_equivalent():
    counts = {"killed": 17, "timed_out": 2, "survived": 1, "equivalent": 5}
    assert mutation.shares(counts) == {"share_of_all": 19 / 25, "share_found": 19 / 20}
    assert mutation.shares(dict.fromkeys(counts, 0)) == {"share_of_all": None, "share_found": None}
    assert mutation.total({"a": counts, "b": counts}, 0.95)["reached"]
    assert not mutation.total({"a": {**counts, "survived": 2}}, 0.95)["reached"]


def test_what_is_named_exists_and_what_is_called_equivalent_stands_in_the_source():
    config = mutation.Config.load(default_config("mutation"))
    for module, tests in config.modules.items():
        lines = {line.strip() for line in make.module_file(ROOT, module).read_text().splitlines()}
        assert all((ROOT / test).is_file() for test in tests)
        for entry in config.equivalent:
            assert entry.module in config.modules
            assert entry.module != module or entry.before in lines, entry


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(["--module", "moc_opt.numerics.densee"], "did you mean 'moc_opt.numerics.dense'"),
     (["--sample", "0"], "give 1 or"), (["nowhere.toml"], "nowhere.toml")],
)  # fmt: skip
def test_wrong_input_is_one_line(arguments, message, capsys):
    assert mutation.main(arguments) == 2
    assert message in capsys.readouterr().err


def test_a_module_that_is_not_there_is_named():
    with pytest.raises(make.MutationError, match=r"module 'moc_opt.nothing': no file .*nothing.py; give a dotted name"):
        make.module_file(ROOT, "moc_opt.nothing")
    config = mutation.Config.load(default_config("mutation"))
    with pytest.raises(UnknownNameError):
        config.choosing(["moc_opt"], None)
