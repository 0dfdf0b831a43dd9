/* The type Arm. */
#include "python.h"

static PyObject *arm_new(PyTypeObject *type, PyObject *given, PyObject *keywords)
{
    static const parameter table[] = {
        {"joints", READ, N, sizeof(moc_joint) / sizeof(double)}, {"points", READ, 2, 3}, {"tool", READ, 3, 3},
        {"moves", READ, 2, N}, {"gravity", READ, 3},
    };
    PyObject *args[5];
    call c;
    (void)keywords;

    if (!PyArg_UnpackTuple(given, "Arm", 5, 5, &args[0], &args[1], &args[2], &args[3], &args[4]) ||
        !moc_take(&c, 0, "Arm", args, 5, table, 5))
        return NULL;
    Arm *self = (Arm *)PyType_GenericAlloc(type, 0); /* filled with zeros */
    if (self == NULL)
        return NULL;
    moc_arm *arm = &self->arm;
    arm->n = c.n;
    memcpy(arm->joint, c.array[0], (size_t)c.n * sizeof *arm->joint);
    for (int j = 0; j < c.n; j++) {
        arm->moves[MOC_TIP][j] = c.array[3][j] > 0.0;
        arm->moves[MOC_WRIST][j] = c.array[3][c.n + j] > 0.0;
    }
    memcpy(arm->point, c.array[1], sizeof arm->point);
    memcpy(arm->tool, c.array[2], sizeof arm->tool);
    memcpy(arm->gravity, c.array[4], sizeof arm->gravity);
    return (PyObject *)self;
}

METHOD(Arm, terms, {"q", READ, N}, {"v", READ, N}, {"record", MADE, TERMS})
{
    moc_terms terms;
    if (moc_compute_terms(&self->arm, c->array[0], c->array[1], &terms) != MOC_OK)
        return PyErr_Format(PyExc_ValueError, "q, v: give finite numbers");
    moc_copy_terms(&terms, c->n, c->array[2], PACK);
    return Py_BuildValue("O", c->as[2]);
}

METHOD(Arm, along, {"poses", READ, K, N}, {"tips", MADE, K, 3}, {"wrists", MADE, K, 3}, {"mu", MADE, K})
{
    const moc_arm *arm = &self->arm;
    moc_frame frame[MOC_MAX_JOINTS];
    moc_twist twist[MOC_MAX_JOINTS];
    double J[3][MOC_MAX_JOINTS];

    for (Py_ssize_t i = 0; i < c->k; i++) {
        moc_place(arm, c->array[0] + i * c->n, frame, twist);
        moc_point(arm, frame, twist, MOC_WRIST, c->array[2] + 3 * i, J);
        moc_point(arm, frame, twist, MOC_TIP, c->array[1] + 3 * i, J);
        moc_gram gram = moc_gram_of(c->n, J);
        c->array[3][i] = moc_manipulability(c->n, twist, J, &gram, NULL);
    }
    return Py_BuildValue("OOO", c->as[1], c->as[2], c->as[3]);
}

METHOD(Arm, tool_pose, {"q", READ, N}, {"pose", MADE, 4, 3})
{
    moc_tool_pose(&self->arm, c->array[0], (double(*)[3])c->array[1]);
    return Py_BuildValue("O", c->as[1]);
}

/* --- planning --- */

#define TASK(points) {"low", READ, N}, {"high", READ, N}, {"target", READ, points, 3}

static plan_task take_task(const Arm *self, const call *c)
{
    plan_task task = {.arm = &self->arm, .low = c->array[0], .high = c->array[1]};
    memcpy(task.target, c->array[2], (size_t)rows_of(c, 2) * sizeof *task.target); /* one row or two */
    return task;
}

METHOD(Arm, nearest_pose, TASK(ANY), {"q", READ, N}, {"iterations", WHOLE}, {"best", MADE, N})
{
    int points = rows_of(c, 2);
    if (points < 1 || points > 2)
        return PyErr_Format(PyExc_ValueError, "target has %d rows: give one (tip) or two (tip and wrist)", points);
    const plan_task task = take_task(self, c);
    return Py_BuildValue("dO", plan_place(&task, points, whole(c, 4), c->array[3], c->array[5]), c->as[5]);
}

METHOD(Arm, follow_curve, TASK(2), {"q", READ, N}, {"tangent", READ, N}, {"step", NUMBER}, {"s", WRITE, K},
       {"poses", WRITE, K, N}, {"mus", WRITE, K})
{
    const plan_task task = take_task(self, c);
    int closed;
    if (c->k < 2 || !(c->number[5] > 0.0 && c->number[5] <= 10.0)) /* a longer step could not be halved often enough */
        return PyErr_Format(PyExc_ValueError,
                            "follow_curve: give 2 samples or more, and a step above 0 and up to 10 rad");
    int found = plan_follow(&task, c->array[3], c->array[4], c->number[5], (int)c->k, c->array[6], c->array[7],
                            c->array[8], &closed);
    return Py_BuildValue("ii", found, closed);
}

METHOD(Arm, ascend, TASK(2), {"starts", WRITE, K, N}, {"mus", WRITE, K})
{
    const plan_task task = take_task(self, c);
    Py_BEGIN_ALLOW_THREADS;
    for (Py_ssize_t i = 0; i < c->k; i++)
        c->array[4][i] = plan_ascend(&task, c->array[3] + i * c->n);
    Py_END_ALLOW_THREADS;
    Py_RETURN_NONE;
}

TYPE(Arm, arm_new, ENTRY(Arm, terms), ENTRY(Arm, along), ENTRY(Arm, tool_pose), ENTRY(Arm, nearest_pose),
     ENTRY(Arm, follow_curve), ENTRY(Arm, ascend));
