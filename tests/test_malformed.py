"""Any input works or raises a MocOptError. `HYPOTHESIS_PROFILE=long` tries thousands of inputs."""

import contextlib

import hypothesis.strategies as st
import numpy as np
from hypothesis import example, given
from hypothesis.extra.numpy import array_shapes, arrays

import moc_opt as mo
from moc_opt.commands.running import read_waypoints
from moc_opt.inputs.files import to_toml
from moc_opt.realtime import wire
from moc_opt.scenario import Scenario, Setup, run
from moc_opt.sim import Plant
from moc_opt.sim.mjcf import check_engines
from moc_opt.solvers.base import Status
from moc_opt.tasks import Waypoints
from moc_opt.trace.metrics import summarize
from tests.inputs.test_files import header as npy
from tests.odd_inputs import edited, ends_well, junk, many, numbers, texts
from tests.problems import PARTS
from tests.realtime.relay import KEY, SCENARIO, SETTINGS, Peer
from tests.robots.arms import FOLDER

ARM_URDF = (FOLDER / "lwr4.urdf").read_bytes()
ARM_TOML = (FOLDER / "lwr4.toml").read_bytes().replace(b'"lwr4.urdf"', b'"arm.urdf"')


def fields(table=Scenario):
    """Yield the path of every field. A table comes before its fields."""
    for name, field in table.model_fields.items():
        yield (name,)
        if hasattr(field.annotation, "model_fields"):
            yield from ((name, *rest) for rest in fields(field.annotation))


usual = st.sampled_from([0.0, 1e-3, 0.02, 0.1, 0.5, 1.0, 2, True, False])  # scenarios with these values are often valid
strange = st.sampled_from(["typo", "", "seeds", "class", "duration", "model_config"])
values = st.one_of(usual, numbers, texts, junk)


def run_two_ticks(scenario):
    trace = run(scenario.change(duration_s=2.0 * scenario.plant.period_s, bound_samples=min(scenario.bound_samples, 2)))
    assert np.isfinite(trace.q_rad).all()
    assert np.isfinite(trace.tau_Nm).all()
    summarize(trace)


@many(0.5)
@given(st.lists(st.tuples(st.sampled_from(list(fields())), st.none() | strange, values), min_size=1, max_size=3))
@example([(("task", "path"), None, "circle")])
@example([(("control", "K_X"), None, 1e30)])
@example([(("seed",), None, 10**5000)])
@example([(("faults", "bump_N"), None, 1e300), (("faults", "bump_at_s"), None, 0.0)])
def test_a_scenario_runs_or_its_error_names_the_field(changes):
    table = {}
    for path, other, value in changes:
        inner = table
        for name in path[:-1]:
            inner = inner.setdefault(name, {}) if isinstance(inner, dict) else None
        if isinstance(inner, dict):
            inner[path[-1] if other is None else other] = value
    made = None
    with ends_well(*(name for path, other, _ in changes for name in (*path, other) if name)):
        made = Scenario(**table)
    if made is not None:
        with ends_well():
            run_two_ticks(made)


SCENARIO_TOML = to_toml({
    "name": "a run", "seed": 3, "duration_s": 0.1, "robot": {"name": "lwr4", "tool_length_m": 0.3},
    "start": {"swivel": 0.5}, "trocar": {"breathing_amplitude_m": 0.01, "breathing_direction": [1.0, 0.0, 0.0]},
    "task": {"path": "circle", "sizes": {"radius": 0.03}}, "plant": {"delay_ticks": 2}, "faults": {"bump_N": 5.0},
    "control": {"preset": "tuned", "supervisor": {"hold_ticks": 5}},
    "solver": {"name": "osqp", "settings": {"eps": 1e-8}},
})  # fmt: skip


def drive(robot):
    check_engines(robot)
    state = robot.state(robot.data.q_home)
    Plant(robot.data).step(robot.gravity(robot.data.q_home))
    assert all(np.isfinite(array).all() for array in (state.tip, state.wrist, state.M, state.h))
    assert np.linalg.eigvalsh(state.M).min() > 0.0


# Each file's reader, and a function that must accept the result.
READERS = {
    "scenario.toml": (Scenario.load, run_two_ticks), "arm.toml": (mo.load_robot, drive),
    "arm.urdf": (lambda path: mo.load_robot(path.with_suffix(".toml")), drive),
    "trace.parquet": (mo.load_trace, summarize),
    "points.csv": (lambda path: read_waypoints(str(path)),
                   lambda points: Waypoints(points, np.zeros(3), normal=(0.0, 0.0, 1.0), heading=(1.0, 0.0, 0.0))),
    "times.npy": (lambda path: Setup(Scenario(solver={"replay_us": str(path)})), lambda setup: setup.trace),
}  # fmt: skip
SOUND = {"scenario.toml": SCENARIO_TOML.encode(), "arm.toml": ARM_TOML, "arm.urdf": ARM_URDF}
REPEATED = (
    b"[", b"]", b"a.", b"[[robot]]\n", b'{"a":', b"<link/>", b"<link>", b"7", b"x", b"\0", b"1,2,3\n", b"0,0,1e308\n",
)  # fmt: skip


repeated_text = st.tuples(
    st.sampled_from([b"", b"seed = ", b"seed = 0x", b"[a", b'name = "', b"<robot>", b'{"digest": NaN, "plan": ']),
    st.sampled_from(REPEATED), st.sampled_from([0, 1, 3, 100, 5000, 100_000]), st.sampled_from([b"", b"]", b'"', b"}"]),
).map(lambda parts: parts[0] + parts[1] * parts[2] + parts[3])  # fmt: skip
headers = st.builds(
    npy, st.lists(st.integers(0, 10**9), max_size=3).map(tuple), st.sampled_from(["<f8", "<U1000", "|V8", "|O", "<U0"])
)
any_file = st.tuples(st.sampled_from(sorted(READERS)), st.one_of(repeated_text, headers, st.binary(max_size=300)))
edited_file = st.sampled_from(sorted(SOUND)).flatmap(
    lambda name: st.tuples(st.just(name), edited(SOUND[name].decode()))
)


@many(0.6)
@given(any_file | edited_file)
@example(("scenario.toml", SOUND["scenario.toml"]))
@example(("scenario.toml", b"x = " + b"[" * 100_000))
@example(("scenario.toml", b"seed = 0x" + b"7" * 5000))
@example(("scenario.toml", b'name = "${HOME} {0.__class__} !!python/object"\n'))
@example(("scenario.toml", b'[control]\npreset = "{0.__class__} %s"\n'))
@example(("scenario.toml", b"\xef\xbb\xbf" + SCENARIO_TOML.encode()))
@example(("scenario.toml", SCENARIO_TOML.encode("utf-16")))
@example(("points.csv", b"0,0,0\n0.01,0,0\n0.02,0,0.01\n"))
@example(("arm.toml", ARM_TOML))
@example(("arm.toml", b"x = " + b"[" * 100_000))
@example(("arm.urdf", b'<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]>' + ARM_URDF))
@example(("arm.urdf", b"<!ENTITY a 'b'>" + ARM_URDF))
@example(("arm.urdf", b"<robot>" + b"<link>" * 20_000 + b"</link>" * 20_000 + b"</robot>"))
def test_a_file_is_refused_or_what_it_describes_works(tmp_path, file):
    name, data = file
    (tmp_path / "arm.toml").write_bytes(ARM_TOML)
    (tmp_path / "arm.urdf").write_bytes(ARM_URDF)
    (tmp_path / name).write_bytes(data)
    read, use = READERS[name]
    with ends_well():
        use(read(tmp_path / name))


odd_arrays = arrays(np.float64, array_shapes(max_dims=3, max_side=8), elements=st.floats())
DISTORTIONS = {
    "scale": lambda value, number: value * number, "zero": lambda value, number: np.zeros_like(value),
    "first": lambda value, number: np.array([number, *value.flat[1:]], dtype=object).reshape(value.shape),
    "list": lambda value, number: value.tolist(),
}  # fmt: skip


@many()
@given(
    st.sampled_from([7, 7, 6, 3, 1]), st.integers(0, 2**32 - 1), st.dictionaries(
        st.sampled_from(PARTS), st.sampled_from(sorted(DISTORTIONS)) | numbers | junk | odd_arrays, max_size=3,
    ), numbers | st.sampled_from([1e-12, 1e12, 1e200]),
)  # fmt: skip
@example(7, 0, {}, 0)
def test_an_optimum_is_claimed_only_if_true_and_a_wrong_field_is_named(n, seed, changes, number):
    rng = np.random.default_rng(seed)
    u, J_tip, x = rng.normal(size=3), rng.normal(size=(3, n)), rng.uniform(-1.0, 1.0, n)
    J_wrist = J_tip + 0.4 * np.cross(rng.normal(size=(n, 3)), u / np.linalg.norm(u)).T  # the tool is rigid
    data = {
        "J_tip": J_tip, "J_wrist": J_wrist, "v_tip": J_tip @ x, "v_wrist": J_wrist @ x, "grad_mu": rng.normal(size=n),
        "lower": np.full(n, -2.0), "upper": np.full(n, 2.0),
    }  # fmt: skip
    for name, how in changes.items():
        known = isinstance(how, str) and how in DISTORTIONS and name in data
        data[name] = DISTORTIONS[how](data[name], number) if known else how
    qp = None
    with ends_well(*data):
        qp = mo.NullSpaceQP(**data)
    for name in ("exact", "rnn") if qp is not None else ():
        solver = mo.solvers.create(name)
        if solver.supports(qp) is None:
            with np.errstate(all="ignore"):
                answer = solver.start(qp).solve(qp)
                assert answer.x.shape == (n,)
                assert isinstance(answer.status, Status)
                if answer.status is Status.SOLVED:
                    assert np.isfinite(answer.x).all()
                    assert qp.residuals(answer.x, answer.y).verified() or not ordinary(qp)


def ordinary(qp):
    """Return whether all numbers are at most 1e3 and A is well conditioned."""
    largest = max(float(np.abs(array).max()) for array in (qp.A, qp.b, qp.lower, qp.upper, qp.grad_mu))
    sizes = np.linalg.svd(qp.A, compute_uv=False)
    return largest <= 1e3 and sizes[0] > 0.0 and sizes[sizes > 1e-9 * sizes[0]].min() > 1e-3 * sizes[0]


PACKETS = {
    int(kind): [name for name in wire.layout(kind, 7).names if name not in ("magic", "tag", "kind")]
    for kind in (wire.Kind.COMMAND, wire.Kind.BYE)
}
odd_fields = numbers | st.sampled_from([200.0, -36.0, 127, 300, 2**32 - 1]) | st.binary(max_size=20)
sealed = st.sampled_from(sorted(PACKETS)).flatmap(
    lambda kind: st.tuples(st.just(kind), st.dictionaries(st.sampled_from(PACKETS[kind]), odd_fields, max_size=3))
)


@many(0.5)
@given(arriving=st.lists(sealed | st.binary(max_size=400), min_size=1, max_size=8))
@example(arriving=[(int(wire.Kind.COMMAND), {})])
@example(arriving=[(int(wire.Kind.COMMAND), {"tau": float("nan")})])
@example(arriving=[(int(wire.Kind.COMMAND), {"flags": 1, "reason": b"\x1b[2J"})])
def test_no_packet_exceeds_the_torque_limits_or_puts_control_characters_on_a_terminal(robot, arriving):
    with contextlib.closing(Peer(robot)) as peer, ends_well():
        peer.start()
        for _ in range(SETTINGS.hold_ticks + SETTINGS.damp_ticks + 2):
            for one in arriving:
                data = one if isinstance(one, bytes) else packet(one, peer)
                peer.socket.sendto(data, peer.link.address)
            tau = peer.tick()
            assert (np.abs(tau) <= robot.tau_max).all()
            assert peer.plant.stop_reason.isprintable()


def packet(what, peer):
    made = wire.make_packet(wire.Kind(what[0]), peer.n, peer.session, SCENARIO)
    made["sequence"] = peer.k
    for name, value in what[1].items():
        with contextlib.suppress(ValueError, OverflowError, TypeError):  # the field cannot hold the value
            made[name] = value
    return wire.seal(made, KEY)
