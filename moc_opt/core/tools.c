/* The binding's second half: loading a library's buffers, planning, and the simulated plant. */
#include "binding.h"
#include "plan.h"
#include "plant.h"

/* --- a QP library's buffers --- */

typedef struct {
    char *base;
    Py_ssize_t down, across; /* strides in bytes */
} place;

enum { P_, LINEAR, A_, LOW, HIGH, LOWER, UPPER, PACKED, TARGETS };

typedef struct {
    PyObject_HEAD
    Py_buffer view[TARGETS];
    place at[TARGETS];
    int held, n, m, five, packed;
    double scale, signs[3], lift[6][6];
} Loader;

static void put_at(const place *to, Py_ssize_t i, Py_ssize_t j, double value)
{
    memcpy(to->base + i * to->down + j * to->across, &value, sizeof value);
}

static void loader_dealloc(PyObject *object)
{
    Loader *self = (Loader *)object;
    PyTypeObject *type = Py_TYPE(object);
    freefunc release_memory = (freefunc)PyType_GetSlot(type, Py_tp_free);
    for (int k = 0; k < self->held; k++)
        PyBuffer_Release(&self->view[k]);
    release_memory(object);
    Py_DECREF(type);
}

PyDoc_STRVAR(loader_doc,
             "Loader(five, scale, signs, P, p, A, low, high, lower, upper, packed)\n\n"
             "Writes subproblems into a library's own arrays, float64 in any order of memory, and keeps these: P (n, n),\n"
             "p (n,), A (m, n), low and high (m,), lower and upper (n,), packed (n (n + 1) / 2,) the upper triangle of P\n"
             "by columns, or empty. five: the independent rows where there are such; scale: of the cost; signs (3,): of\n"
             "p, lower and upper.");

static PyObject *loader_new(PyTypeObject *type, PyObject *given, PyObject *keywords)
{
    static const char *const names[TARGETS] = {"P", "p", "A", "low", "high", "lower", "upper", "packed"};
    PyObject *to[TARGETS];
    double scale, sign[3];
    int five;

    if (keywords != NULL && PyDict_Size(keywords) > 0) {
        PyErr_SetString(PyExc_TypeError, "Loader takes no keywords");
        return NULL;
    }
    if (!PyArg_ParseTuple(given, "pd(ddd)OOOOOOOO", &five, &scale, &sign[0], &sign[1], &sign[2], &to[0], &to[1], &to[2],
                          &to[3], &to[4], &to[5], &to[6], &to[7]))
        return NULL;
    allocfunc allocate = (allocfunc)PyType_GetSlot(type, Py_tp_alloc);
    Loader *self = (Loader *)allocate(type, 0);
    if (self == NULL)
        return NULL;
    self->five = five;
    self->scale = scale;
    memcpy(self->signs, sign, sizeof sign);
    for (int k = 0; k < TARGETS; k++) {
        Py_buffer *view = &self->view[k];
        if (PyObject_GetBuffer(to[k], view, PyBUF_STRIDES | PyBUF_FORMAT | PyBUF_WRITABLE) < 0) {
            Py_DECREF(self);
            return NULL;
        }
        self->held++;
        if (view->format == NULL || strcmp(view->format, "d") != 0 || view->ndim != (k == P_ || k == A_ ? 2 : 1)) {
            PyErr_Format(PyExc_ValueError, "%s: give a writable array of float64 of its shape", names[k]);
            Py_DECREF(self);
            return NULL;
        }
        self->at[k] = (place){view->buf, view->strides[0], view->ndim > 1 ? view->strides[1] : 0};
    }
    Py_ssize_t n = self->view[P_].shape[0], m = self->view[A_].shape[0], packed = self->view[PACKED].shape[0];
    const Py_ssize_t lengths[TARGETS] = {n, n, m, m, m, n, n, packed};
    for (int k = 0; k < TARGETS; k++) {
        int square = k == P_ || k == A_;
        if (n < 1 || n > MOC_MAX_JOINTS || m < 5 || m > 6 || self->view[k].shape[0] != lengths[k] ||
            (square && self->view[k].shape[1] != n) || (packed != 0 && packed != n * (n + 1) / 2)) {
            PyErr_Format(PyExc_ValueError, "%s has another shape than P (n, n) and A (m, n) give it, m 5 or 6, n to %d",
                         names[k], MOC_MAX_JOINTS);
            Py_DECREF(self);
            return NULL;
        }
    }
    self->n = (int)n;
    self->m = (int)m;
    self->packed = packed > 0;
    return (PyObject *)self;
}

PyDoc_STRVAR(load_doc, "load(record) -> bool\n\nWrite a subproblem; False where it has another shape.");

static PyObject *loader_load(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Loader *self = (Loader *)object;
    arrays held = {.count = 0};
    moc_problem problem;
    double *record, P[MOC_MAX_JOINTS][MOC_MAX_JOINTS], linear[MOC_MAX_JOINTS], A[6][MOC_MAX_JOINTS], b[6];
    int n;

    if (!count_is(count, 1, "load") || !(record = take(&held, args[0], "record", READ, ANY, 0)) ||
        !(n = joints_of(rows_of(&held))))
        return release(&held, NULL);
    unpack(record, n, &problem);
    release(&held, NULL);
    if (n != self->n || moc_equalities(&problem, self->five, A, b, self->lift) != self->m)
        return PyBool_FromLong(0);
    moc_cost(&problem, P, linear);
    for (int i = 0, k = 0; i < n; i++) {
        for (int j = 0; j < n; j++)
            put_at(&self->at[P_], i, j, self->scale * P[i][j]);
        for (int j = 0; j <= i && self->packed; j++)
            put_at(&self->at[PACKED], k++, 0, self->scale * P[j][i]);
        put_at(&self->at[LINEAR], i, 0, self->scale * self->signs[0] * linear[i]);
        put_at(&self->at[LOWER], i, 0, self->signs[1] * problem.lower[i]);
        put_at(&self->at[UPPER], i, 0, self->signs[2] * problem.upper[i]);
    }
    for (int i = 0; i < self->m; i++) {
        for (int j = 0; j < n; j++)
            put_at(&self->at[A_], i, j, A[i][j]);
        put_at(&self->at[LOW], i, 0, b[i]);
        put_at(&self->at[HIGH], i, 0, b[i]);
    }
    return PyBool_FromLong(1);
}

PyDoc_STRVAR(lifted_doc, "lifted(y, factor, six)\n\nWrite factor lift^T y (6,) of a library's multipliers y (m,).");

static PyObject *loader_lifted(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Loader *self = (Loader *)object;
    arrays held = {.count = 0};
    double *y, *six, factor;

    if (!count_is(count, 3, "lifted"))
        return NULL;
    factor = PyFloat_AsDouble(args[1]);
    if ((factor == -1.0 && PyErr_Occurred()) || !(y = take(&held, args[0], "y", READ, self->m, 0)) ||
        !(six = take(&held, args[2], "six", WRITE, 6, 0)))
        return release(&held, NULL);
    for (int j = 0; j < 6; j++) {
        double total = 0.0;
        for (int i = 0; i < self->m; i++)
            total += self->lift[i][j] * y[i];
        six[j] = factor * total;
    }
    Py_INCREF(Py_None);
    return release(&held, Py_None);
}

static PyMethodDef loader_methods[] = {
    FAST("load", loader_load, load_doc), FAST("lifted", loader_lifted, lifted_doc), {NULL, NULL, 0, NULL},
};

static PyType_Slot loader_slots[] = {
    {Py_tp_doc, (void *)loader_doc}, {Py_tp_new, loader_new}, {Py_tp_dealloc, loader_dealloc},
    {Py_tp_methods, loader_methods}, {0, NULL},
};

static PyType_Spec loader_spec = {"moc_opt.core._core.Loader", sizeof(Loader), 0, Py_TPFLAGS_DEFAULT, loader_slots};

PyDoc_STRVAR(assemble_doc, "assemble(record, five, P, p, A, b, lift) -> rows\n\n"
                           "Write P (n, n), p (n,) and the equality rows into the first rows of A (6, n), b (6,), lift (6, 6).");

static PyObject *assemble(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    arrays held = {.count = 0};
    moc_problem problem;
    double *record, *P, *p, *A, *b, *lift, full[MOC_MAX_JOINTS][MOC_MAX_JOINTS], rows[6][MOC_MAX_JOINTS];
    int n;
    (void)module;

    if (!count_is(count, 7, "assemble") || !(record = take(&held, args[0], "record", READ, ANY, 0)) ||
        !(n = joints_of(rows_of(&held))) || !(P = take(&held, args[2], "P", WRITE, n, n)) ||
        !(p = take(&held, args[3], "p", WRITE, n, 0)) || !(A = take(&held, args[4], "A", WRITE, 6, n)) ||
        !(b = take(&held, args[5], "b", WRITE, 6, 0)) || !(lift = take(&held, args[6], "lift", WRITE, 6, 6)))
        return release(&held, NULL);
    unpack(record, n, &problem);
    moc_cost(&problem, full, p);
    int m = moc_equalities(&problem, PyObject_IsTrue(args[1]), rows, b, (double(*)[6])lift);
    for (int i = 0; i < n; i++)
        memcpy(P + i * n, full[i], (size_t)n * sizeof *P);
    for (int i = 0; i < m; i++)
        memcpy(A + i * n, rows[i], (size_t)n * sizeof *A);
    return release(&held, PyLong_FromLong(m));
}

/* --- planning --- */

/* arm, low (n,), high (n,), target (2, 3), and active: joint numbers as float64, or None. 0 with an exception. */
static int take_task(arrays *held, PyObject *const *args, plan_task *task)
{
    double *target, *active = NULL;
    int n;

    if (!(task->arm = arm_of(args[0])) || !(n = task->arm->n) || !(task->low = take(held, args[1], "low", READ, n, 0)) ||
        !(task->high = take(held, args[2], "high", READ, n, 0)) ||
        !(target = take(held, args[3], "target", READ, 2, 3)) ||
        (args[4] != Py_None && !(active = take(held, args[4], "active", READ, ANY, 0))))
        return 0;
    memcpy(task->target, target, sizeof task->target);
    task->count = active ? (int)rows_of(held) : 0;
    for (int i = 0; i < task->count; i++) {
        if (task->count > n || !(active[i] >= 0.0 && active[i] < n)) {
            PyErr_Format(PyExc_ValueError, "active: give numbers of joints from 0 to %d", n - 1);
            return 0;
        }
        task->active[i] = (int)active[i];
    }
    return n;
}

PyDoc_STRVAR(follow_curve_doc,
             "follow_curve(arm, low, high, target, active, q, tangent, step, s, poses, mus) -> (count, end)\n\n"
             "Samples of a self-motion from q on along the tangent; s (k,), poses (k, n), mus (k,). See plan.h.");

static PyObject *follow_curve(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    arrays held = {.count = 0};
    plan_task task;
    plan_end end;
    double *q, *tangent, *s, *poses, *mus;
    int n;
    (void)module;

    if (!count_is(count, 11, "follow_curve") || !(n = take_task(&held, args, &task)) ||
        !(q = take(&held, args[5], "q", READ, n, 0)) || !(tangent = take(&held, args[6], "tangent", READ, n, 0)) ||
        !(s = take(&held, args[8], "s", WRITE, ANY, 0)))
        return release(&held, NULL);
    Py_ssize_t most = rows_of(&held);
    double step = PyFloat_AsDouble(args[7]);
    if ((step == -1.0 && PyErr_Occurred()) || !(poses = take(&held, args[9], "poses", WRITE, most, n)) ||
        !(mus = take(&held, args[10], "mus", WRITE, most, 0)))
        return release(&held, NULL);
    if (most < 2 || most > INT_MAX / n) {
        PyErr_Format(PyExc_ValueError, "s has %zd entries: give 2 or more", most);
        return release(&held, NULL);
    }
    int found = plan_follow(&task, q, tangent, step, (int)most, s, poses, mus, &end);
    return release(&held, Py_BuildValue("ii", found, (int)end));
}

PyDoc_STRVAR(onto_curve_doc, "onto_curve(arm, low, high, target, active, q, along, pose) -> bool\n\n"
                             "The pose (n,) on the curve across the unit vector along (n,) from q, inside the limits.");

static PyObject *onto_curve(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    arrays held = {.count = 0};
    plan_task task;
    double *q, *along, *pose;
    int n;
    (void)module;

    if (!count_is(count, 8, "onto_curve") || !(n = take_task(&held, args, &task)) ||
        !(q = take(&held, args[5], "q", READ, n, 0)) || !(along = take(&held, args[6], "along", READ, n, 0)) ||
        !(pose = take(&held, args[7], "pose", WRITE, n, 0)))
        return release(&held, NULL);
    return release(&held, PyBool_FromLong(plan_correct(&task, q, along, pose)));
}

PyDoc_STRVAR(ascend_doc, "ascend(arm, low, high, target, None, starts, mus)\n\n"
                         "Climb from every start (k, n), in place, to a local maximum of mu (k,); -1: no pose.");

static PyObject *ascend(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    arrays held = {.count = 0};
    plan_task task;
    double *starts, *mus;
    int n;
    (void)module;

    if (!count_is(count, 7, "ascend") || !(n = take_task(&held, args, &task)) ||
        !(starts = take(&held, args[5], "starts", WRITE, ANY, n)))
        return release(&held, NULL);
    Py_ssize_t k = rows_of(&held);
    if (!(mus = take(&held, args[6], "mus", WRITE, k, 0)))
        return release(&held, NULL);
    Py_BEGIN_ALLOW_THREADS;
    for (Py_ssize_t i = 0; i < k; i++)
        mus[i] = plan_ascend(&task, starts + i * n);
    Py_END_ALLOW_THREADS;
    Py_INCREF(Py_None);
    return release(&held, Py_None);
}

PyDoc_STRVAR(advance_doc,
             "advance(branches, q, slack, gain, q_next, slack_next, value_next, step, crossing, price, worst, value, room)\n\n"
             "One step of a value function, see plan.h; poses are rows (branches m, n), gain and value (branches m,).");

static PyObject *advance(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    arrays held = {.count = 0};
    plan_stage t;
    double *crossing, *value, *room;
    (void)module;

    if (!count_is(count, 13, "advance") || !(t.step = take(&held, args[7], "step", READ, ANY, 0)))
        return release(&held, NULL);
    Py_ssize_t n = rows_of(&held), rows, after, m;
    if (!(t.q = take(&held, args[1], "q", READ, ANY, n)))
        return release(&held, NULL);
    rows = rows_of(&held);
    if (!(t.slack = take(&held, args[2], "slack", READ, rows, n)) || !(t.gain = take(&held, args[3], "gain", READ, rows, 0)) ||
        !(t.q_next = take(&held, args[4], "q_next", READ, ANY, n)))
        return release(&held, NULL);
    after = rows_of(&held);
    if (!(t.slack_next = take(&held, args[5], "slack_next", READ, after, n)) ||
        !(t.value_next = take(&held, args[6], "value_next", READ, after, 0)) ||
        !(crossing = take(&held, args[8], "crossing", READ, ANY, 0)))
        return release(&held, NULL);
    m = rows_of(&held);
    long branches = PyLong_AsLong(args[0]);
    t.price = PyFloat_AsDouble(args[9]);
    t.worst = PyObject_IsTrue(args[10]);
    if (PyErr_Occurred() || !(value = take(&held, args[11], "value", WRITE, rows, 0)))
        return release(&held, NULL);
    if (branches < 1 || m < 1 || rows != branches * m || after % branches != 0 || rows * n > INT_MAX ||
        after * n > INT_MAX) {
        PyErr_SetString(PyExc_ValueError, "advance: the rows are not those of so many branches and crossings");
        return release(&held, NULL);
    }
    Py_ssize_t next = after / branches, blocks = (next + PLAN_BLOCK - 1) / PLAN_BLOCK;
    if (!(room = take(&held, args[12], "room", WRITE, branches * blocks * (2 * n + 1), 0)))
        return release(&held, NULL);
    for (Py_ssize_t j = 0; j < m; j++)
        if (!(crossing[j] >= 0.0 && crossing[j] < (double)branches)) {
            PyErr_Format(PyExc_ValueError, "crossing: give bits below the %ld branches", branches);
            return release(&held, NULL);
        }
    t.branches = (int)branches;
    t.m = (int)m;
    t.next = (int)next;
    t.n = (int)n;
    t.crossing = crossing;
    Py_BEGIN_ALLOW_THREADS;
    plan_advance(&t, room, value);
    Py_END_ALLOW_THREADS;
    Py_INCREF(Py_None);
    return release(&held, Py_None);
}

/* --- the simulated plant --- */

PyDoc_STRVAR(shaft_force_doc,
             "shaft_force(tip, wrist, twist, origin, trocar, elapsed, stiffness, damping, force, point)\n\n"
             "Write the trocar's force on the shaft and where it acts, (3,) each, world axes; see plant.h.");

static PyObject *shaft_force(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    arrays held = {.count = 0};
    double *tip, *wrist, *twist, *origin, *trocar, *force, *point, number[3];
    (void)module;

    if (!count_is(count, 10, "shaft_force"))
        return NULL;
    for (int k = 0; k < 3; k++)
        number[k] = PyFloat_AsDouble(args[5 + k]);
    if (PyErr_Occurred() || !(tip = take(&held, args[0], "tip", READ, 3, 0)) ||
        !(wrist = take(&held, args[1], "wrist", READ, 3, 0)) || !(twist = take(&held, args[2], "twist", READ, 6, 0)) ||
        !(origin = take(&held, args[3], "origin", READ, 3, 0)) || !(trocar = take(&held, args[4], "trocar", READ, 2, 3)) ||
        !(force = take(&held, args[8], "force", WRITE, 3, 0)) || !(point = take(&held, args[9], "point", WRITE, 3, 0)))
        return release(&held, NULL);
    plant_shaft_force(tip, wrist, twist, origin, trocar, number[0], number[1], number[2], force, point);
    Py_INCREF(Py_None);
    return release(&held, Py_None);
}

PyDoc_STRVAR(add_force_doc, "add_force(wrench, force, point, com)\n\n"
                            "Add a force (3,) at a point (3,) to a body's wrench (6,) about its centre of mass (3,).");

static PyObject *add_force(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    arrays held = {.count = 0};
    double *wrench, *force, *point, *com;
    (void)module;

    if (!count_is(count, 4, "add_force") || !(wrench = take(&held, args[0], "wrench", WRITE, 6, 0)) ||
        !(force = take(&held, args[1], "force", READ, 3, 0)) || !(point = take(&held, args[2], "point", READ, 3, 0)) ||
        !(com = take(&held, args[3], "com", READ, 3, 0)))
        return release(&held, NULL);
    plant_add_force(wrench, force, point, com);
    Py_INCREF(Py_None);
    return release(&held, Py_None);
}

PyDoc_STRVAR(read_encoders_doc, "read_encoders(q, v, noise, memory, resolution, period, gain, exact, reading)\n\n"
                                "Write positions, then velocities, into reading (2 n,); memory (3, n) goes on. See plant.h.");

static PyObject *read_encoders(PyObject *module, PyObject *const *args, Py_ssize_t count)
{
    arrays held = {.count = 0};
    plant_encoders e;
    double *q, *v, *noise, *memory, *reading;
    (void)module;

    if (!count_is(count, 9, "read_encoders") || !(q = take(&held, args[0], "q", READ, ANY, 0)))
        return release(&held, NULL);
    Py_ssize_t n = rows_of(&held);
    e.resolution = PyFloat_AsDouble(args[4]);
    e.period = PyFloat_AsDouble(args[5]);
    e.gain = PyFloat_AsDouble(args[6]);
    e.exact = PyObject_IsTrue(args[7]);
    if (PyErr_Occurred() || !(v = take(&held, args[1], "v", READ, n, 0)) ||
        !(noise = take(&held, args[2], "noise", READ, n, 0)) || !(memory = take(&held, args[3], "memory", WRITE, 3, n)) ||
        !(reading = take(&held, args[8], "reading", WRITE, 2 * n, 0)))
        return release(&held, NULL);
    plant_read_encoders(&e, (int)n, q, v, noise, memory, reading);
    Py_INCREF(Py_None);
    return release(&held, Py_None);
}

static PyMethodDef tools[] = {
    FAST("assemble", assemble, assemble_doc),
    FAST("follow_curve", follow_curve, follow_curve_doc),
    FAST("onto_curve", onto_curve, onto_curve_doc),
    FAST("ascend", ascend, ascend_doc),
    FAST("advance", advance, advance_doc),
    FAST("shaft_force", shaft_force, shaft_force_doc),
    FAST("add_force", add_force, add_force_doc),
    FAST("read_encoders", read_encoders, read_encoders_doc),
    {NULL, NULL, 0, NULL},
};

int moc_add_tools(PyObject *module)
{
    PyObject *type = PyType_FromSpec(&loader_spec);
    if (type == NULL || PyModule_AddObjectRef(module, "Loader", type) < 0)
        return -1;
    Py_DECREF(type);
    return PyModule_AddFunctions(module, tools);
}
