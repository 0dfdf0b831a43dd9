/* The core as a Python module, for CPython's limited API: one wheel serves every version from 3.11 on.
 *
 * Arrays come and go by the buffer protocol. Each is checked before anything is written: float64, C-contiguous, its
 * shape; a wrong one is a ValueError or TypeError that names the argument and the shape that it should have. */
#include "binding.h"

/* --- the subproblem, solved --- */

PyDoc_STRVAR(solve_exact_doc, "solve_exact(record, tolerance, x, y) -> status\n\n"
                              "Solve a packed subproblem (10 n + 10,) into x (n,) and y (6,).");

static PyObject *solve_exact(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    arrays held = {.count = 0};
    moc_problem problem;
    double *record, *x, *y, tolerance;
    int n;
    (void)module;

    if (!count_is(count, 4, "solve_exact"))
        return NULL;
    tolerance = PyFloat_AsDouble(args[1]);
    if (tolerance == -1.0 && PyErr_Occurred())
        return NULL;
    if (!(record = take(&held, args[0], "record", READ, ANY, 0)) || !(n = joints_of(rows_of(&held))) ||
        !(x = take(&held, args[2], "x", WRITE, n, 0)) || !(y = take(&held, args[3], "y", WRITE, 6, 0)))
        return release(&held, NULL);
    unpack(record, n, &problem);
    return release(&held, PyLong_FromLong(moc_solve_exact(&problem, tolerance, x, y)));
}

PyDoc_STRVAR(solve_exact_rows_doc, "solve_exact_rows(records, tolerance, X, Y, status)\n\n"
                                   "Solve many records (k, 10 n + 10) without the interpreter's lock; X (k, n), "
                                   "Y (k, 6), status (k,), all float64.");

static PyObject *solve_exact_rows(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    arrays held = {.count = 0};
    double *records, *X, *Y, *status, tolerance;
    Py_ssize_t k, length;
    int n;
    (void)module;

    if (!count_is(count, 5, "solve_exact_rows"))
        return NULL;
    tolerance = PyFloat_AsDouble(args[1]);
    if (tolerance == -1.0 && PyErr_Occurred())
        return NULL;
    if (PyObject_GetBuffer(args[0], &held.view[0], PyBUF_C_CONTIGUOUS | PyBUF_FORMAT) < 0)
        return NULL;
    length = held.view[0].ndim == 2 ? held.view[0].shape[1] : 0;
    PyBuffer_Release(&held.view[0]);
    if (!(n = joints_of(length)) || !(records = take(&held, args[0], "records", READ, ANY, length)))
        return release(&held, NULL);
    k = rows_of(&held);
    if (!(X = take(&held, args[2], "X", WRITE, k, n)) || !(Y = take(&held, args[3], "Y", WRITE, k, 6)) ||
        !(status = take(&held, args[4], "status", WRITE, k, 0)))
        return release(&held, NULL);
    Py_BEGIN_ALLOW_THREADS;
    for (Py_ssize_t i = 0; i < k; i++) {
        moc_problem problem;
        unpack(records + i * length, n, &problem);
        status[i] = moc_solve_exact(&problem, tolerance, X + i * n, Y + i * 6);
    }
    Py_END_ALLOW_THREADS;
    Py_INCREF(Py_None);
    return release(&held, Py_None);
}

PyDoc_STRVAR(step_network_doc, "step_network(record, x, y, steps, h_x, h_y, k, scale, implicit, rest)"
                               " -> (status, steps made)\n\n"
                               "Advance the network's state x (n,), y (6,) in place.");

static PyObject *step_network(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    arrays held = {.count = 0};
    moc_problem problem;
    moc_network net;
    double *record, *x, *y;
    int n, made = 0;
    (void)module;

    if (!count_is(count, 10, "step_network"))
        return NULL;
    net.steps = (int)PyLong_AsLong(args[3]);
    net.h_x = PyFloat_AsDouble(args[4]);
    net.h_y = PyFloat_AsDouble(args[5]);
    net.k = PyFloat_AsDouble(args[6]);
    net.scale = PyFloat_AsDouble(args[7]);
    net.implicit = PyObject_IsTrue(args[8]);
    net.rest = PyFloat_AsDouble(args[9]);
    if (PyErr_Occurred())
        return NULL;
    if (!(record = take(&held, args[0], "record", READ, ANY, 0)) || !(n = joints_of(rows_of(&held))) ||
        !(x = take(&held, args[1], "x", WRITE, n, 0)) || !(y = take(&held, args[2], "y", WRITE, 6, 0)))
        return release(&held, NULL);
    unpack(record, n, &problem);
    moc_status status = moc_step_network(&problem, &net, x, y, &made);
    return release(&held, Py_BuildValue("ii", (int)status, made));
}

/* A record and a basis Z (r,n) of its null space, for the three functions below; 0 with an exception. */
static int take_answered(arrays *held, PyObject *record, PyObject *basis, moc_problem *problem,
                         double Z[][MOC_MAX_JOINTS], int *rows)
{
    double *row, *given;
    int n;

    if (!(row = take(held, record, "record", READ, ANY, 0)) || !(n = joints_of(rows_of(held))) ||
        !(given = take(held, basis, "Z", READ, ANY, n)))
        return 0;
    if (rows_of(held) > n) {
        PyErr_Format(PyExc_ValueError, "Z has %zd rows: give at most %d", rows_of(held), n);
        return 0;
    }
    *rows = (int)rows_of(held);
    unpack(row, n, problem);
    for (int i = 0; i < *rows; i++)
        memcpy(Z[i], given + i * n, (size_t)n * sizeof *given);
    return n;
}

PyDoc_STRVAR(judge_doc, "judge(record, Z, x) -> (primal, outside, natural, off, opposite)\n\n"
                        "What an answer x (n,) is worth on the self-motion Z (r, n); see answer.c.");

static PyObject *judge(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    arrays held = {.count = 0};
    moc_problem problem;
    double Z[MOC_MAX_JOINTS][MOC_MAX_JOINTS], *x;
    int rows, n;
    (void)module;

    if (!count_is(count, 3, "judge") || !(n = take_answered(&held, args[0], args[1], &problem, Z, &rows)) ||
        !(x = take(&held, args[2], "x", READ, n, 0)))
        return release(&held, NULL);
    moc_residuals r = moc_judge(&problem, rows, Z, x);
    return release(&held, Py_BuildValue("ddddd", r.primal, r.outside, r.natural, r.off, r.opposite));
}

PyDoc_STRVAR(retreat_doc, "retreat(record, Z, x)\n\n"
                          "Write the smallest self-motion x (n,) that brings the arm's other motion into the box.");

static PyObject *retreat(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    arrays held = {.count = 0};
    moc_problem problem;
    double Z[MOC_MAX_JOINTS][MOC_MAX_JOINTS], *x;
    int rows, n;
    (void)module;

    if (!count_is(count, 3, "retreat") || !(n = take_answered(&held, args[0], args[1], &problem, Z, &rows)) ||
        !(x = take(&held, args[2], "x", WRITE, n, 0)))
        return release(&held, NULL);
    moc_retreat(&problem, rows, Z, x);
    Py_INCREF(Py_None);
    return release(&held, Py_None);
}

PyDoc_STRVAR(least_violation_doc, "least_violation(record, x)\n\nWrite the x (n,) of the box with the least |A x - b|.");

static PyObject *least_violation(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    arrays held = {.count = 0};
    moc_problem problem;
    double *record, *x;
    int n;
    (void)module;

    if (!count_is(count, 2, "least_violation") || !(record = take(&held, args[0], "record", READ, ANY, 0)) ||
        !(n = joints_of(rows_of(&held))) || !(x = take(&held, args[1], "x", WRITE, n, 0)))
        return release(&held, NULL);
    unpack(record, n, &problem);
    moc_least_violation(&problem, x);
    Py_INCREF(Py_None);
    return release(&held, Py_None);
}

/* --- the arm --- */

PyTypeObject *moc_arm_type; /* set once, when the module is made */

PyDoc_STRVAR(arm_doc,
             "Arm(joints, bodies, rotors, points, tool, moves, gravity)\n\n"
             "A serial chain of 1 to 16 joints as data, all arrays float64:\n"
             "joints (n, 16): rotation by rows, origin [m], axis, and 1 where the joint slides;\n"
             "bodies (n, 10): mass [kg], mass times centre of mass [kg m], and the inertia about that centre\n"
             "xx, xy, yy, xz, yz, zz [kg m^2], in the joint's axes; rotors (n,) [kg m^2];\n"
             "points (2, 3): tip and wrist in the last joint's axes [m]; tool (3, 3): rows x, y, z of the tool there;\n"
             "moves (2, n): 0 where a joint can never move the tip, the wrist; gravity (3,) [m/s^2].");

static PyObject *arm_new(PyTypeObject *type, PyObject *given, PyObject *keywords)
{
    arrays held = {.count = 0};
    PyObject *args[7];
    double *joints, *bodies, *rotors, *points, *tool, *moves, *gravity;
    Py_ssize_t n;

    if (keywords != NULL && PyDict_Size(keywords) > 0) {
        PyErr_SetString(PyExc_TypeError, "Arm takes no keywords");
        return NULL;
    }
    if (!PyArg_UnpackTuple(given, "Arm", 7, 7, &args[0], &args[1], &args[2], &args[3], &args[4], &args[5], &args[6]))
        return NULL;
    if (!(joints = take(&held, args[0], "joints", READ, ANY, 16)))
        return release(&held, NULL);
    n = rows_of(&held);
    if (n < 1 || n > MOC_MAX_JOINTS) {
        PyErr_Format(PyExc_ValueError, "joints has %zd rows: give 1 to %d joints", n, MOC_MAX_JOINTS);
        return release(&held, NULL);
    }
    if (!(bodies = take(&held, args[1], "bodies", READ, n, 10)) ||
        !(rotors = take(&held, args[2], "rotors", READ, n, 0)) ||
        !(points = take(&held, args[3], "points", READ, 2, 3)) || !(tool = take(&held, args[4], "tool", READ, 3, 3)) ||
        !(moves = take(&held, args[5], "moves", READ, 2, n)) || !(gravity = take(&held, args[6], "gravity", READ, 3, 0)))
        return release(&held, NULL);

    allocfunc allocate = (allocfunc)PyType_GetSlot(type, Py_tp_alloc);
    Arm *self = (Arm *)allocate(type, 0);
    if (self == NULL)
        return release(&held, NULL);
    moc_arm *arm = &self->arm;
    arm->n = (int)n;
    for (Py_ssize_t j = 0; j < n; j++) {
        moc_joint *joint = &arm->joint[j];
        const double *row = joints + 16 * j, *body = bodies + 10 * j;
        memcpy(joint->rotation, row, sizeof joint->rotation);
        memcpy(joint->origin, row + 9, sizeof joint->origin);
        memcpy(joint->axis, row + 12, sizeof joint->axis);
        joint->slides = row[15] > 0.0;
        joint->mass = body[0];
        memcpy(joint->moment, body + 1, sizeof joint->moment);
        memcpy(joint->inertia, body + 4, sizeof joint->inertia);
        joint->rotor = rotors[j];
        arm->moves[MOC_TIP][j] = moves[j] != 0.0;
        arm->moves[MOC_WRIST][j] = moves[n + j] != 0.0;
    }
    memcpy(arm->point, points, sizeof arm->point);
    memcpy(arm->tool, tool, sizeof arm->tool);
    memcpy(arm->gravity, gravity, sizeof arm->gravity);
    return release(&held, (PyObject *)self);
}

static void object_dealloc(PyObject *self)
{
    PyTypeObject *type = Py_TYPE(self);
    freefunc release_memory = (freefunc)PyType_GetSlot(type, Py_tp_free);
    release_memory(self);
    Py_DECREF(type);
}

static double *put(double *to, const double *from, int count)
{
    memcpy(to, from, (size_t)count * sizeof *to);
    return to + count;
}

static void pack_terms(const moc_terms *t, int n, double *to)
{
    to = put(put(to, t->q, n), t->v, n);
    to = put(put(put(to, t->tip, 3), t->wrist, 3), t->u, 3);
    for (int i = 0; i < 6; i++)
        to = put(to, t->A[i], n);
    to = put(put(put(to, t->drift, 6), t->grad_mu, n), t->grad_mu_shaft, n);
    for (int i = 0; i < n; i++)
        to = put(to, t->M[i], n);
    to = put(put(put(to, t->h, n), t->energy_slope, n), t->gravity, n);
    to[0] = t->mu;
    to[1] = t->span;
    to[2] = t->mu_shaft;
}

static const double *get(const double *from, double *to, int count)
{
    memcpy(to, from, (size_t)count * sizeof *to);
    return from + count;
}

static void unpack_terms(const double *from, int n, moc_terms *t)
{
    from = get(get(from, t->q, n), t->v, n);
    from = get(get(get(from, t->tip, 3), t->wrist, 3), t->u, 3);
    for (int i = 0; i < 6; i++)
        from = get(from, t->A[i], n);
    from = get(get(get(from, t->drift, 6), t->grad_mu, n), t->grad_mu_shaft, n);
    for (int i = 0; i < n; i++)
        from = get(from, t->M[i], n);
    from = get(get(get(from, t->h, n), t->energy_slope, n), t->gravity, n);
    t->mu = from[0];
    t->span = from[1];
    t->mu_shaft = from[2];
}

static Py_ssize_t record_size(int n)
{
    return n * n + 13 * n + 18;
}

PyDoc_STRVAR(terms_doc, "terms(q, v, record) -> status\n\n"
                        "Compute all terms at q, v (n,) into record (n n + 13 n + 18,); see robots/state.py.");

static PyObject *arm_terms(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    const moc_arm *arm = &((Arm *)self)->arm;
    arrays held = {.count = 0};
    moc_terms t;
    double *q, *v, *to;
    int n = arm->n;

    if (!count_is(count, 3, "terms") || !(q = take(&held, args[0], "q", READ, n, 0)) ||
        !(v = take(&held, args[1], "v", READ, n, 0)) ||
        !(to = take(&held, args[2], "record", WRITE, record_size(n), 0)))
        return release(&held, NULL);
    moc_status status = moc_compute_terms(arm, q, v, &t);
    if (status == MOC_OK)
        pack_terms(&t, n, to);
    return release(&held, PyLong_FromLong(status));
}

PyDoc_STRVAR(mu_along_doc, "mu_along(poses, mu)\n\nCompute mu (k,) of the tip at poses (k, n).");

static PyObject *arm_mu_along(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    const moc_arm *arm = &((Arm *)self)->arm;
    arrays held = {.count = 0};
    moc_frame frame[MOC_MAX_JOINTS];
    moc_twist twist[MOC_MAX_JOINTS];
    double *poses, *mu, J[3][MOC_MAX_JOINTS], tip[3];
    int n = arm->n;

    if (!count_is(count, 2, "mu_along") || !(poses = take(&held, args[0], "poses", READ, ANY, n)))
        return release(&held, NULL);
    Py_ssize_t k = rows_of(&held);
    if (!(mu = take(&held, args[1], "mu", WRITE, k, 0)))
        return release(&held, NULL);
    for (Py_ssize_t i = 0; i < k; i++) {
        moc_place(arm, poses + i * n, frame);
        moc_twists(arm, frame, twist);
        moc_point(&frame[n - 1], arm->point[MOC_TIP], tip);
        moc_jacobian(n, twist, tip, arm->moves[MOC_TIP], J);
        mu[i] = moc_yoshikawa(n, J);
    }
    Py_INCREF(Py_None);
    return release(&held, Py_None);
}

PyDoc_STRVAR(points_along_doc, "points_along(poses, points, out)\n\n"
                               "Place points (m, 3) of the last joint's axes at poses (k, n): out (m k, 3) [m].");

static PyObject *arm_points_along(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    const moc_arm *arm = &((Arm *)self)->arm;
    arrays held = {.count = 0};
    moc_frame frame[MOC_MAX_JOINTS];
    double *poses, *points, *out;
    int n = arm->n;

    if (!count_is(count, 3, "points_along") || !(poses = take(&held, args[0], "poses", READ, ANY, n)))
        return release(&held, NULL);
    Py_ssize_t k = rows_of(&held);
    if (!(points = take(&held, args[1], "points", READ, ANY, 3)))
        return release(&held, NULL);
    Py_ssize_t m = rows_of(&held);
    if (!(out = take(&held, args[2], "out", WRITE, m * k, 3)))
        return release(&held, NULL);
    for (Py_ssize_t i = 0; i < k; i++) {
        moc_place(arm, poses + i * n, frame);
        for (Py_ssize_t j = 0; j < m; j++)
            moc_point(&frame[n - 1], points + 3 * j, out + 3 * (j * k + i));
    }
    Py_INCREF(Py_None);
    return release(&held, Py_None);
}

PyDoc_STRVAR(tool_pose_doc, "tool_pose(q, pose)\n\nWrite the tool's axes x, y, z and its tip [m]: pose (4, 3).");

static PyObject *arm_tool_pose(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    const moc_arm *arm = &((Arm *)self)->arm;
    arrays held = {.count = 0};
    double *q, *pose;

    if (!count_is(count, 2, "tool_pose") || !(q = take(&held, args[0], "q", READ, arm->n, 0)) ||
        !(pose = take(&held, args[1], "pose", WRITE, 4, 3)))
        return release(&held, NULL);
    moc_tool_pose(arm, q, (double(*)[3])pose);
    Py_INCREF(Py_None);
    return release(&held, Py_None);
}

PyDoc_STRVAR(nearest_doc, "nearest_pose(targets, low, high, q, iterations, best) -> miss [m]\n\n"
                          "Newton's method from q (n,) for the tip at targets (1, 3), or tip and wrist at (2, 3).");

static PyObject *arm_nearest_pose(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    const moc_arm *arm = &((Arm *)self)->arm;
    arrays held = {.count = 0};
    double *targets, *low, *high, *q, *best;
    int n = arm->n;

    if (!count_is(count, 6, "nearest_pose") || !(targets = take(&held, args[0], "targets", READ, ANY, 3)))
        return release(&held, NULL);
    Py_ssize_t points = rows_of(&held);
    if (points < 1 || points > 2) {
        PyErr_Format(PyExc_ValueError, "targets has %zd rows: give one (tip) or two (tip and wrist)", points);
        return release(&held, NULL);
    }
    long iterations = PyLong_AsLong(args[4]);
    if ((iterations == -1 && PyErr_Occurred()) || !(low = take(&held, args[1], "low", READ, n, 0)) ||
        !(high = take(&held, args[2], "high", READ, n, 0)) || !(q = take(&held, args[3], "q", READ, n, 0)) ||
        !(best = take(&held, args[5], "best", WRITE, n, 0)))
        return release(&held, NULL);
    double miss =
        moc_nearest_pose(arm, (int)points, (double(*)[3])targets, low, high, (int)iterations, q, best);
    return release(&held, PyFloat_FromDouble(miss));
}

static PyMethodDef arm_methods[] = {
    FAST("terms", arm_terms, terms_doc),
    FAST("mu_along", arm_mu_along, mu_along_doc),
    FAST("points_along", arm_points_along, points_along_doc),
    FAST("tool_pose", arm_tool_pose, tool_pose_doc),
    FAST("nearest_pose", arm_nearest_pose, nearest_doc),
    {NULL, NULL, 0, NULL},
};

static PyType_Slot arm_slots[] = {
    {Py_tp_doc, (void *)arm_doc}, {Py_tp_new, arm_new}, {Py_tp_dealloc, object_dealloc}, {Py_tp_methods, arm_methods},
    {0, NULL},
};

static PyType_Spec arm_spec = {"moc_opt.core._core.Arm", sizeof(Arm), 0, Py_TPFLAGS_DEFAULT, arm_slots};

/* --- structs of numbers from keywords --- */

enum kind { NUMBER, WHOLE, PAIR, JOINTS };

typedef struct {
    const char *name;
    size_t offset;
    enum kind kind;
} field;

#define FIELD(type, name, kind) {#name, offsetof(type, name), kind}

/* Fill a struct with the keywords of these names, all of which have to be there. Returns how many, -1: exception. */
static Py_ssize_t fill_struct(PyObject *keywords, const field *fields, size_t count, int n, void *to)
{
    for (size_t k = 0; k < count; k++) {
        const field *f = &fields[k];
        char *place = (char *)to + f->offset;
        PyObject *given = keywords ? PyDict_GetItemString(keywords, f->name) : NULL;
        if (given == NULL) {
            PyErr_Format(PyExc_TypeError, "%s is missing", f->name);
            return -1;
        }
        if (f->kind == NUMBER) {
            double value = PyFloat_AsDouble(given);
            if (value == -1.0 && PyErr_Occurred())
                return -1;
            memcpy(place, &value, sizeof value);
        } else if (f->kind == WHOLE) {
            long value = PyLong_AsLong(given);
            if (value == -1 && PyErr_Occurred())
                return -1;
            if (value < INT_MIN || value > INT_MAX) {
                PyErr_Format(PyExc_ValueError, "%s = %ld does not fit an int", f->name, value);
                return -1;
            }
            int narrow = (int)value;
            memcpy(place, &narrow, sizeof narrow);
        } else {
            arrays held = {.count = 0};
            int length = f->kind == PAIR ? 2 : n;
            double *from = take(&held, given, f->name, READ, length, 0);
            if (from)
                memcpy(place, from, (size_t)length * sizeof *from);
            release(&held, NULL);
            if (!from)
                return -1;
        }
    }
    return (Py_ssize_t)count;
}

/* The arm that is the only positional argument; NULL with an exception. */
static const moc_arm *take_arm(PyObject *given, const char *call)
{
    PyObject *arm;
    if (!PyArg_UnpackTuple(given, call, 1, 1, &arm))
        return NULL;
    return arm_of(arm);
}

/* Whether there are no keywords beside those that were taken. */
static int no_others(PyObject *keywords, Py_ssize_t taken, const char *call)
{
    if (keywords == NULL || PyDict_Size(keywords) == taken)
        return 1;
    PyErr_Format(PyExc_TypeError, "%s takes %zd keywords, %zd were given", call, taken, PyDict_Size(keywords));
    return 0;
}

/* --- the law --- */

typedef struct {
    PyObject_HEAD
    moc_arm arm;
    moc_law law;
    moc_supervision supervision;
    moc_memory memory;
    moc_terms terms;     /* of the last tick */
    moc_problem problem; /* of the last tick */
    double tau[MOC_MAX_JOINTS];
} Law;

static const field law_fields[] = {
    FIELD(moc_law, K_X, NUMBER), FIELD(moc_law, D_X, NUMBER), FIELD(moc_law, K_N, NUMBER), FIELD(moc_law, D_N, NUMBER),
    FIELD(moc_law, rcm_lambda, NUMBER), FIELD(moc_law, projector, WHOLE), FIELD(moc_law, feedforward, WHOLE),
    FIELD(moc_law, K_N2, JOINTS), FIELD(moc_law, D_N2, JOINTS), FIELD(moc_law, tau_max, JOINTS),
    FIELD(moc_law, k0, NUMBER), FIELD(moc_law, c0, NUMBER), FIELD(moc_law, c1, NUMBER), FIELD(moc_law, c2, NUMBER),
    FIELD(moc_law, rho, NUMBER), FIELD(moc_law, q_min, JOINTS), FIELD(moc_law, q_max, JOINTS),
    FIELD(moc_law, v_max, JOINTS), FIELD(moc_law, shaft_margin, NUMBER), FIELD(moc_law, spare_speed, NUMBER),
    FIELD(moc_law, observer_gain, NUMBER), FIELD(moc_law, period, NUMBER), FIELD(moc_law, fade, NUMBER),
    FIELD(moc_law, third_level, WHOLE), FIELD(moc_law, damped, WHOLE), FIELD(moc_law, climbs, WHOLE),
};

static const field supervision_fields[] = {
    FIELD(moc_supervision, check, WHOLE), FIELD(moc_supervision, box_limit, NUMBER),
    FIELD(moc_supervision, primal_limit, NUMBER), FIELD(moc_supervision, relative_limit, NUMBER),
    FIELD(moc_supervision, opposite_limit, NUMBER), FIELD(moc_supervision, hold_ticks, WHOLE),
    FIELD(moc_supervision, keep_off_limits, WHOLE), FIELD(moc_supervision, fallback, WHOLE),
    FIELD(moc_supervision, late, WHOLE), FIELD(moc_supervision, budget_us, NUMBER),
};

#define COUNT(fields) (sizeof(fields) / sizeof(fields)[0])

PyDoc_STRVAR(law_doc, "Law(arm, **numbers)\n\n"
                      "The law with its memory from tick to tick: start, then begin, supervise and finish at every tick.\n"
                      "numbers: every field of moc_law and moc_supervision in moc.h, by its name; vectors are (n,).");

static PyObject *law_new(PyTypeObject *type, PyObject *given, PyObject *keywords)
{
    const moc_arm *arm = take_arm(given, "Law");
    moc_law law;
    moc_supervision s;
    Py_ssize_t taken, more;

    if (arm == NULL || (taken = fill_struct(keywords, law_fields, COUNT(law_fields), arm->n, &law)) < 0 ||
        (more = fill_struct(keywords, supervision_fields, COUNT(supervision_fields), arm->n, &s)) < 0 ||
        !no_others(keywords, taken + more, "Law"))
        return NULL;
    if ((int)law.projector < MOC_DYNAMIC || law.projector > MOC_AS_PUBLISHED || (int)s.fallback < MOC_DAMPING ||
        s.fallback > MOC_LEAST_VIOLATION || (int)s.late < MOC_LATE_HOLD || s.late > MOC_LATE_ITERATE) {
        PyErr_SetString(PyExc_ValueError, "projector, fallback and late: give 0, 1 or 2");
        return NULL;
    }
    allocfunc allocate = (allocfunc)PyType_GetSlot(type, Py_tp_alloc);
    Law *self = (Law *)allocate(type, 0);
    if (self == NULL)
        return NULL;
    self->arm = *arm;
    self->law = law;
    self->supervision = s;
    return (PyObject *)self;
}

static void pack_problem(const moc_problem *p, const double *q, double *to)
{
    for (int i = 0; i < 6; i++)
        to = put(to, p->A[i], p->n);
    to = put(put(put(put(to, p->b, 6), p->grad_mu, p->n), p->lower, p->n), p->upper, p->n);
    to[0] = p->c0;
    to[1] = p->c1;
    to[2] = p->c2;
    to[3] = p->rho;
    put(to + 4, q, p->n);
}

/* A state's record, (3,3) references X_d, dX_d, ddX_d and (2,3) trocar P_t, dP_t; 0 with an exception. */
static int take_tick(Law *self, arrays *held, PyObject *const *args, moc_reference *ref, moc_trocar *trocar)
{
    int n = self->arm.n;
    double *record, *tip_ref, *points;
    if (!(record = take(held, args[0], "record", READ, record_size(n), 0)) ||
        !(tip_ref = take(held, args[1], "tip_ref", READ, 3, 3)) ||
        !(points = take(held, args[2], "trocar", READ, 2, 3)))
        return 0;
    unpack_terms(record, n, &self->terms);
    memcpy(ref, tip_ref, sizeof *ref);
    memcpy(trocar, points, sizeof *trocar);
    return 1;
}

PyDoc_STRVAR(start_doc, "start(record, tip_ref, trocar, row)\n\n"
                        "Forget all; write the subproblem of this state into row (10 n + 10,).");

static PyObject *law_start(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Law *self = (Law *)object;
    arrays held = {.count = 0};
    moc_reference ref;
    moc_trocar trocar;
    double *row;
    int n = self->arm.n;

    if (!count_is(count, 4, "start") || !(row = take(&held, args[3], "row", WRITE, 10 * n + 10, 0)) ||
        !take_tick(self, &held, args, &ref, &trocar))
        return release(&held, NULL);
    moc_start(&self->law, n, &self->terms, &self->memory);
    moc_fill_problem(&self->law, n, &self->terms, &ref, &trocar, NULL, &self->problem);
    pack_problem(&self->problem, self->terms.q, row);
    Py_INCREF(Py_None);
    return release(&held, Py_None);
}

PyDoc_STRVAR(load_doc, "load(record, Z)\n\n"
                       "Take a subproblem and a basis of its null space as those of this tick, in place of begin.");

static PyObject *law_load(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Law *self = (Law *)object;
    arrays held = {.count = 0};
    moc_problem problem;
    double Z[MOC_MAX_JOINTS][MOC_MAX_JOINTS];
    int rows;

    if (!count_is(count, 2, "load") || !take_answered(&held, args[0], args[1], &problem, Z, &rows))
        return release(&held, NULL);
    if (problem.n != self->arm.n) {
        PyErr_Format(PyExc_ValueError, "record is of %d joints: this law has %d", problem.n, self->arm.n);
        return release(&held, NULL);
    }
    self->problem = problem;
    self->memory.rows = rows;
    memcpy(self->memory.Z, Z, sizeof Z);
    Py_INCREF(Py_None);
    return release(&held, Py_None);
}

PyDoc_STRVAR(begin_doc, "begin(record, tip_ref, trocar, pull, row)\n\n"
                        "Levels 1 and 2, and the subproblem into row (10 n + 10,), where there is a third level.\n"
                        "pull: velocity (n,) that the third level is to follow; None: it climbs mu.");

static PyObject *law_begin(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Law *self = (Law *)object;
    arrays held = {.count = 0};
    moc_reference ref;
    moc_trocar trocar;
    double *row, *pull = NULL;
    int n = self->arm.n;

    if (!count_is(count, 5, "begin"))
        return NULL;
    if ((args[3] != Py_None && !(pull = take(&held, args[3], "pull", READ, n, 0))) ||
        !(row = take(&held, args[4], "row", WRITE, 10 * n + 10, 0)) ||
        !take_tick(self, &held, args, &ref, &trocar))
        return release(&held, NULL);
    moc_begin(&self->arm, &self->law, &self->terms, &ref, &trocar, pull, &self->memory, &self->problem, self->tau);
    if (self->law.third_level)
        pack_problem(&self->problem, self->terms.q, row);
    Py_INCREF(Py_None);
    return release(&held, Py_None);
}

PyDoc_STRVAR(supervise_doc, "supervise(known, claim, answer, solve_us, x) -> fault\n\n"
                            "Check an answer (n,) to the last subproblem; write the x (n,) that the arm follows.");

static PyObject *law_supervise(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Law *self = (Law *)object;
    arrays held = {.count = 0};
    double *answer, *x, solve_us;
    int n = self->arm.n;

    if (!count_is(count, 5, "supervise"))
        return NULL;
    long known = PyLong_AsLong(args[0]), claim = PyLong_AsLong(args[1]);
    solve_us = PyFloat_AsDouble(args[3]);
    if (PyErr_Occurred())
        return NULL;
    if (known < MOC_TAKEN || known >= MOC_FAULTS || claim < MOC_CLAIMS_OPTIMUM || claim > MOC_GIVES_NONE) {
        PyErr_SetString(PyExc_ValueError, "known: give a fault's number; claim: 0 to 3");
        return NULL;
    }
    if (!(answer = take(&held, args[2], "answer", READ, n, 0)) || !(x = take(&held, args[4], "x", WRITE, n, 0)))
        return release(&held, NULL);
    moc_fault fault = moc_supervise(&self->supervision, &self->problem, (moc_fault)known, (moc_claim)claim, answer,
                                    solve_us, &self->memory, x);
    return release(&held, PyLong_FromLong(fault));
}

PyDoc_STRVAR(finish_doc, "finish(x, tau)\n\nAdd the third level, which follows x (n,), None: rest; write tau (n,) [Nm].");

static PyObject *law_finish(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Law *self = (Law *)object;
    arrays held = {.count = 0};
    double *x = NULL, *tau;
    int n = self->arm.n;

    if (!count_is(count, 2, "finish") || (args[0] != Py_None && !(x = take(&held, args[0], "x", READ, n, 0))) ||
        !(tau = take(&held, args[1], "tau", WRITE, n, 0)))
        return release(&held, NULL);
    moc_finish(&self->law, n, &self->terms, x, &self->memory, self->tau);
    put(tau, self->tau, n);
    Py_INCREF(Py_None);
    return release(&held, Py_None);
}

PyDoc_STRVAR(applied_doc, "set_applied(tau)\n\nReplace the last torque by the one (n,) that was applied.");

static PyObject *law_set_applied(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Law *self = (Law *)object;
    arrays held = {.count = 0};
    double *tau;

    if (!count_is(count, 1, "set_applied") || !(tau = take(&held, args[0], "tau", READ, self->arm.n, 0)))
        return release(&held, NULL);
    put(self->memory.tau, tau, self->arm.n);
    Py_INCREF(Py_None);
    return release(&held, Py_None);
}

PyDoc_STRVAR(external_doc, "external(out)\n\nWrite the observer's estimate of the external torque (n,) [Nm].");

static PyObject *law_external(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Law *self = (Law *)object;
    arrays held = {.count = 0};
    double *out;

    if (!count_is(count, 1, "external") || !(out = take(&held, args[0], "out", WRITE, self->arm.n, 0)))
        return release(&held, NULL);
    put(out, self->memory.external, self->arm.n);
    Py_INCREF(Py_None);
    return release(&held, Py_None);
}

PyDoc_STRVAR(null_space_doc, "null_space(out) -> rows\n\nWrite the basis Z of ker A into the first rows of out (n, n).");

static PyObject *law_null_space(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Law *self = (Law *)object;
    arrays held = {.count = 0};
    double *out;
    int n = self->arm.n;

    if (!count_is(count, 1, "null_space") || !(out = take(&held, args[0], "out", WRITE, n, n)))
        return release(&held, NULL);
    for (int i = 0; i < self->memory.rows; i++)
        put(out + i * n, self->memory.Z[i], n);
    return release(&held, PyLong_FromLong(self->memory.rows));
}

static PyMethodDef law_methods[] = {
    FAST("start", law_start, start_doc),
    FAST("load", law_load, load_doc),
    FAST("begin", law_begin, begin_doc),
    FAST("supervise", law_supervise, supervise_doc),
    FAST("finish", law_finish, finish_doc),
    FAST("set_applied", law_set_applied, applied_doc),
    FAST("external", law_external, external_doc),
    FAST("null_space", law_null_space, null_space_doc),
    {NULL, NULL, 0, NULL},
};

static PyType_Slot law_slots[] = {
    {Py_tp_doc, (void *)law_doc}, {Py_tp_new, law_new}, {Py_tp_dealloc, object_dealloc}, {Py_tp_methods, law_methods},
    {0, NULL},
};

static PyType_Spec law_spec = {"moc_opt.core._core.Law", sizeof(Law), 0, Py_TPFLAGS_DEFAULT, law_slots};

/* --- the safety filter --- */

typedef struct {
    PyObject_HEAD
    moc_arm arm;
    moc_guard guard;
    moc_watch watch;
} Guard;

static const field guard_fields[] = {
    FIELD(moc_guard, period, NUMBER), FIELD(moc_guard, patience, WHOLE), FIELD(moc_guard, carries, WHOLE),
    FIELD(moc_guard, low, JOINTS), FIELD(moc_guard, high, JOINTS), FIELD(moc_guard, v_max, JOINTS),
    FIELD(moc_guard, tau_max, JOINTS), FIELD(moc_guard, wall_stiffness, NUMBER), FIELD(moc_guard, wall_damping, NUMBER),
    FIELD(moc_guard, wall_brake, NUMBER), FIELD(moc_guard, torque_step, NUMBER), FIELD(moc_guard, jump, NUMBER),
    FIELD(moc_guard, speed_factor, NUMBER), FIELD(moc_guard, tip_error, NUMBER), FIELD(moc_guard, tip_share, NUMBER),
    FIELD(moc_guard, in_incision, WHOLE), FIELD(moc_guard, warning, PAIR), FIELD(moc_guard, limit, PAIR),
    FIELD(moc_guard, incision_share, NUMBER), FIELD(moc_guard, tool_mass, NUMBER), FIELD(moc_guard, tool_length, NUMBER),
    FIELD(moc_guard, tip_force, NUMBER), FIELD(moc_guard, stop_holding, NUMBER), FIELD(moc_guard, stop_yield, NUMBER),
    FIELD(moc_guard, stop_yield_ticks, WHOLE), FIELD(moc_guard, press_share, NUMBER), FIELD(moc_guard, motion, WHOLE),
    FIELD(moc_guard, motion_s, NUMBER), FIELD(moc_guard, motion_rad, NUMBER), FIELD(moc_guard, motion_lag_s, NUMBER),
    FIELD(moc_guard, repeat_m, NUMBER), FIELD(moc_guard, repeat_torque, NUMBER),
    FIELD(moc_guard, repeat_whole_m, NUMBER), FIELD(moc_guard, repeat_whole_torque, NUMBER),
    FIELD(moc_guard, repeat_whole_ticks, NUMBER), FIELD(moc_guard, repeat_joint_ticks, NUMBER),
    FIELD(moc_guard, repeat_reading_ticks, NUMBER), FIELD(moc_guard, replayed_ticks, NUMBER),
    FIELD(moc_guard, stuck_speed, NUMBER), FIELD(moc_guard, held, JOINTS), FIELD(moc_guard, residual_torque, NUMBER),
    FIELD(moc_guard, residual_whole, NUMBER), FIELD(moc_guard, residual_rate, NUMBER),
    FIELD(moc_guard, residual_share, NUMBER), FIELD(moc_guard, settling_ticks, WHOLE),
};

PyDoc_STRVAR(guard_doc, "Guard(arm, **numbers)\n\n"
                        "The safety filter with its memory: start, then believe and follow at every tick.\n"
                        "numbers: every field of moc_guard in moc.h, by its name; vectors are (n,), warning and limit (2,).");

static PyObject *guard_new(PyTypeObject *type, PyObject *given, PyObject *keywords)
{
    const moc_arm *arm = take_arm(given, "Guard");
    moc_guard guard;
    Py_ssize_t taken;

    if (arm == NULL || (taken = fill_struct(keywords, guard_fields, COUNT(guard_fields), arm->n, &guard)) < 0 ||
        !no_others(keywords, taken, "Guard"))
        return NULL;
    allocfunc allocate = (allocfunc)PyType_GetSlot(type, Py_tp_alloc);
    Guard *self = (Guard *)allocate(type, 0);
    if (self == NULL)
        return NULL;
    self->arm = *arm;
    self->guard = guard;
    return (PyObject *)self;
}

PyDoc_STRVAR(guard_start_doc, "start(q, v, stamp)\n\nForget all, and begin at a finite q, v (n,), measurement `stamp`.");

static PyObject *guard_start(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Guard *self = (Guard *)object;
    arrays held = {.count = 0};
    double *q, *v;
    int n = self->arm.n;

    if (!count_is(count, 3, "start") || !(q = take(&held, args[0], "q", READ, n, 0)) ||
        !(v = take(&held, args[1], "v", READ, n, 0)))
        return release(&held, NULL);
    long long stamp = PyLong_AsLongLong(args[2]);
    if (stamp == -1 && PyErr_Occurred())
        return release(&held, NULL);
    moc_guard_start(&self->guard, n, q, v, stamp, &self->watch);
    Py_INCREF(Py_None);
    return release(&held, Py_None);
}

PyDoc_STRVAR(believe_doc, "believe(q, v, stamp, applied, wrench, trocar) -> reason\n\n"
                          "Judge a measurement; `believed` has what to believe. stamp, applied (n,), trocar (2, 3): or None.");

static PyObject *guard_believe(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Guard *self = (Guard *)object;
    arrays held = {.count = 0};
    moc_measurement m = {.stamp = 0};
    moc_trocar trocar;
    double *points = NULL;
    int n = self->arm.n;

    if (!count_is(count, 6, "believe") || !(m.q = take(&held, args[0], "q", READ, n, 0)) ||
        !(m.v = take(&held, args[1], "v", READ, n, 0)) ||
        (args[3] != Py_None && !(m.applied = take(&held, args[3], "applied", READ, n, 0))) ||
        !(m.wrench = take(&held, args[4], "wrench", READ, 6, 0)) ||
        (args[5] != Py_None && !(points = take(&held, args[5], "trocar", READ, 2, 3))))
        return release(&held, NULL);
    m.has_stamp = args[2] != Py_None;
    m.stamp = m.has_stamp ? PyLong_AsLongLong(args[2]) : 0;
    if (m.stamp == -1 && PyErr_Occurred())
        return release(&held, NULL);
    if (points)
        memcpy(&trocar, points, sizeof trocar);
    moc_stop reason = moc_guard_believe(&self->guard, &self->arm, &m, points ? &trocar : NULL, &self->watch);
    return release(&held, PyLong_FromLong(reason));
}

PyDoc_STRVAR(believed_doc, "believed(q, v)\n\nWrite the last measurement that was believed, moved on since.");

static PyObject *guard_believed(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Guard *self = (Guard *)object;
    arrays held = {.count = 0};
    double *q, *v;
    int n = self->arm.n;

    if (!count_is(count, 2, "believed") || !(q = take(&held, args[0], "q", WRITE, n, 0)) ||
        !(v = take(&held, args[1], "v", WRITE, n, 0)))
        return release(&held, NULL);
    put(q, self->watch.q, n);
    put(v, self->watch.v, n);
    Py_INCREF(Py_None);
    return release(&held, Py_None);
}

PyDoc_STRVAR(follow_doc, "follow(q, v, record, tip, tip_ref, before, tau) -> (reason, joints limited)\n\n"
                         "Judge tip and motion at the believed q, v, and cut tau (n,) in place.\n"
                         "record: terms of (q, v); tip (3,); tip_ref (3, 3): or None.");

static PyObject *guard_follow(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Guard *self = (Guard *)object;
    arrays held = {.count = 0};
    moc_terms terms;
    double *q, *v, *record = NULL, *tip = NULL, *tip_ref = NULL, *before, *tau;
    int n = self->arm.n;

    if (!count_is(count, 7, "follow") || !(q = take(&held, args[0], "q", READ, n, 0)) ||
        !(v = take(&held, args[1], "v", READ, n, 0)) ||
        (args[2] != Py_None && !(record = take(&held, args[2], "record", READ, record_size(n), 0))) ||
        (args[3] != Py_None && !(tip = take(&held, args[3], "tip", READ, 3, 0))) ||
        (args[4] != Py_None && !(tip_ref = take(&held, args[4], "tip_ref", READ, 3, 3))) ||
        !(before = take(&held, args[5], "before", READ, n, 0)) || !(tau = take(&held, args[6], "tau", WRITE, n, 0)))
        return release(&held, NULL);
    if (record)
        unpack_terms(record, n, &terms);
    put(self->watch.q, q, n);
    put(self->watch.v, v, n);
    moc_stop reason = moc_guard_follow(&self->guard, &self->arm, record ? &terms : NULL, tip ? tip : record ? terms.tip : NULL,
                                       tip_ref, before, tau, &self->watch);
    return release(&held, Py_BuildValue("ii", (int)reason, self->watch.limited));
}

PyDoc_STRVAR(rest_doc, "rest(before, tau)\n\nWrite the torque (n,) of a damped stop.");

static PyObject *guard_rest(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Guard *self = (Guard *)object;
    arrays held = {.count = 0};
    double *before, *tau;
    int n = self->arm.n;

    if (!count_is(count, 2, "rest") || !(before = take(&held, args[0], "before", READ, n, 0)) ||
        !(tau = take(&held, args[1], "tau", WRITE, n, 0)))
        return release(&held, NULL);
    moc_guard_rest(&self->guard, &self->arm, before, &self->watch, tau);
    Py_INCREF(Py_None);
    return release(&held, Py_None);
}

PyDoc_STRVAR(hold_doc, "hold(wrench, friction)\n\nWrite the dry friction (n,) [Nm] of the brakes in a stop.");

static PyObject *guard_hold(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Guard *self = (Guard *)object;
    arrays held = {.count = 0};
    double *wrench, *friction;

    if (!count_is(count, 2, "hold") || !(wrench = take(&held, args[0], "wrench", READ, 6, 0)) ||
        !(friction = take(&held, args[1], "friction", WRITE, self->arm.n, 0)))
        return release(&held, NULL);
    moc_guard_hold(&self->guard, &self->arm, wrench, &self->watch, friction);
    Py_INCREF(Py_None);
    return release(&held, Py_None);
}

PyDoc_STRVAR(figures_doc, "figures() -> ((rms, largest, first tick) of the RCM error, the same of the force, bad ticks)");

static PyObject *guard_figures(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    const moc_watch *w = &((Guard *)object)->watch;
    (void)args;

    if (!count_is(count, 0, "figures"))
        return NULL;
    return Py_BuildValue("(ddL)(ddL)i", sqrt(w->mean_square[0]), w->largest[0], w->first_tick[0], sqrt(w->mean_square[1]),
                         w->largest[1], w->first_tick[1], w->bad);
}

static PyMethodDef guard_methods[] = {
    FAST("start", guard_start, guard_start_doc), FAST("believe", guard_believe, believe_doc),
    FAST("believed", guard_believed, believed_doc), FAST("follow", guard_follow, follow_doc),
    FAST("rest", guard_rest, rest_doc),          FAST("hold", guard_hold, hold_doc),
    FAST("figures", guard_figures, figures_doc), {NULL, NULL, 0, NULL},
};

static PyType_Slot guard_slots[] = {
    {Py_tp_doc, (void *)guard_doc}, {Py_tp_new, guard_new}, {Py_tp_dealloc, object_dealloc},
    {Py_tp_methods, guard_methods}, {0, NULL},
};

static PyType_Spec guard_spec = {"moc_opt.core._core.Guard", sizeof(Guard), 0, Py_TPFLAGS_DEFAULT, guard_slots};

PyDoc_STRVAR(desired_wrist_doc, "desired_wrist(X, dX, trocar, span, out)\n\n"
                                "Write N_d and dN_d (2, 3) for a tip (3,) and a trocar (2, 3): P_t, dP_t.");

static PyObject *desired_wrist(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    arrays held = {.count = 0};
    double *X, *dX, *points, *out;
    moc_trocar trocar;
    (void)module;

    if (!count_is(count, 5, "desired_wrist"))
        return NULL;
    double span = PyFloat_AsDouble(args[3]);
    if ((span == -1.0 && PyErr_Occurred()) || !(X = take(&held, args[0], "X", READ, 3, 0)) ||
        !(dX = take(&held, args[1], "dX", READ, 3, 0)) || !(points = take(&held, args[2], "trocar", READ, 2, 3)) ||
        !(out = take(&held, args[4], "out", WRITE, 2, 3)))
        return release(&held, NULL);
    memcpy(&trocar, points, sizeof trocar);
    moc_desired_wrist(X, dX, &trocar, span, out, out + 3);
    Py_INCREF(Py_None);
    return release(&held, Py_None);
}

static PyMethodDef functions[] = {
    FAST("solve_exact", solve_exact, solve_exact_doc),
    FAST("solve_exact_rows", solve_exact_rows, solve_exact_rows_doc),
    FAST("step_network", step_network, step_network_doc),
    FAST("desired_wrist", desired_wrist, desired_wrist_doc),
    FAST("judge", judge, judge_doc),
    FAST("retreat", retreat, retreat_doc),
    FAST("least_violation", least_violation, least_violation_doc),
    {NULL, NULL, 0, NULL},
};

static int fill(PyObject *module)
{
    static const struct {
        const char *name;
        int value;
    } constants[] = {
        {"OK", MOC_OK}, {"INFEASIBLE", MOC_INFEASIBLE}, {"DOUBTFUL", MOC_DOUBTFUL}, {"UNFINISHED", MOC_UNFINISHED},
        {"BAD_Q", MOC_BAD_Q}, {"BAD_V", MOC_BAD_V}, {"MAX_JOINTS", MOC_MAX_JOINTS},
    };
    static PyType_Spec *const specs[] = {&arm_spec, &law_spec, &guard_spec};
    static const char *const names[] = {"Arm", "Law", "Guard"};

    for (int k = 0; k < 3; k++) {
        PyObject *type = PyType_FromSpec(specs[k]);
        if (type == NULL || PyModule_AddObjectRef(module, names[k], type) < 0)
            return -1;
        if (k == 0)
            moc_arm_type = (PyTypeObject *)type; /* kept for ever */
        else
            Py_DECREF(type);
    }
    PyObject *reasons = PyTuple_New(MOC_STOPS);
    for (int k = 0; reasons != NULL && k < MOC_STOPS; k++)
        PyTuple_SetItem(reasons, k, PyUnicode_FromString(moc_reason((moc_stop)k)));
    if (reasons == NULL || PyModule_AddObjectRef(module, "REASONS", reasons) < 0)
        return -1;
    Py_DECREF(reasons);
    for (size_t k = 0; k < sizeof constants / sizeof constants[0]; k++)
        if (PyModule_AddIntConstant(module, constants[k].name, constants[k].value) < 0)
            return -1;
    return moc_add_tools(module);
}

static PyModuleDef_Slot module_slots[] = {{Py_mod_exec, fill}, {0, NULL}};

static PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_core", "The tick in C; see moc_opt/core/moc.h.", 0, functions, module_slots, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__core(void);

PyMODINIT_FUNC PyInit__core(void)
{
    return PyModuleDef_Init(&definition);
}
