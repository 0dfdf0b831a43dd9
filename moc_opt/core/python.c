/* The core as a Python module, for CPython's limited API: one wheel serves every version from 3.11 on.
 *
 * Here are its objects: the arm, the law with its memory, and the safety filter. tools.c has its functions. */
#include "python.h"

#include <time.h>

PyTypeObject *moc_arm_type;

void *moc_make(PyTypeObject *type)
{
    allocfunc allocate = (allocfunc)PyType_GetSlot(type, Py_tp_alloc);
    return allocate(type, 0); /* zeros */
}

static void forget_object(PyObject *self)
{
    PyTypeObject *type = Py_TYPE(self);
    freefunc release_memory = (freefunc)PyType_GetSlot(type, Py_tp_free);
    release_memory(self);
    Py_DECREF(type);
}

const moc_arm *moc_arm_of(PyObject *given)
{
    if (Py_TYPE(given) == moc_arm_type)
        return &((Arm *)given)->arm;
    PyErr_SetString(PyExc_TypeError, "arm: give a moc_opt.core.Arm");
    return NULL;
}

/* --- the arm --- */

static PyObject *arm_new(PyTypeObject *type, PyObject *given, PyObject *keywords)
{
    PyObject *args[7];
    call c;
    (void)keywords;

    if (!PyArg_UnpackTuple(given, "Arm", 7, 7, &args[0], &args[1], &args[2], &args[3], &args[4], &args[5], &args[6]))
        return NULL;
    Py_ssize_t count = 7;
    if (!TAKE(&c, 0, "Arm", {"joints", READ, N, 16}, {"bodies", READ, N, 10}, {"rotors", READ, N},
              {"points", READ, 2, 3}, {"tool", READ, 3, 3}, {"moves", READ, 2, N}, {"gravity", READ, 3}))
        return NULL;
    Arm *self = moc_make(type);
    if (self == NULL)
        return moc_done(&c, NULL);
    moc_arm *arm = &self->arm;
    arm->n = c.n;
    for (int j = 0; j < c.n; j++) {
        moc_joint *joint = &arm->joint[j];
        const double *row = c.array[0] + 16 * j, *body = c.array[1] + 10 * j;
        memcpy(joint->rotation, row, sizeof joint->rotation);
        memcpy(joint->origin, row + 9, sizeof joint->origin);
        memcpy(joint->axis, row + 12, sizeof joint->axis);
        joint->slides = row[15] > 0.0;
        joint->mass = body[0];
        memcpy(joint->moment, body + 1, sizeof joint->moment);
        memcpy(joint->inertia, body + 4, sizeof joint->inertia);
        joint->rotor = c.array[2][j];
        arm->moves[MOC_TIP][j] = c.array[5][j] != 0.0;
        arm->moves[MOC_WRIST][j] = c.array[5][c.n + j] != 0.0;
    }
    memcpy(arm->point, c.array[3], sizeof arm->point);
    memcpy(arm->tool, c.array[4], sizeof arm->tool);
    memcpy(arm->gravity, c.array[6], sizeof arm->gravity);
    return moc_done(&c, (PyObject *)self);
}

static PyObject *arm_terms(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    const moc_arm *arm = &((Arm *)self)->arm;
    moc_terms terms;
    call c;

    if (!TAKE(&c, arm->n, "terms", {"q", READ, N}, {"v", READ, N}, {"record", WRITE, TERMS}))
        return NULL;
    moc_status status = moc_compute_terms(arm, c.array[0], c.array[1], &terms);
    if (status == MOC_OK)
        moc_pack_terms(&terms, arm->n, c.array[2]);
    return whole(&c, status);
}

static PyObject *arm_mu_along(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    const moc_arm *arm = &((Arm *)self)->arm;
    moc_frame frame[MOC_MAX_JOINTS];
    moc_twist twist[MOC_MAX_JOINTS];
    double J[3][MOC_MAX_JOINTS], tip[3];
    call c;

    if (!TAKE(&c, arm->n, "mu_along", {"poses", READ, K, N}, {"mu", WRITE, K}))
        return NULL;
    for (Py_ssize_t i = 0; i < c.k; i++) {
        moc_place(arm, c.array[0] + i * arm->n, frame);
        moc_twists(arm, frame, twist);
        moc_point(&frame[arm->n - 1], arm->point[MOC_TIP], tip);
        moc_jacobian(arm->n, twist, tip, arm->moves[MOC_TIP], J);
        c.array[1][i] = moc_yoshikawa(arm->n, J);
    }
    return none(&c);
}

static PyObject *arm_points_along(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    const moc_arm *arm = &((Arm *)self)->arm;
    moc_frame frame[MOC_MAX_JOINTS];
    call c;

    if (!TAKE(&c, arm->n, "points_along", {"poses", READ, K, N}, {"points", READ, ANY, 3}, {"out", WRITE, ANY, 3}))
        return NULL;
    int points = rows_of(&c, 1);
    if (rows_of(&c, 2) != c.k * points) {
        PyErr_SetString(PyExc_ValueError, "out: give (m k, 3) for m points at k poses");
        return moc_done(&c, NULL);
    }
    for (Py_ssize_t i = 0; i < c.k; i++) {
        moc_place(arm, c.array[0] + i * arm->n, frame);
        for (int j = 0; j < points; j++)
            moc_point(&frame[arm->n - 1], c.array[1] + 3 * j, c.array[2] + 3 * (j * c.k + i));
    }
    return none(&c);
}

static PyObject *arm_tool_pose(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    const moc_arm *arm = &((Arm *)self)->arm;
    call c;

    if (!TAKE(&c, arm->n, "tool_pose", {"q", READ, N}, {"pose", WRITE, 4, 3}))
        return NULL;
    moc_tool_pose(arm, c.array[0], (double(*)[3])c.array[1]);
    return none(&c);
}

static PyObject *arm_nearest_pose(PyObject *self, PyObject *const *args, Py_ssize_t count)
{
    const moc_arm *arm = &((Arm *)self)->arm;
    call c;

    if (!TAKE(&c, arm->n, "nearest_pose", {"targets", READ, K, 3}, {"low", READ, N}, {"high", READ, N}, {"q", READ, N},
              {"iterations", WHOLE}, {"best", WRITE, N}))
        return NULL;
    if (c.k < 1 || c.k > 2) {
        PyErr_Format(PyExc_ValueError, "targets has %zd rows: give one (tip) or two (tip and wrist)", c.k);
        return moc_done(&c, NULL);
    }
    double miss = moc_nearest_pose(arm, (int)c.k, (double(*)[3])c.array[0], c.array[1], c.array[2], (int)c.whole[4],
                                   c.array[3], c.array[5]);
    return moc_done(&c, PyFloat_FromDouble(miss));
}

static PyMethodDef arm_methods[] = {
    FAST("terms", arm_terms, "terms(q, v, record) -> status: all terms of one state"),
    FAST("mu_along", arm_mu_along, "mu_along(poses, mu): manipulability of the tip"),
    FAST("points_along", arm_points_along, "points_along(poses, points, out): points of the last joint's axes [m]"),
    FAST("tool_pose", arm_tool_pose, "tool_pose(q, pose): the tool's axes x, y, z and its tip [m]"),
    FAST("nearest_pose", arm_nearest_pose, "nearest_pose(targets, low, high, q, iterations, best) -> miss [m]"),
    {NULL, NULL, 0, NULL},
};

static PyType_Slot arm_slots[] = {
    {Py_tp_doc, "Arm(joints, bodies, rotors, points, tool, moves, gravity)\n\nA serial chain of 1 to 16 joints as data."},
    {Py_tp_new, arm_new}, {Py_tp_dealloc, forget_object}, {Py_tp_methods, arm_methods}, {0, NULL},
};

/* --- structs from keywords --- */

static const field law_fields[] = {
    FIELD(moc_law, K_X, DOUBLE), FIELD(moc_law, D_X, DOUBLE), FIELD(moc_law, K_N, DOUBLE), FIELD(moc_law, D_N, DOUBLE),
    FIELD(moc_law, rcm_lambda, DOUBLE), FIELD(moc_law, projector, INT), FIELD(moc_law, feedforward, INT),
    FIELD(moc_law, K_N2, JOINTS), FIELD(moc_law, D_N2, JOINTS), FIELD(moc_law, tau_max, JOINTS),
    FIELD(moc_law, k0, DOUBLE), FIELD(moc_law, c0, DOUBLE), FIELD(moc_law, c1, DOUBLE), FIELD(moc_law, c2, DOUBLE),
    FIELD(moc_law, rho, DOUBLE), FIELD(moc_law, q_min, JOINTS), FIELD(moc_law, q_max, JOINTS),
    FIELD(moc_law, v_max, JOINTS), FIELD(moc_law, shaft_margin, DOUBLE), FIELD(moc_law, spare_speed, DOUBLE),
    FIELD(moc_law, observer_gain, DOUBLE), FIELD(moc_law, period, DOUBLE), FIELD(moc_law, fade, DOUBLE),
    FIELD(moc_law, third_level, INT), FIELD(moc_law, damped, INT), FIELD(moc_law, climbs, INT),
};

static const field supervision_fields[] = {
    FIELD(moc_supervision, check, INT), FIELD(moc_supervision, box_limit, DOUBLE),
    FIELD(moc_supervision, primal_limit, DOUBLE), FIELD(moc_supervision, relative_limit, DOUBLE),
    FIELD(moc_supervision, opposite_limit, DOUBLE), FIELD(moc_supervision, hold_ticks, INT),
    FIELD(moc_supervision, keep_off_limits, INT), FIELD(moc_supervision, fallback, INT),
    FIELD(moc_supervision, late, INT), FIELD(moc_supervision, budget_us, DOUBLE),
};

static const field guard_fields[] = {
    FIELD(moc_guard, period, DOUBLE), FIELD(moc_guard, patience, INT), FIELD(moc_guard, carries, INT),
    FIELD(moc_guard, low, JOINTS), FIELD(moc_guard, high, JOINTS), FIELD(moc_guard, v_max, JOINTS),
    FIELD(moc_guard, tau_max, JOINTS), FIELD(moc_guard, wall_stiffness, DOUBLE), FIELD(moc_guard, wall_damping, DOUBLE),
    FIELD(moc_guard, wall_brake, DOUBLE), FIELD(moc_guard, torque_step, DOUBLE), FIELD(moc_guard, jump, DOUBLE),
    FIELD(moc_guard, speed_factor, DOUBLE), FIELD(moc_guard, tip_error, DOUBLE), FIELD(moc_guard, tip_share, DOUBLE),
    FIELD(moc_guard, in_incision, INT), FIELD(moc_guard, warning, PAIR), FIELD(moc_guard, limit, PAIR),
    FIELD(moc_guard, incision_share, DOUBLE), FIELD(moc_guard, tool_mass, DOUBLE), FIELD(moc_guard, tool_length, DOUBLE),
    FIELD(moc_guard, tip_force, DOUBLE), FIELD(moc_guard, stop_holding, DOUBLE), FIELD(moc_guard, stop_yield, DOUBLE),
    FIELD(moc_guard, stop_yield_ticks, INT), FIELD(moc_guard, press_share, DOUBLE), FIELD(moc_guard, motion, INT),
    FIELD(moc_guard, motion_s, DOUBLE), FIELD(moc_guard, motion_rad, DOUBLE), FIELD(moc_guard, motion_lag_s, DOUBLE),
    FIELD(moc_guard, repeat_m, DOUBLE), FIELD(moc_guard, repeat_torque, DOUBLE),
    FIELD(moc_guard, repeat_whole_m, DOUBLE), FIELD(moc_guard, repeat_whole_torque, DOUBLE),
    FIELD(moc_guard, repeat_whole_ticks, DOUBLE), FIELD(moc_guard, repeat_joint_ticks, DOUBLE),
    FIELD(moc_guard, repeat_reading_ticks, DOUBLE), FIELD(moc_guard, replayed_ticks, DOUBLE),
    FIELD(moc_guard, stuck_speed, DOUBLE), FIELD(moc_guard, held, JOINTS), FIELD(moc_guard, residual_torque, DOUBLE),
    FIELD(moc_guard, residual_whole, DOUBLE), FIELD(moc_guard, residual_rate, DOUBLE),
    FIELD(moc_guard, residual_share, DOUBLE), FIELD(moc_guard, settling_ticks, INT),
};

/* The arm that is the only positional argument, beside so many keywords; NULL with an exception. */
static const moc_arm *take_arm(PyObject *given, PyObject *keywords, size_t count, const char *name)
{
    PyObject *arm;
    if (!PyArg_UnpackTuple(given, name, 1, 1, &arm))
        return NULL;
    if (keywords != NULL && PyDict_Size(keywords) > (Py_ssize_t)count) {
        PyErr_Format(PyExc_TypeError, "%s takes %zu keywords, %zd were given", name, count, PyDict_Size(keywords));
        return NULL;
    }
    return moc_arm_of(arm);
}

/* --- the law --- */

typedef struct {
    PyObject_HEAD
    moc_arm arm;
    moc_law law;
    moc_supervision supervision;
    moc_controller controller; /* points to the three above; no safety filter: Python puts its own around any controller */
    moc_state state;
} Law;

static PyObject *law_new(PyTypeObject *type, PyObject *given, PyObject *keywords)
{
    const moc_arm *arm = take_arm(given, keywords, COUNT(law_fields) + COUNT(supervision_fields), "Law");
    moc_law law;
    moc_supervision s;

    if (arm == NULL || !moc_fill(keywords, law_fields, COUNT(law_fields), arm->n, &law) ||
        !moc_fill(keywords, supervision_fields, COUNT(supervision_fields), arm->n, &s))
        return NULL;
    if ((unsigned)law.projector > MOC_AS_PUBLISHED || (unsigned)s.fallback > MOC_LEAST_VIOLATION ||
        (unsigned)s.late > MOC_LATE_ITERATE) {
        PyErr_SetString(PyExc_ValueError, "projector, fallback and late: give 0, 1 or 2");
        return NULL;
    }
    Law *self = moc_make(type);
    if (self == NULL)
        return NULL;
    self->arm = *arm;
    self->law = law;
    self->supervision = s;
    self->controller = (moc_controller){&self->arm, &self->law, &self->supervision, NULL, 0.0};
    return (PyObject *)self;
}

/* Arguments 0 to 2 of start and begin: a state's record, the references X_d, dX_d, ddX_d and the trocar P_t, dP_t. */
static void take_tick(Law *self, const call *c, moc_input *in)
{
    moc_unpack_terms(c->array[0], c->n, &self->state.terms);
    memcpy(&in->ref, c->array[1], sizeof in->ref);
    memcpy(&in->trocar, c->array[2], sizeof in->trocar);
    in->pull = c->array[3];
}

#define TICK {"record", READ, TERMS}, {"tip_ref", READ, 3, 3}, {"trocar", READ, 2, 3}

static PyObject *law_start(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Law *self = (Law *)object;
    moc_input in;
    call c;

    if (!TAKE(&c, self->arm.n, "start", TICK, {"row", WRITE, ROW}))
        return NULL;
    take_tick(self, &c, &in);
    moc_start_law(&self->controller, &self->state);
    moc_fill_problem(&self->law, c.n, &self->state.terms, &in.ref, &in.trocar, NULL, &self->state.problem);
    moc_pack_problem(&self->state.problem, self->state.terms.q, c.array[3]);
    return none(&c);
}

static PyObject *law_load(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Law *self = (Law *)object;
    moc_memory *memory = &self->state.memory;
    call c;

    if (!TAKE(&c, self->arm.n, "load", {"record", READ, ROW}, {"Z", READ, K, N}))
        return NULL;
    moc_unpack_problem(c.array[0], c.n, &self->state.problem);
    self->state.begun = MOC_BEGUN;
    memory->rows = c.k < c.n ? (int)c.k : c.n;
    for (int i = 0; i < memory->rows; i++)
        memcpy(memory->Z[i], c.array[1] + i * c.n, (size_t)c.n * sizeof(double));
    return none(&c);
}

static PyObject *law_begin(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Law *self = (Law *)object;
    moc_input in;
    call c;

    if (!TAKE(&c, self->arm.n, "begin", TICK, {"pull", MAYBE, N}, {"row", WRITE, ROW}))
        return NULL;
    take_tick(self, &c, &in);
    moc_levels(&self->controller, &in, &self->state);
    if (self->law.third_level)
        moc_pack_problem(&self->state.problem, self->state.terms.q, c.array[4]);
    return none(&c);
}

static PyObject *law_finish(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Law *self = (Law *)object;
    call c;

    if (!TAKE(&c, self->arm.n, "finish", {"known", WHOLE}, {"claim", WHOLE}, {"answer", MAYBE, N}, {"solve_us", NUMBER},
              {"x", WRITE, N}, {"tau", WRITE, N}))
        return NULL;
    if (c.whole[0] < MOC_TAKEN || c.whole[0] >= MOC_FAULTS || c.whole[1] < MOC_CLAIMS_OPTIMUM ||
        c.whole[1] > MOC_GIVES_NONE || (c.array[2] == NULL && self->law.third_level)) {
        PyErr_SetString(PyExc_ValueError, "known: give a fault's number; claim: 0 to 3; answer: an array");
        return moc_done(&c, NULL);
    }
    const moc_answer answer = {c.array[2], (moc_claim)c.whole[1], (moc_fault)c.whole[0], c.number[3]};
    moc_finish(&self->controller, &answer, &self->state, c.array[5]);
    memcpy(c.array[4], self->state.x, (size_t)c.n * sizeof(double));
    return whole(&c, self->state.fault);
}

static double now_us(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return 1e6 * (double)now.tv_sec + 1e-3 * (double)now.tv_nsec;
}

static PyObject *law_step(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Law *self = (Law *)object;
    moc_state *s = &self->state;
    moc_input in;
    call c;

    if (!TAKE(&c, self->arm.n, "step", TICK, {"pull", MAYBE, N}, {"tolerance", NUMBER}, {"solve_us", NUMBER},
              {"out", WRITE, TICKED}))
        return NULL;
    size_t bytes = (size_t)c.n * sizeof(double);
    double *row = c.array[6], *found = row + 11 * c.n + 10;
    take_tick(self, &c, &in);
    self->controller.tolerance = c.number[4];
    moc_levels(&self->controller, &in, s);
    double from = now_us();
    moc_answer answer = moc_ask_exact(&self->controller, s);
    answer.us = isnan(c.number[5]) ? now_us() - from : c.number[5];
    moc_finish(&self->controller, &answer, s, found + 2 * c.n + 6);
    moc_pack_problem(&s->problem, s->terms.q, row);
    memcpy(found, s->answer, bytes);
    memcpy(found + c.n, s->y, sizeof s->y);
    memcpy(found + c.n + 6, s->x, bytes);
    return moc_done(&c, Py_BuildValue("iid", (int)s->status, (int)s->fault, answer.us));
}

static PyObject *law_set_applied(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Law *self = (Law *)object;
    call c;

    if (!TAKE(&c, self->arm.n, "set_applied", {"tau", READ, N}))
        return NULL;
    memcpy(self->state.memory.tau, c.array[0], (size_t)c.n * sizeof(double));
    return none(&c);
}

static PyObject *law_get(PyObject *object, void *which)
{
    return moc_show(which, ((Law *)object)->arm.n, &((Law *)object)->state.memory);
}

static const field memory_fields[] = {
    FIELD(moc_memory, external, JOINTS), {"Z", offsetof(moc_memory, Z), BASIS, offsetof(moc_memory, rows)},
};

static PyGetSetDef law_attributes[] = {
    {"external", law_get, NULL, "the observer's estimate of the external torque (n,) [Nm]", (void *)&memory_fields[0]},
    {"Z", law_get, NULL, "the basis of ker A, (r, n)", (void *)&memory_fields[1]},
    {NULL, NULL, NULL, NULL, NULL},
};

static PyMethodDef law_methods[] = {
    FAST("start", law_start, "start(record, tip_ref, trocar, row): forget all; the subproblem of this state into row"),
    FAST("load", law_load, "load(record, Z): take these for this tick's subproblem and null space"),
    FAST("begin", law_begin, "begin(record, tip_ref, trocar, pull, row): levels 1 and 2, and the subproblem into row"),
    FAST("finish", law_finish, "finish(known, claim, answer, solve_us, x, tau) -> fault: x is what the arm follows"),
    FAST("step", law_step,
         "step(record, tip_ref, trocar, pull, tolerance, solve_us, out) -> (status, fault, us):\n"
         "begin, the exact solver and finish; solve_us: NaN, or what replaces the clock; out: the subproblem's record,\n"
         "the solver's x and y, the x that the arm follows, and tau"),
    FAST("set_applied", law_set_applied, "set_applied(tau): replace the last torque by the one that was applied"),
    {NULL, NULL, 0, NULL},
};

static PyType_Slot law_slots[] = {
    {Py_tp_doc, "Law(arm, **numbers)\n\nThe law with its memory; numbers: the fields of moc_law and moc_supervision."},
    {Py_tp_new, law_new}, {Py_tp_dealloc, forget_object}, {Py_tp_methods, law_methods},
    {Py_tp_getset, law_attributes}, {0, NULL},
};

/* --- the safety filter --- */

typedef struct {
    PyObject_HEAD
    moc_arm arm;
    moc_guard guard;
    moc_watch watch;
} Guard;

static PyObject *guard_new(PyTypeObject *type, PyObject *given, PyObject *keywords)
{
    const moc_arm *arm = take_arm(given, keywords, COUNT(guard_fields), "Guard");
    moc_guard guard;

    if (arm == NULL || !moc_fill(keywords, guard_fields, COUNT(guard_fields), arm->n, &guard))
        return NULL;
    Guard *self = moc_make(type);
    if (self == NULL)
        return NULL;
    self->arm = *arm;
    self->guard = guard;
    return (PyObject *)self;
}

static PyObject *guard_start(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Guard *self = (Guard *)object;
    call c;

    if (!TAKE(&c, self->arm.n, "start", {"q", READ, N}, {"v", READ, N}, {"stamp", LONG}))
        return NULL;
    moc_guard_start(&self->guard, c.n, c.array[0], c.array[1], c.whole[2], &self->watch);
    return none(&c);
}

static PyObject *guard_believe(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Guard *self = (Guard *)object;
    moc_trocar trocar;
    call c;

    if (!TAKE(&c, self->arm.n, "believe", {"q", READ, N}, {"v", READ, N}, {"stamp", LONG}, {"applied", MAYBE, N},
              {"wrench", READ, 6}, {"trocar", MAYBE, 2, 3}, {"believed", WRITE, 2, N}))
        return NULL;
    const moc_measurement m = {c.array[0], c.array[1], c.whole[2], args[2] != Py_None, c.array[3], c.array[4]};
    if (c.array[5])
        memcpy(&trocar, c.array[5], sizeof trocar);
    moc_stop reason = moc_guard_believe(&self->guard, &self->arm, &m, c.array[5] ? &trocar : NULL, &self->watch);
    memcpy(c.array[6], self->watch.q, (size_t)c.n * sizeof(double));
    memcpy(c.array[6] + c.n, self->watch.v, (size_t)c.n * sizeof(double));
    return whole(&c, reason);
}

static PyObject *guard_follow(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Guard *self = (Guard *)object;
    moc_terms terms;
    call c;

    if (!TAKE(&c, self->arm.n, "follow", {"q", READ, N}, {"v", READ, N}, {"record", MAYBE, TERMS}, {"tip", MAYBE, 3},
              {"tip_ref", MAYBE, 3, 3}, {"before", READ, N}, {"tau", WRITE, N}))
        return NULL;
    const double *tip = c.array[3];
    if (c.array[2]) {
        moc_unpack_terms(c.array[2], c.n, &terms);
        tip = tip ? tip : terms.tip;
    }
    memcpy(self->watch.q, c.array[0], (size_t)c.n * sizeof(double));
    memcpy(self->watch.v, c.array[1], (size_t)c.n * sizeof(double));
    moc_stop reason = moc_guard_follow(&self->guard, &self->arm, c.array[2] ? &terms : NULL, tip, c.array[4],
                                       c.array[5], c.array[6], &self->watch);
    return moc_done(&c, Py_BuildValue("ii", (int)reason, self->watch.limited));
}

static PyObject *guard_rest(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Guard *self = (Guard *)object;
    call c;

    if (!TAKE(&c, self->arm.n, "rest", {"before", READ, N}, {"tau", WRITE, N}))
        return NULL;
    moc_guard_rest(&self->guard, &self->arm, c.array[0], &self->watch, c.array[1]);
    return none(&c);
}

static PyObject *guard_hold(PyObject *object, PyObject *const *args, Py_ssize_t count)
{
    Guard *self = (Guard *)object;
    call c;

    if (!TAKE(&c, self->arm.n, "hold", {"wrench", READ, 6}, {"friction", WRITE, N}))
        return NULL;
    moc_guard_hold(&self->guard, &self->arm, c.array[0], &self->watch, c.array[1]);
    return none(&c);
}

static PyObject *guard_get(PyObject *object, void *which)
{
    return moc_show(which, ((Guard *)object)->arm.n, &((Guard *)object)->watch);
}

static const field watch_fields[] = {
    FIELD(moc_watch, bad, INT), FIELD(moc_watch, mean_square, PAIR), FIELD(moc_watch, largest, PAIR),
    FIELD(moc_watch, first_tick, PAIR),
};

static PyGetSetDef guard_attributes[] = {
    {"bad", guard_get, NULL, "measurements in a row that were not believed", (void *)&watch_fields[0]},
    {"mean_square", guard_get, NULL, "of RCM error [m^2] and trocar force [N^2]", (void *)&watch_fields[1]},
    {"largest", guard_get, NULL, "root of either above its warning [m], [N]", (void *)&watch_fields[2]},
    {"first_tick", guard_get, NULL, "of either's warning; -1: none", (void *)&watch_fields[3]},
    {NULL, NULL, NULL, NULL, NULL},
};

static PyMethodDef guard_methods[] = {
    FAST("start", guard_start, "start(q, v, stamp): forget all, and begin at a finite measurement, number `stamp`"),
    FAST("believe", guard_believe, "believe(q, v, stamp, applied, wrench, trocar, believed) -> reason"),
    FAST("follow", guard_follow, "follow(q, v, record, tip, tip_ref, before, tau) -> (reason, joints limited)"),
    FAST("rest", guard_rest, "rest(before, tau): the torque of a damped stop"),
    FAST("hold", guard_hold, "hold(wrench, friction): dry friction of the brakes in a stop [Nm]"),
    {NULL, NULL, 0, NULL},
};

static PyType_Slot guard_slots[] = {
    {Py_tp_doc, "Guard(arm, **numbers)\n\nThe safety filter with its memory; numbers: the fields of moc_guard."},
    {Py_tp_new, guard_new}, {Py_tp_dealloc, forget_object}, {Py_tp_methods, guard_methods},
    {Py_tp_getset, guard_attributes}, {0, NULL},
};

/* --- the module --- */

static PyType_Spec specs[] = {
    {"moc_opt.core._core.Arm", sizeof(Arm), 0, Py_TPFLAGS_DEFAULT, arm_slots},
    {"moc_opt.core._core.Law", sizeof(Law), 0, Py_TPFLAGS_DEFAULT, law_slots},
    {"moc_opt.core._core.Guard", sizeof(Guard), 0, Py_TPFLAGS_DEFAULT, guard_slots},
};

static int fill(PyObject *module)
{
    static const char *const types[] = {"Arm", "Law", "Guard"};
    static const char *const names[] = {"OK", "INFEASIBLE", "DOUBTFUL", "UNFINISHED", "BAD_Q", "BAD_V"}; /* moc_status */

    for (size_t k = 0; k < COUNT(specs); k++) {
        PyObject *type = PyType_FromSpec(&specs[k]);
        if (type == NULL || PyModule_AddObjectRef(module, types[k], type) < 0)
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
    for (size_t k = 0; k < COUNT(names); k++)
        if (PyModule_AddIntConstant(module, names[k], (long)k) < 0)
            return -1;
    return PyModule_AddIntConstant(module, "MAX_JOINTS", MOC_MAX_JOINTS);
}

static PyModuleDef_Slot module_slots[] = {{Py_mod_exec, fill}, {0, NULL}};

static PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_core", "The tick in C; see moc_opt/core/moc.h.", 0, moc_functions, module_slots, NULL, NULL,
    NULL,
};

PyMODINIT_FUNC PyInit__core(void);

PyMODINIT_FUNC PyInit__core(void)
{
    return PyModuleDef_Init(&definition);
}
