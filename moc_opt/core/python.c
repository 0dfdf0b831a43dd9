/* The Python module, for CPython's limited API from 3.11 on, and its types Law and Guard. */
#define MOC_MODULE
#include "python.h"
#include "vec.h"

#include <time.h>

static PyTypeObject *arm_type;

/* Create an object from its arm and the keywords. Returns NULL after an exception. */
static PyObject *with_arm(PyTypeObject *type, PyObject *given, PyObject *keywords, const field *fields, int count)
{
    PyObject *arm;
    if (!PyArg_ParseTuple(given, "O!:arm", arm_type, &arm))
        return NULL;
    Arm *self = (Arm *)PyType_GenericAlloc(type, 0);
    if (self == NULL)
        return NULL;
    self->arm = ((Arm *)arm)->arm;
    if (moc_fill(keywords, fields, count, self))
        return (PyObject *)self;
    Py_DECREF(self);
    return NULL;
}

/* --- the law --- */

typedef struct {
    PyObject_HEAD
    moc_arm arm;
    moc_law law;
    moc_supervision supervision;
    moc_controller controller; /* points to the fields above */
    moc_state state;
} Law;

#define LAW(name, ...) {{#name, __VA_ARGS__}, offsetof(Law, law.name)}
#define CHECK(name, ...) {{#name, __VA_ARGS__}, offsetof(Law, supervision.name)}

static const field law_fields[] = {
    LAW(K_X, NUMBER), LAW(D_X, NUMBER), LAW(K_N, NUMBER), LAW(D_N, NUMBER), LAW(rcm_lambda, NUMBER),
    LAW(projector, WHOLE), LAW(feedforward, WHOLE), LAW(K_N2, READ, N), LAW(D_N2, READ, N), LAW(tau_max, READ, N),
    LAW(k0, NUMBER), LAW(c0, NUMBER), LAW(c1, NUMBER), LAW(c2, NUMBER), LAW(rho, NUMBER), LAW(q_min, READ, N),
    LAW(q_max, READ, N), LAW(v_max, READ, N), LAW(shaft_margin, NUMBER), LAW(spare_speed, NUMBER),
    LAW(observer_gain, NUMBER), LAW(period, NUMBER), LAW(fade, NUMBER), LAW(third_level, WHOLE), LAW(damped, WHOLE),
    LAW(climbs, WHOLE),
    CHECK(check, WHOLE), CHECK(box_limit, NUMBER), CHECK(primal_limit, NUMBER), CHECK(relative_limit, NUMBER),
    CHECK(opposite_limit, NUMBER), CHECK(hold_ticks, WHOLE), CHECK(keep_off_limits, WHOLE), CHECK(fallback, WHOLE),
    CHECK(late, WHOLE), CHECK(budget_us, NUMBER),
};

static PyObject *law_new(PyTypeObject *type, PyObject *given, PyObject *keywords)
{
    Law *self = (Law *)with_arm(type, given, keywords, law_fields, COUNT(law_fields));
    if (self != NULL)
        self->controller = (moc_controller){&self->arm, &self->law, &self->supervision, NULL, 0.0};
    return (PyObject *)self;
}

/* Arguments 0 to 3 of start, begin and step. The rows of tip_ref are X_d, dX_d and ddX_d. */
#define TICK {"q", READ, N}, {"v", READ, N}, {"tip_ref", READ, 3, 3}, {"trocar", READ, 2, 3}

/* Begin a tick if `begins`, else start the law. Array i receives the terms. Returns false after an exception. */
static bool take_tick(Law *self, const call *c, bool begins, const double *x_d, int i)
{
    static const double none[MOC_MAX_JOINTS];
    moc_input in = {.measured = {c->array[0], c->array[1], 0, 0, begins ? NULL : none, NULL}, .x_d = x_d};

    if (!all_finite(c->n, c->array[0]) || !all_finite(c->n, c->array[1]) || !all_finite(9, c->array[2]) ||
        !all_finite(6, c->array[3])) {
        PyErr_SetString(PyExc_ValueError, "q, v, tip_ref, trocar: give finite numbers");
        return false;
    }
    memcpy(&in.ref, c->array[2], sizeof in.ref);
    memcpy(&in.trocar, c->array[3], sizeof in.trocar);
    if (begins)
        moc_begin(&self->controller, &in, &self->state);
    else if (moc_start(&self->controller, &in.measured, &self->state) == MOC_RUNNING)
        moc_fill_problem(&self->law, c->n, &self->state.terms, &in.ref, &in.trocar, NULL, &self->state.problem);
    moc_copy_terms(&self->state.terms, c->n, c->array[i], PACK);
    return true;
}

METHOD(Law, start, TICK, {"record", MADE, TERMS}, {"row", MADE, ROW})
{
    if (!take_tick(self, c, false, NULL, 4))
        return NULL;
    moc_copy_problem(&self->state.problem, c->n, c->array[5], PACK);
    return Py_BuildValue("OO", c->as[4], c->as[5]);
}

METHOD(Law, load, {"record", READ, ROW}, {"Z", READ, K, N})
{
    if (rows_of(c, 1) > c->n)
        return PyErr_Format(PyExc_ValueError, "Z has %d rows: a basis of ker A has %d at most", rows_of(c, 1), c->n);
    moc_copy_problem(&self->state.problem, c->n, c->array[0], UNPACK);
    self->state.memory.rows = rows_of(c, 1);
    for (int k = 0; k < self->state.memory.rows; k++)
        memcpy(self->state.memory.Z[k], c->array[1] + k * c->n, (size_t)c->n * sizeof(double));
    self->state.begun = MOC_BEGUN;
    Py_RETURN_NONE;
}

METHOD(Law, judge, {"x", READ, N})
{
    moc_state *s = &self->state;
    moc_residuals r = moc_judge(&s->problem, s->memory.rows, s->memory.Z, c->array[0]);
    return Py_BuildValue("ddddd", r.primal, r.outside, r.natural, r.off, r.opposite);
}

METHOD(Law, begin, TICK, {"x_d", MAYBE, N}, {"record", MADE, TERMS}, {"row", MADE, ROW})
{
    if (!take_tick(self, c, true, c->array[4], 5))
        return NULL;
    moc_copy_problem(&self->state.problem, c->n, c->array[6], PACK);
    return Py_BuildValue("OO", c->as[5], c->as[6]);
}

METHOD(Law, finish, {"known", WHOLE}, {"claim", WHOLE}, {"answer", READ, N}, {"solve_us", NUMBER},
       {"x", MADE, N}, {"tau", MADE, N})
{
    const moc_answer answer = {c->array[2], (moc_claim)whole(c, 1), (moc_fault)whole(c, 0), c->number[3]};
    moc_finish(&self->controller, &answer, &self->state, c->array[5]);
    memcpy(c->array[4], self->state.x, (size_t)c->n * sizeof(double));
    return Py_BuildValue("iOO", (int)self->state.fault, c->as[4], c->as[5]);
}

static double now_us(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return 1e6 * (double)now.tv_sec + 1e-3 * (double)now.tv_nsec;
}

METHOD(Law, step, TICK, {"x_d", MAYBE, N}, {"tolerance", NUMBER}, {"solve_us", NUMBER}, {"record", MADE, TERMS},
       {"out", MADE, TICKED})
{
    moc_state *s = &self->state;
    size_t bytes = (size_t)c->n * sizeof(double);
    double *row = c->array[8], *found = row + 11 * c->n + 10;

    if (!take_tick(self, c, true, c->array[4], 7))
        return NULL;
    self->controller.tolerance = c->number[5];
    double from = now_us();
    moc_eliminate(s->problem.n, s->problem.A, &s->plane); /* again, so that answer.us includes it */
    moc_answer answer = moc_ask_exact(&self->controller, s);
    answer.us = isnan(c->number[6]) ? now_us() - from : c->number[6];
    moc_finish(&self->controller, &answer, s, found + 2 * c->n + 6);
    moc_copy_problem(&self->state.problem, c->n, row, PACK);
    memcpy(found, s->answer, bytes);
    memcpy(found + c->n, s->y, sizeof s->y);
    memcpy(found + c->n + 6, s->x, bytes);
    PyArray_CLEARFLAGS(c->as[8], NPY_ARRAY_WRITEABLE);
    return Py_BuildValue("iidOO", (int)s->status, (int)s->fault, answer.us, c->as[7], c->as[8]);
}

METHOD(Law, set_applied, {"tau", READ, N})
{
    memcpy(self->state.memory.tau, c->array[0], (size_t)c->n * sizeof(double));
    Py_RETURN_NONE;
}

METHOD(Law, memory, {"Z", MADE, N, N}, {"external", MADE, N})
{
    const moc_memory *memory = &self->state.memory;
    for (int k = 0; k < memory->rows; k++)
        memcpy(c->array[0] + k * c->n, memory->Z[k], (size_t)c->n * sizeof(double));
    memcpy(c->array[1], memory->external, (size_t)c->n * sizeof(double));
    return Py_BuildValue("iOO", memory->rows, c->as[0], c->as[1]);
}

TYPE(Law, law_new, ENTRY(Law, start), ENTRY(Law, load), ENTRY(Law, judge), ENTRY(Law, begin), ENTRY(Law, finish),
     ENTRY(Law, step), ENTRY(Law, set_applied), ENTRY(Law, memory));

/* --- the safety filter --- */

typedef struct {
    PyObject_HEAD
    moc_arm arm;
    moc_guard guard;
    moc_watch watch;
} Guard;

#define LEVEL(name, ...) {{#name, __VA_ARGS__}, offsetof(Guard, guard.name)}

static const field guard_fields[] = {
    LEVEL(period, NUMBER), LEVEL(patience, WHOLE), LEVEL(carries, WHOLE), LEVEL(low, READ, N), LEVEL(high, READ, N),
    LEVEL(v_max, READ, N), LEVEL(tau_max, READ, N), LEVEL(wall_stiffness, NUMBER), LEVEL(wall_damping, NUMBER),
    LEVEL(wall_brake, NUMBER), LEVEL(torque_step, NUMBER), LEVEL(jump, NUMBER), LEVEL(speed_factor, NUMBER),
    LEVEL(tip_error, NUMBER), LEVEL(tip_share, NUMBER), LEVEL(in_incision, WHOLE), LEVEL(warning, READ, 2),
    LEVEL(limit, READ, 2), LEVEL(incision_share, NUMBER), LEVEL(tool_mass, NUMBER), LEVEL(tool_length, NUMBER),
    LEVEL(tip_force, NUMBER), LEVEL(stop_holding, NUMBER), LEVEL(stop_yield, NUMBER), LEVEL(stop_yield_ticks, WHOLE),
    LEVEL(press_share, NUMBER), LEVEL(motion, WHOLE), LEVEL(motion_s, NUMBER), LEVEL(motion_rad, NUMBER),
    LEVEL(motion_lag_s, NUMBER), LEVEL(repeat_m, NUMBER), LEVEL(repeat_torque, NUMBER), LEVEL(repeat_whole_m, NUMBER),
    LEVEL(repeat_whole_torque, NUMBER), LEVEL(repeat_whole_ticks, NUMBER), LEVEL(repeat_joint_ticks, NUMBER),
    LEVEL(repeat_reading_ticks, NUMBER), LEVEL(replayed_ticks, NUMBER), LEVEL(stuck_speed, NUMBER),
    LEVEL(held, READ, N), LEVEL(residual_torque, NUMBER), LEVEL(residual_whole, NUMBER), LEVEL(residual_rate, NUMBER),
    LEVEL(residual_share, NUMBER), LEVEL(settling_ticks, WHOLE),
};

static PyObject *guard_new(PyTypeObject *type, PyObject *given, PyObject *keywords)
{
    return with_arm(type, given, keywords, guard_fields, COUNT(guard_fields));
}

/* Convert a stamp. A number beyond +-4e18 becomes +-4e18, and the filter refuses that stamp. */
static long long stamp_of(double number)
{
    return (long long)fmin(fmax(number, -4e18), 4e18);
}

METHOD(Guard, start, {"q", READ, N}, {"v", READ, N}, {"stamp", NUMBER})
{
    moc_guard_start(&self->guard, c->n, c->array[0], c->array[1], stamp_of(c->number[2]), &self->watch);
    Py_RETURN_NONE;
}

METHOD(Guard, believe, {"q", READ, N}, {"v", READ, N}, {"stamp", NUMBER}, {"applied", MAYBE, N},
       {"wrench", READ, 6}, {"trocar", MAYBE, 2, 3}, {"q", MADE, N}, {"v", MADE, N})
{
    const moc_measurement m = {c->array[0], c->array[1], stamp_of(c->number[2]), !isnan(c->number[2]),
                               c->array[3], c->array[4]};
    moc_stop reason = moc_guard_believe(&self->guard, c->n, &m, &self->watch), found = MOC_RUNNING;
    if (c->array[5] && self->guard.in_incision) {
        const moc_trocar *trocar = (const moc_trocar *)c->array[5];
        double pose[4][3];
        moc_tool_pose(&self->arm, self->watch.q, pose);
        found = moc_guard_incision(&self->guard, pose, trocar, m.wrench, &self->watch);
    }
    memcpy(c->array[6], self->watch.q, (size_t)c->n * sizeof(double));
    memcpy(c->array[7], self->watch.v, (size_t)c->n * sizeof(double));
    return Py_BuildValue("iOO", (int)(reason == MOC_RUNNING ? found : reason), c->as[6], c->as[7]);
}

METHOD(Guard, follow, {"q", READ, N}, {"v", READ, N}, {"record", MAYBE, TERMS}, {"tip", MAYBE, 3},
       {"tip_ref", MAYBE, 3, 3}, {"before", READ, N}, {"tau", WRITE, N})
{
    const double *tip = c->array[3];
    moc_terms terms;
    if (c->array[2]) {
        moc_copy_terms(&terms, c->n, c->array[2], UNPACK);
        tip = tip ? tip : terms.tip;
    }
    memcpy(self->watch.q, c->array[0], (size_t)c->n * sizeof(double));
    memcpy(self->watch.v, c->array[1], (size_t)c->n * sizeof(double));
    moc_stop reason = moc_guard_follow(&self->guard, &self->arm, c->array[2] ? &terms : NULL, tip, c->array[4],
                                       c->array[5], c->array[6], &self->watch);
    return Py_BuildValue("ii", (int)reason, self->watch.limited);
}

METHOD(Guard, rest, {"before", READ, N}, {"tau", MADE, N})
{
    moc_guard_rest(&self->guard, &self->arm, c->array[0], &self->watch, c->array[1]);
    return Py_BuildValue("O", c->as[1]);
}

METHOD(Guard, hold, {"wrench", READ, 6}, {"friction", MADE, N})
{
    moc_guard_hold(&self->guard, &self->arm, c->array[0], &self->watch, c->array[1]);
    return Py_BuildValue("O", c->as[1]);
}

METHOD(Guard, watched, {"figures", MADE, 3, 2})
{
    const moc_watch *w = &self->watch;
    memcpy(c->array[0], w->mean_square, sizeof w->mean_square);
    memcpy(c->array[0] + 2, w->largest, sizeof w->largest);
    memcpy(c->array[0] + 4, w->first_tick, sizeof w->first_tick);
    return Py_BuildValue("iO", w->bad, c->as[0]);
}

TYPE(Guard, guard_new, ENTRY(Guard, start), ENTRY(Guard, believe), ENTRY(Guard, follow), ENTRY(Guard, rest),
     ENTRY(Guard, hold), ENTRY(Guard, watched));

/* --- the module --- */

static int fill(PyObject *module)
{
    /* in the order of moc_status */
    static const char *const names[] = {"OK", "INFEASIBLE", "DOUBTFUL", "UNFINISHED"};
    PyType_Spec *specs[] = {&moc_Law, &moc_Guard, &moc_Arm};

    bool done = PyArray_ImportNumPyAPI() == 0;
    for (int k = 0; done && k < COUNT(specs); k++) {
        arm_type = (PyTypeObject *)PyType_FromSpec(specs[k]); /* moc_Arm is last, so that arm_type becomes its type */
        done = arm_type != NULL && PyModule_AddType(module, arm_type) == 0;
    }
    PyObject *reasons = done ? PyTuple_New(MOC_STOPS) : NULL;
    for (int k = 0; reasons != NULL && k < MOC_STOPS; k++)
        PyTuple_SetItem(reasons, k, PyUnicode_FromString(moc_reason((moc_stop)k)));
    done = reasons != NULL && PyModule_AddObjectRef(module, "REASONS", reasons) == 0 &&
           PyModule_AddFunctions(module, moc_subproblem_functions) == 0 &&
           PyModule_AddFunctions(module, moc_plant_functions) == 0 &&
           PyModule_AddIntConstant(module, "MAX_JOINTS", MOC_MAX_JOINTS) == 0;
    Py_XDECREF(reasons);
    for (int k = 0; done && k < COUNT(names); k++)
        done = PyModule_AddIntConstant(module, names[k], k) == 0;
    return done ? 0 : -1;
}

static PyModuleDef_Slot module_slots[] = {{Py_mod_exec, fill}, {0, NULL}};

static PyModuleDef definition = {
    PyModuleDef_HEAD_INIT, "_core", "The tick in C; see moc_opt/core/moc.h.", 0, NULL, module_slots, NULL, NULL, NULL,
};

PyMODINIT_FUNC PyInit__core(void);

PyMODINIT_FUNC PyInit__core(void)
{
    return PyModuleDef_Init(&definition);
}
