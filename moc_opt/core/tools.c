/* The module's functions: the subproblem solved and judged, a QP library's buffers, planning, the simulated plant. */
#include "python.h"

/* --- the subproblem --- */

FUNCTION(solve_exact, {"record", READ, ROW}, {"tolerance", NUMBER}, {"x", WRITE, N}, {"y", WRITE, 6})
{
    moc_problem problem;
    moc_unpack_problem(c->array[0], c->n, &problem);
    return PyLong_FromLong(moc_solve_exact(&problem, c->number[1], c->array[2], c->array[3]));
}

FUNCTION(solve_exact_rows, {"records", READ, K, ROW}, {"tolerance", NUMBER}, {"X", WRITE, K, N},
         {"Y", WRITE, K, 6}, {"status", WRITE, K})
{
    Py_BEGIN_ALLOW_THREADS;
    for (Py_ssize_t i = 0; i < c->k; i++) {
        moc_problem problem;
        moc_unpack_problem(c->array[0] + i * (11 * c->n + 10), c->n, &problem);
        c->array[4][i] = moc_solve_exact(&problem, c->number[1], c->array[2] + i * c->n, c->array[3] + i * 6);
    }
    Py_END_ALLOW_THREADS;
    Py_RETURN_NONE;
}

FUNCTION(step_network, {"record", READ, ROW}, {"x", WRITE, N}, {"y", WRITE, 6}, {"steps", WHOLE},
         {"h_x", NUMBER}, {"h_y", NUMBER}, {"k", NUMBER}, {"scale", NUMBER},
         {"implicit", WHOLE}, {"rest", NUMBER})
{
    moc_problem problem;
    int made = 0;
    const moc_network net = {(int)c->whole[3], c->number[4], c->number[5], c->number[6], c->number[7], c->whole[8] != 0,
                             c->number[9]};
    moc_unpack_problem(c->array[0], c->n, &problem);
    moc_status status = moc_step_network(&problem, &net, c->array[1], c->array[2], &made);
    return Py_BuildValue("ii", (int)status, made);
}

FUNCTION(judge, {"record", READ, ROW}, {"Z", READ, K, N}, {"x", READ, N})
{
    moc_problem problem;
    double Z[MOC_MAX_JOINTS][MOC_MAX_JOINTS];
    int rows = moc_unpack_basis(c, 1, Z);
    moc_unpack_problem(c->array[0], c->n, &problem);
    moc_residuals r = moc_judge(&problem, rows, Z, c->array[2]);
    return Py_BuildValue("ddddd", r.primal, r.outside, r.natural, r.off, r.opposite);
}

FUNCTION(retreat, {"record", READ, ROW}, {"Z", READ, K, N}, {"x", WRITE, N})
{
    moc_problem problem;
    double Z[MOC_MAX_JOINTS][MOC_MAX_JOINTS];
    int rows = moc_unpack_basis(c, 1, Z);
    moc_unpack_problem(c->array[0], c->n, &problem);
    moc_retreat(&problem, rows, Z, c->array[2]);
    Py_RETURN_NONE;
}

FUNCTION(least_violation, {"record", READ, ROW}, {"x", WRITE, N})
{
    moc_problem problem;
    moc_unpack_problem(c->array[0], c->n, &problem);
    moc_least_violation(&problem, c->array[1]);
    Py_RETURN_NONE;
}

/* --- a QP library's buffers --- */

static void put_at(const call *c, int argument, Py_ssize_t i, Py_ssize_t j, double value)
{
    const Py_buffer *view = &c->view[argument];
    char *to = (char *)view->buf + i * view->strides[0] + (view->ndim > 1 ? j * view->strides[1] : 0);
    memcpy(to, &value, sizeof value);
}

FUNCTION(load, {"record", READ, ROW}, {"five", WHOLE}, {"scale", NUMBER}, {"signs", READ, 3},
         {"P", STRIDED, ANY, ANY}, {"p", STRIDED, ANY}, {"A", STRIDED, K, ANY}, {"low", STRIDED, K},
         {"high", STRIDED, K}, {"lower", STRIDED, ANY}, {"upper", STRIDED, ANY}, {"packed", STRIDED, ANY},
         {"lift", WRITE, K, 6})
{
    enum { FIVE = 1, SCALE, SIGNS, COST, LINEAR, ROWS, LOW, HIGH, LOWER, UPPER, PACKED, LIFT };
    moc_problem problem;
    double P[MOC_MAX_JOINTS][MOC_MAX_JOINTS], linear[MOC_MAX_JOINTS], A[6][MOC_MAX_JOINTS], b[6], lift[6][6];

    /* p, lower and upper are multiplied by the signs; packed: the upper triangle of P by columns, or empty */
    int n = c->n, m = (int)c->k, packed = rows_of(c, PACKED) > 0;
    double scale = c->number[SCALE];
    const double *signs = c->array[SIGNS];
    moc_unpack_problem(c->array[0], n, &problem);
    for (int i = COST; i <= UPPER; i++) /* another shape than the buffers have */
        if ((i == COST || i == LINEAR || i >= LOWER) && rows_of(c, i) != n)
            return PyBool_FromLong(0);
    if (c->view[COST].shape[1] != n || c->view[ROWS].shape[1] != n ||
        (packed && rows_of(c, PACKED) != n * (n + 1) / 2) ||
        moc_equalities(&problem, c->whole[FIVE] != 0, A, b, lift) != m)
        return PyBool_FromLong(0);
    memcpy(c->array[LIFT], lift, (size_t)m * sizeof *lift);
    moc_cost(&problem, P, linear);
    for (int i = 0, k = 0; i < n; i++) {
        for (int j = 0; j < n; j++)
            put_at(c, COST, i, j, scale * P[i][j]);
        for (int j = 0; j <= i && packed; j++)
            put_at(c, PACKED, k++, 0, scale * P[j][i]);
        put_at(c, LINEAR, i, 0, scale * signs[0] * linear[i]);
        put_at(c, LOWER, i, 0, signs[1] * problem.lower[i]);
        put_at(c, UPPER, i, 0, signs[2] * problem.upper[i]);
    }
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < n; j++)
            put_at(c, ROWS, i, j, A[i][j]);
        put_at(c, LOW, i, 0, b[i]);
        put_at(c, HIGH, i, 0, b[i]);
    }
    return PyBool_FromLong(1);
}

/* --- planning --- */

#define TASK {"arm", ARM}, {"low", READ, N}, {"high", READ, N}, {"target", READ, 2, 3}, {"active", MAYBE, ANY}

/* Arguments 0 to 4 of the functions below; 0 with an exception. */
static int take_task(const call *c, plan_task *task)
{
    *task = (plan_task){.arm = c->arm, .low = c->array[1], .high = c->array[2], .count = c->array[4] ? rows_of(c, 4) : 0};
    memcpy(task->target, c->array[3], sizeof task->target);
    for (int i = 0; i < task->count; i++) {
        if (task->count > c->n || !(c->array[4][i] >= 0.0 && c->array[4][i] < c->n)) {
            PyErr_Format(PyExc_ValueError, "active: give numbers of joints from 0 to %d", c->n - 1);
            return 0;
        }
        task->active[i] = (int)c->array[4][i];
    }
    return 1;
}

#define LONGEST_STEP 10.0 /* along a curve [rad] */

FUNCTION(follow_curve, TASK, {"q", READ, N}, {"tangent", READ, N}, {"step", NUMBER}, {"s", WRITE, K},
         {"poses", WRITE, K, N}, {"mus", WRITE, K})
{
    plan_task task;
    plan_end end;
    if (!take_task(c, &task))
        return NULL;
    if (c->k < 2 || c->k > INT_MAX / c->n)
        return PyErr_Format(PyExc_ValueError, "s has %zd entries: give 2 or more", c->k);
    if (!(c->number[7] > 0.0 && c->number[7] <= LONGEST_STEP))
        return PyErr_Format(PyExc_ValueError, "step: give a length above 0 and of at most %d rad", (int)LONGEST_STEP);
    int found = plan_follow(&task, c->array[5], c->array[6], c->number[7], (int)c->k, c->array[8], c->array[9],
                            c->array[10], &end);
    return Py_BuildValue("ii", found, (int)end);
}

FUNCTION(onto_curve, TASK, {"q", READ, N}, {"along", READ, N}, {"pose", WRITE, N})
{
    plan_task task;
    if (!take_task(c, &task))
        return NULL;
    return PyBool_FromLong(plan_correct(&task, c->array[5], c->array[6], c->array[7]));
}

FUNCTION(ascend, TASK, {"starts", WRITE, K, N}, {"mus", WRITE, K})
{
    plan_task task;
    if (!take_task(c, &task))
        return NULL;
    Py_BEGIN_ALLOW_THREADS;
    for (Py_ssize_t i = 0; i < c->k; i++)
        c->array[6][i] = plan_ascend(&task, c->array[5] + i * c->n);
    Py_END_ALLOW_THREADS;
    Py_RETURN_NONE;
}

FUNCTION(advance, {"branches", WHOLE}, {"q", READ, K, N}, {"slack", READ, K, N}, {"gain", READ, K},
         {"q_next", READ, ANY, N}, {"slack_next", READ, ANY, N}, {"value_next", READ, ANY}, {"step", READ, N},
         {"crossing", READ, ANY}, {"price", NUMBER}, {"worst", WHOLE}, {"value", WRITE, K},
         {"room", WRITE, ANY})
{
    Py_ssize_t branches = c->whole[0], m = rows_of(c, 8), after = rows_of(c, 4), next = 0, blocks = 0;
    int fits = branches >= 1 && m >= 1 && c->k == branches * m && after % branches == 0 && rows_of(c, 5) == after &&
               rows_of(c, 6) == after && c->k * c->n <= INT_MAX && after * c->n <= INT_MAX;
    if (fits) {
        next = after / branches;
        blocks = (next + PLAN_BLOCK - 1) / PLAN_BLOCK;
        fits = rows_of(c, 12) == branches * blocks * (2 * c->n + 1);
    }
    for (Py_ssize_t j = 0; j < m; j++)
        fits &= c->array[8][j] >= 0.0 && c->array[8][j] < (double)branches;
    if (!fits)
        return PyErr_Format(PyExc_ValueError, "advance: the rows are not those of so many branches and crossings");
    const plan_stage stage = {(int)branches, (int)m, (int)next, c->n, c->array[1], c->array[2], c->array[3], c->array[4],
                              c->array[5], c->array[6], c->array[7], c->array[8], c->number[9], c->whole[10] != 0};
    Py_BEGIN_ALLOW_THREADS;
    plan_advance(&stage, c->array[12], c->array[11]);
    Py_END_ALLOW_THREADS;
    Py_RETURN_NONE;
}

/* --- the simulated plant, and the wrist that is wanted --- */

FUNCTION(desired_wrist, {"X", READ, 3}, {"dX", READ, 3}, {"trocar", READ, 2, 3}, {"span", NUMBER},
         {"out", WRITE, 2, 3})
{
    moc_trocar trocar;
    memcpy(&trocar, c->array[2], sizeof trocar);
    moc_desired_wrist(c->array[0], c->array[1], &trocar, c->number[3], c->array[4], c->array[4] + 3);
    Py_RETURN_NONE;
}

FUNCTION(shaft_force, {"tip", READ, 3}, {"wrist", READ, 3}, {"twist", READ, 6}, {"origin", READ, 3},
         {"trocar", READ, 2, 3}, {"elapsed", NUMBER}, {"stiffness", NUMBER}, {"damping", NUMBER},
         {"force", WRITE, 3}, {"point", WRITE, 3})
{
    plant_shaft_force(c->array[0], c->array[1], c->array[2], c->array[3], c->array[4], c->number[5], c->number[6],
                      c->number[7], c->array[8], c->array[9]);
    Py_RETURN_NONE;
}

FUNCTION(add_force, {"wrench", WRITE, 6}, {"force", READ, 3}, {"point", READ, 3}, {"com", READ, 3})
{
    plant_add_force(c->array[0], c->array[1], c->array[2], c->array[3]);
    Py_RETURN_NONE;
}

FUNCTION(read_encoders, {"q", READ, N}, {"v", READ, N}, {"noise", READ, N}, {"memory", WRITE, 3, N},
         {"resolution", NUMBER}, {"period", NUMBER}, {"gain", NUMBER}, {"exact", WHOLE},
         {"reading", WRITE, TWICE})
{
    const plant_encoders e = {c->number[4], c->number[5], c->number[6], c->whole[7] != 0};
    plant_read_encoders(&e, c->n, c->array[0], c->array[1], c->array[2], c->array[3], c->array[8]);
    Py_RETURN_NONE;
}

PyMethodDef moc_functions[] = {
    FAST(solve_exact, solve_exact, "solve_exact(record, tolerance, x, y) -> status"),
    FAST(solve_exact_rows, solve_exact_rows, "solve_exact_rows(records, tolerance, X, Y, status): without the lock"),
    FAST(step_network, step_network,
         "step_network(record, x, y, steps, h_x, h_y, k, scale, implicit, rest) -> (status, steps made)"),
    FAST(judge, judge, "judge(record, Z, x) -> (primal, outside, natural, off, opposite); see answer.c"),
    FAST(retreat, retreat, "retreat(record, Z, x): the smallest self-motion x into the box"),
    FAST(least_violation, least_violation, "least_violation(record, x): the x of the box with the least |A x - b|"),
    FAST(load, load, "load(record, five, scale, signs, P, p, A, low, high, lower, upper, packed, lift) -> whether the\n"
                       "subproblem has the shape of these buffers, which hold it then; y6 = lift^T y"),
    FAST(follow_curve, follow_curve,
         "follow_curve(arm, low, high, target, active, q, tangent, step, s, poses, mus) -> (count, end); see tools.h"),
    FAST(onto_curve, onto_curve, "onto_curve(arm, low, high, target, active, q, along, pose) -> bool; see tools.h"),
    FAST(ascend, ascend, "ascend(arm, low, high, target, None, starts, mus): climb in place; see tools.h"),
    FAST(advance, advance,
         "advance(branches, q, slack, gain, q_next, slack_next, value_next, step, crossing, price, worst, value, room):\n"
         "one step of a value function; see tools.h"),
    FAST(desired_wrist, desired_wrist, "desired_wrist(X, dX, trocar, span, out): N_d and dN_d (2, 3)"),
    FAST(shaft_force, shaft_force,
         "shaft_force(tip, wrist, twist, origin, trocar, elapsed, stiffness, damping, force, point); see tools.h"),
    FAST(add_force, add_force, "add_force(wrench, force, point, com): add a force at a point to a body's wrench"),
    FAST(read_encoders, read_encoders,
         "read_encoders(q, v, noise, memory, resolution, period, gain, exact, reading); see tools.h"),
    {NULL, NULL, 0, NULL},
};
