"""The core's binding refuses wrong arguments and names them."""

import numpy as np
import pytest

from moc_opt import core, load_robot
from tests.control.torques import law
from tests.problems import random_problem

QP = random_problem(np.random.default_rng(0))
ROBOT = load_robot()
READ_ONLY = np.zeros(7)
READ_ONLY.setflags(write=False)


@pytest.mark.parametrize(("name", "wrong"), [
    ("record", QP.row[:-1]), ("record", QP.row.astype(np.float32)), ("record", QP.row.reshape(3, 29)),
    ("record", "text"), ("record", QP.row.astype(">f8")), ("record", memoryview(QP.row)), ("x", np.zeros(6)),
    ("x", np.zeros(14)[::2]), ("x", READ_ONLY), ("x", np.zeros(7, int)), ("x", None), ("y", np.zeros((6, 1))),
    ("x", np.zeros(64, np.uint8)[1:57].view(float)), ("y", np.zeros(5)), ("rest", "1e-9"),
])  # fmt: skip
def test_wrong_array_is_named_in_the_exception(name, wrong):
    sound = {"record": QP.row, "x": np.zeros(7), "y": np.zeros(6), "steps": 1, "h_x": 1.0, "h_y": 1.0, "k": 1.0,
             "scale": -1.0, "implicit": 0, "rest": 0.0}  # fmt: skip
    core.step_network(*sound.values())  # scale = -1 must not be taken for Python's error code -1
    with pytest.raises((TypeError, ValueError), match="real number" if name == "rest" else f"{name}: give"):
        core.step_network(*{**sound, name: wrong}.values())


def test_wrong_number_of_arguments_rows_or_columns_is_refused():
    for count in (1, 3):
        with pytest.raises(TypeError, match="takes 2 arguments"):
            core.solve_exact(*[QP.row] * count)
    for first, others in ((0, 3), (2, 3), (2, 0)):  # all arrays need the same number of rows
        with pytest.raises(ValueError, match="X: give"):
            core.solve_exact_rows(np.zeros((first, 87)), 1e-9, *map(np.zeros, ((others, 7), (others, 6), others)))
    with pytest.raises(ValueError, match=r"shape \(n, 27\) for 1 to 16 joints"):
        core.Arm(np.zeros((7, 26)), np.zeros((2, 3)), np.eye(3), np.ones((2, 7)), np.zeros(3))
    for rows in (np.zeros((2, 88)), np.zeros(87), np.zeros((2, 10)), np.zeros((0, 187 + 10))):
        with pytest.raises(ValueError, match="11 n \\+ 10"):
            core.solve_exact_rows(rows, 1e-9, np.zeros((2, 7)), np.zeros((2, 6)), np.zeros(2))
    for n in (0, 17):
        with pytest.raises(ValueError, match="1 to 16 joints"):
            core.Arm(np.zeros((n, 27)), np.zeros((2, 3)), np.eye(3), np.ones((2, n)), np.zeros(3))
    for points in (0, 3):
        with pytest.raises(ValueError, match=f"target has {points} rows"):
            ROBOT.arm.nearest_pose(ROBOT.q_min, ROBOT.q_max, np.zeros((points, 3)), ROBOT.q_min, 5)


@pytest.mark.parametrize(("count", "step"), [(0, 0.02), (1, 0.02), (9, 0.0), (9, np.inf), (9, np.nan)])
def test_curve_with_too_few_samples_or_wrong_step_is_refused(count, step):
    state = ROBOT.state(ROBOT.data.q_home)
    task = ROBOT.q_min, ROBOT.q_max, np.array([state.tip, state.wrist]), np.array(state.q), np.ones(7)
    with pytest.raises(ValueError, match="2 samples or more"):
        ROBOT.arm.follow_curve(*task, step, np.zeros(count), np.zeros((count, 7)), np.zeros(count))


def test_arrays_have_their_documented_shapes():
    assert ROBOT.state(ROBOT.data.q_home).record.shape == (7 * 7 + 13 * 7 + 18,)
    status, x, y = core.solve_exact(QP.row, 1e-9)
    assert (status, x.shape, y.shape) == (core.OK, (7,), (6,))


@pytest.mark.parametrize("k", range(4))
def test_law_refuses_wrong_arrays(k):
    made, given = law(7), [np.zeros(7), np.zeros(7), np.zeros((3, 3)), np.ones((2, 3))]
    made.start(*given)
    given[k].flat[-1] = np.nan
    with pytest.raises(ValueError, match="finite numbers"):
        made.begin(*given, None)
    made.load(QP.row, np.eye(7))
    with pytest.raises(ValueError, match="8 rows"):
        made.load(QP.row, np.eye(8, 7))


ROWS = (2, np.zeros((4, 3)), np.zeros((4, 3)), np.zeros(4), np.zeros((6, 3)), np.zeros((6, 3)), np.zeros(6), np.ones(3),
        np.zeros(2), 0.0, 2, 1.0)  # fmt: skip


@pytest.mark.parametrize(("k", "wrong"), [
    (0, 3), (0, 4), (2, np.zeros((2, 3))), (3, np.zeros(3)), (4, np.zeros((4, 3))), (5, np.zeros((4, 3))),
    (6, np.zeros(4)), (7, np.ones(2)), (8, np.zeros(4)), (8, np.array([0.0, 2.0])), (8, np.array([-1.0, 0.0])),
    (8, np.array([0.0, np.nan])), (10, 3), (10, -1),
])  # fmt: skip
def test_wrong_arguments_of_dynamic_programming_are_refused(k, wrong):
    np.testing.assert_array_equal(core.advance(*ROWS), np.zeros(4))
    with pytest.raises(ValueError, match=r"give|branches and crossings"):
        core.advance(*ROWS[:k], wrong, *ROWS[k + 1 :])
