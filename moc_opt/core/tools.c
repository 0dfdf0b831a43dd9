/* The module's functions: the subproblem solved and judged, a QP library's buffers, planning, the simulated plant. */
#include "python.h"

/* --- the subproblem --- */

static PyObject *solve_exact(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    moc_problem problem;
    call c;
    (void)module;

    if (!TAKE(&c, 0, "solve_exact", {"record", READ, ROW}, {"tolerance", NUMBER}, {"x", WRITE, N}, {"y", WRITE, 6}))
        return NULL;
    moc_unpack_problem(c.array[0], c.n, &problem);
    return whole(&c, moc_solve_exact(&problem, c.number[1], c.array[2], c.array[3]));
}

static PyObject *solve_exact_rows(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    call c;
    (void)module;

    if (!TAKE(&c, 0, "solve_exact_rows", {"records", READ, K, ROW}, {"tolerance", NUMBER}, {"X", WRITE, K, N},
              {"Y", WRITE, K, 6}, {"status", WRITE, K}))
        return NULL;
    Py_BEGIN_ALLOW_THREADS;
    for (Py_ssize_t i = 0; i < c.k; i++) {
        moc_problem problem;
        moc_unpack_problem(c.array[0] + i * (11 * c.n + 10), c.n, &problem);
        c.array[4][i] = moc_solve_exact(&problem, c.number[1], c.array[2] + i * c.n, c.array[3] + i * 6);
    }
    Py_END_ALLOW_THREADS;
    return none(&c);
}

static PyObject *step_network(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    moc_problem problem;
    int made = 0;
    call c;
    (void)module;

    if (!TAKE(&c, 0, "step_network", {"record", READ, ROW}, {"x", WRITE, N}, {"y", WRITE, 6}, {"steps", WHOLE},
              {"h_x", NUMBER}, {"h_y", NUMBER}, {"k", NUMBER}, {"scale", NUMBER}, {"implicit", WHOLE}, {"rest", NUMBER}))
        return NULL;
    const moc_network net = {(int)c.whole[3], c.number[4], c.number[5], c.number[6], c.number[7], c.whole[8] != 0,
                             c.number[9]};
    moc_unpack_problem(c.array[0], c.n, &problem);
    moc_status status = moc_step_network(&problem, &net, c.array[1], c.array[2], &made);
    return moc_done(&c, Py_BuildValue("ii", (int)status, made));
}

/* Arguments 0 and 1: a record, and a basis Z (r,n) of its null space; returns r. */
static int take_answered(const call *c, moc_problem *problem, double Z[][MOC_MAX_JOINTS])
{
    int rows = c->k < c->n ? (int)c->k : c->n;
    moc_unpack_problem(c->array[0], c->n, problem);
    for (int i = 0; i < rows; i++)
        memcpy(Z[i], c->array[1] + i * c->n, (size_t)c->n * sizeof(double));
    return rows;
}

static PyObject *judge(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    moc_problem problem;
    double Z[MOC_MAX_JOINTS][MOC_MAX_JOINTS];
    call c;
    (void)module;

    if (!TAKE(&c, 0, "judge", {"record", READ, ROW}, {"Z", READ, K, N}, {"x", READ, N}))
        return NULL;
    int rows = take_answered(&c, &problem, Z);
    moc_residuals r = moc_judge(&problem, rows, Z, c.array[2]);
    return moc_done(&c, Py_BuildValue("ddddd", r.primal, r.outside, r.natural, r.off, r.opposite));
}

static PyObject *retreat(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    moc_problem problem;
    double Z[MOC_MAX_JOINTS][MOC_MAX_JOINTS];
    call c;
    (void)module;

    if (!TAKE(&c, 0, "retreat", {"record", READ, ROW}, {"Z", READ, K, N}, {"x", WRITE, N}))
        return NULL;
    int rows = take_answered(&c, &problem, Z);
    moc_retreat(&problem, rows, Z, c.array[2]);
    return none(&c);
}

static PyObject *least_violation(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    moc_problem problem;
    call c;
    (void)module;

    if (!TAKE(&c, 0, "least_violation", {"record", READ, ROW}, {"x", WRITE, N}))
        return NULL;
    moc_unpack_problem(c.array[0], c.n, &problem);
    moc_least_violation(&problem, c.array[1]);
    return none(&c);
}

/* --- a QP library's buffers --- */

static void put_at(const call *c, int argument, Py_ssize_t i, Py_ssize_t j, double value)
{
    const Py_buffer *view = &c->view[c->place[argument]];
    char *to = (char *)view->buf + i * view->strides[0] + (view->ndim > 1 ? j * view->strides[1] : 0);
    memcpy(to, &value, sizeof value);
}

static PyObject *load(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    enum { FIVE = 1, SCALE, SIGNS, COST, LINEAR, ROWS, LOW, HIGH, LOWER, UPPER, PACKED, LIFT };
    moc_problem problem;
    double P[MOC_MAX_JOINTS][MOC_MAX_JOINTS], linear[MOC_MAX_JOINTS], A[6][MOC_MAX_JOINTS], b[6], lift[6][6];
    call c;
    (void)module;

    /* p, lower and upper are multiplied by the signs; packed: the upper triangle of P by columns, or empty */
    if (!TAKE(&c, 0, "load", {"record", READ, ROW}, {"five", WHOLE}, {"scale", NUMBER}, {"signs", READ, 3},
              {"P", STRIDED, ANY, ANY}, {"p", STRIDED, ANY}, {"A", STRIDED, K, ANY}, {"low", STRIDED, K},
              {"high", STRIDED, K}, {"lower", STRIDED, ANY}, {"upper", STRIDED, ANY}, {"packed", STRIDED, ANY},
              {"lift", WRITE, K, 6}))
        return NULL;
    int n = c.n, m = (int)c.k, packed = rows_of(&c, PACKED) > 0;
    double scale = c.number[SCALE];
    const double *signs = c.array[SIGNS];
    moc_unpack_problem(c.array[0], n, &problem);
    for (int i = COST; i <= UPPER; i++) /* another shape than the buffers have */
        if ((i == COST || i == LINEAR || i >= LOWER) && rows_of(&c, i) != n)
            return moc_done(&c, PyBool_FromLong(0));
    if (c.view[c.place[COST]].shape[1] != n || c.view[c.place[ROWS]].shape[1] != n ||
        (packed && rows_of(&c, PACKED) != n * (n + 1) / 2) ||
        moc_equalities(&problem, c.whole[FIVE] != 0, A, b, lift) != m)
        return moc_done(&c, PyBool_FromLong(0));
    memcpy(c.array[LIFT], lift, (size_t)m * sizeof *lift);
    moc_cost(&problem, P, linear);
    for (int i = 0, k = 0; i < n; i++) {
        for (int j = 0; j < n; j++)
            put_at(&c, COST, i, j, scale * P[i][j]);
        for (int j = 0; j <= i && packed; j++)
            put_at(&c, PACKED, k++, 0, scale * P[j][i]);
        put_at(&c, LINEAR, i, 0, scale * signs[0] * linear[i]);
        put_at(&c, LOWER, i, 0, signs[1] * problem.lower[i]);
        put_at(&c, UPPER, i, 0, signs[2] * problem.upper[i]);
    }
    for (int i = 0; i < m; i++) {
        for (int j = 0; j < n; j++)
            put_at(&c, ROWS, i, j, A[i][j]);
        put_at(&c, LOW, i, 0, b[i]);
        put_at(&c, HIGH, i, 0, b[i]);
    }
    return moc_done(&c, PyBool_FromLong(1));
}

/* --- planning --- */

/* Arguments 1 to 4 of the functions below; 0 with an exception. */
static int take_task(const call *c, const moc_arm *arm, plan_task *task)
{
    task->arm = arm;
    task->low = c->array[1];
    task->high = c->array[2];
    memcpy(task->target, c->array[3], sizeof task->target);
    task->count = c->array[4] ? rows_of(c, 4) : 0;
    for (int i = 0; i < task->count; i++) {
        if (task->count > arm->n || !(c->array[4][i] >= 0.0 && c->array[4][i] < arm->n)) {
            PyErr_Format(PyExc_ValueError, "active: give numbers of joints from 0 to %d", arm->n - 1);
            return 0;
        }
        task->active[i] = (int)c->array[4][i];
    }
    return 1;
}

/* The arm that is the first argument of a call; NULL with an exception. */
static const moc_arm *first_arm(PyObject *const *args, Py_ssize_t count)
{
    if (count > 0)
        return moc_arm_of(args[0]);
    PyErr_SetString(PyExc_TypeError, "arm: give a moc_opt.core.Arm");
    return NULL;
}

#define TASK {"arm", OBJECT}, {"low", READ, N}, {"high", READ, N}, {"target", READ, 2, 3}, {"active", MAYBE, ANY}

static PyObject *follow_curve(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    const moc_arm *arm = first_arm(args, count);
    plan_task task;
    plan_end end;
    call c;
    (void)module;

    if (arm == NULL || !TAKE(&c, arm->n, "follow_curve", TASK, {"q", READ, N}, {"tangent", READ, N}, {"step", NUMBER},
                             {"s", WRITE, K}, {"poses", WRITE, K, N}, {"mus", WRITE, K}))
        return NULL;
    if (!take_task(&c, arm, &task))
        return moc_done(&c, NULL);
    if (c.k < 2 || c.k > INT_MAX / arm->n) {
        PyErr_Format(PyExc_ValueError, "s has %zd entries: give 2 or more", c.k);
        return moc_done(&c, NULL);
    }
    int found = plan_follow(&task, c.array[5], c.array[6], c.number[7], (int)c.k, c.array[8], c.array[9], c.array[10],
                            &end);
    return moc_done(&c, Py_BuildValue("ii", found, (int)end));
}

static PyObject *onto_curve(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    const moc_arm *arm = first_arm(args, count);
    plan_task task;
    call c;
    (void)module;

    if (arm == NULL ||
        !TAKE(&c, arm->n, "onto_curve", TASK, {"q", READ, N}, {"along", READ, N}, {"pose", WRITE, N}))
        return NULL;
    if (!take_task(&c, arm, &task))
        return moc_done(&c, NULL);
    return moc_done(&c, PyBool_FromLong(plan_correct(&task, c.array[5], c.array[6], c.array[7])));
}

static PyObject *ascend(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    const moc_arm *arm = first_arm(args, count);
    plan_task task;
    call c;
    (void)module;

    if (arm == NULL || !TAKE(&c, arm->n, "ascend", TASK, {"starts", WRITE, K, N}, {"mus", WRITE, K}))
        return NULL;
    if (!take_task(&c, arm, &task))
        return moc_done(&c, NULL);
    Py_BEGIN_ALLOW_THREADS;
    for (Py_ssize_t i = 0; i < c.k; i++)
        c.array[6][i] = plan_ascend(&task, c.array[5] + i * arm->n);
    Py_END_ALLOW_THREADS;
    return none(&c);
}

static PyObject *advance(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    call c;
    (void)module;

    if (!TAKE(&c, 0, "advance", {"branches", WHOLE}, {"q", READ, K, N}, {"slack", READ, K, N}, {"gain", READ, K},
              {"q_next", READ, ANY, N}, {"slack_next", READ, ANY, N}, {"value_next", READ, ANY}, {"step", READ, N},
              {"crossing", READ, ANY}, {"price", NUMBER}, {"worst", WHOLE}, {"value", WRITE, K}, {"room", WRITE, ANY}))
        return NULL;
    Py_ssize_t branches = c.whole[0], m = rows_of(&c, 8), after = rows_of(&c, 4), next = 0, blocks = 0;
    int fits = branches >= 1 && m >= 1 && c.k == branches * m && after % branches == 0 && rows_of(&c, 5) == after &&
               rows_of(&c, 6) == after && c.k * c.n <= INT_MAX && after * c.n <= INT_MAX;
    if (fits) {
        next = after / branches;
        blocks = (next + PLAN_BLOCK - 1) / PLAN_BLOCK;
        fits = rows_of(&c, 12) == branches * blocks * (2 * c.n + 1);
    }
    for (Py_ssize_t j = 0; j < m; j++)
        fits &= c.array[8][j] >= 0.0 && c.array[8][j] < (double)branches;
    if (!fits) {
        PyErr_SetString(PyExc_ValueError, "advance: the rows are not those of so many branches and crossings");
        return moc_done(&c, NULL);
    }
    const plan_stage stage = {(int)branches, (int)m, (int)next, c.n, c.array[1], c.array[2], c.array[3], c.array[4],
                              c.array[5], c.array[6], c.array[7], c.array[8], c.number[9], c.whole[10] != 0};
    Py_BEGIN_ALLOW_THREADS;
    plan_advance(&stage, c.array[12], c.array[11]);
    Py_END_ALLOW_THREADS;
    return none(&c);
}

/* --- the simulated plant, and the wrist that is wanted --- */

static PyObject *desired_wrist(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    moc_trocar trocar;
    call c;
    (void)module;

    if (!TAKE(&c, 0, "desired_wrist", {"X", READ, 3}, {"dX", READ, 3}, {"trocar", READ, 2, 3}, {"span", NUMBER},
              {"out", WRITE, 2, 3}))
        return NULL;
    memcpy(&trocar, c.array[2], sizeof trocar);
    moc_desired_wrist(c.array[0], c.array[1], &trocar, c.number[3], c.array[4], c.array[4] + 3);
    return none(&c);
}

static PyObject *shaft_force(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    call c;
    (void)module;

    if (!TAKE(&c, 0, "shaft_force", {"tip", READ, 3}, {"wrist", READ, 3}, {"twist", READ, 6}, {"origin", READ, 3},
              {"trocar", READ, 2, 3}, {"elapsed", NUMBER}, {"stiffness", NUMBER}, {"damping", NUMBER},
              {"force", WRITE, 3}, {"point", WRITE, 3}))
        return NULL;
    plant_shaft_force(c.array[0], c.array[1], c.array[2], c.array[3], c.array[4], c.number[5], c.number[6], c.number[7],
                      c.array[8], c.array[9]);
    return none(&c);
}

static PyObject *add_force(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    call c;
    (void)module;

    if (!TAKE(&c, 0, "add_force", {"wrench", WRITE, 6}, {"force", READ, 3}, {"point", READ, 3}, {"com", READ, 3}))
        return NULL;
    plant_add_force(c.array[0], c.array[1], c.array[2], c.array[3]);
    return none(&c);
}

static PyObject *read_encoders(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    call c;
    (void)module;

    if (!TAKE(&c, 0, "read_encoders", {"q", READ, N}, {"v", READ, N}, {"noise", READ, N}, {"memory", WRITE, 3, N},
              {"resolution", NUMBER}, {"period", NUMBER}, {"gain", NUMBER}, {"exact", WHOLE}, {"reading", WRITE, TWICE}))
        return NULL;
    const plant_encoders e = {c.number[4], c.number[5], c.number[6], c.whole[7] != 0};
    plant_read_encoders(&e, c.n, c.array[0], c.array[1], c.array[2], c.array[3], c.array[8]);
    return none(&c);
}

PyMethodDef moc_functions[] = {
    FAST("solve_exact", solve_exact, "solve_exact(record, tolerance, x, y) -> status"),
    FAST("solve_exact_rows", solve_exact_rows, "solve_exact_rows(records, tolerance, X, Y, status): without the lock"),
    FAST("step_network", step_network,
         "step_network(record, x, y, steps, h_x, h_y, k, scale, implicit, rest) -> (status, steps made)"),
    FAST("judge", judge, "judge(record, Z, x) -> (primal, outside, natural, off, opposite); see answer.c"),
    FAST("retreat", retreat, "retreat(record, Z, x): the smallest self-motion x into the box"),
    FAST("least_violation", least_violation, "least_violation(record, x): the x of the box with the least |A x - b|"),
    FAST("load", load, "load(record, five, scale, signs, P, p, A, low, high, lower, upper, packed, lift) -> whether the\n"
                       "subproblem has the shape of these buffers, which hold it then; y6 = lift^T y"),
    FAST("follow_curve", follow_curve,
         "follow_curve(arm, low, high, target, active, q, tangent, step, s, poses, mus) -> (count, end); see tools.h"),
    FAST("onto_curve", onto_curve, "onto_curve(arm, low, high, target, active, q, along, pose) -> bool; see tools.h"),
    FAST("ascend", ascend, "ascend(arm, low, high, target, None, starts, mus): climb in place; see tools.h"),
    FAST("advance", advance,
         "advance(branches, q, slack, gain, q_next, slack_next, value_next, step, crossing, price, worst, value, room):\n"
         "one step of a value function; see tools.h"),
    FAST("desired_wrist", desired_wrist, "desired_wrist(X, dX, trocar, span, out): N_d and dN_d (2, 3)"),
    FAST("shaft_force", shaft_force,
         "shaft_force(tip, wrist, twist, origin, trocar, elapsed, stiffness, damping, force, point); see tools.h"),
    FAST("add_force", add_force, "add_force(wrench, force, point, com): add a force at a point to a body's wrench"),
    FAST("read_encoders", read_encoders,
         "read_encoders(q, v, noise, memory, resolution, period, gain, exact, reading); see tools.h"),
    {NULL, NULL, 0, NULL},
};
