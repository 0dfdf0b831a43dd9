/* One tick: moc_begin, any solver, moc_finish. FilteredController of moc_opt/sim/loop.py has to call the functions of
 * safety_filter.c in the order of this file. */
#include "vec.h"

/* --- the law --- */

static void start_law(const moc_controller *c, moc_state *s)
{
    moc_memory *memory = &s->memory;
    int n = c->arm->n;

    memset(memory, 0, sizeof *memory);
    for (int i = 0; i < n; i++) {
        memory->integral[i] = dot(n, s->terms.M[i], s->terms.v); /* so that `external` starts at zero */
        memory->tau[i] = s->terms.h[i];
    }
    s->reason = MOC_RUNNING;
    s->begun = MOC_BEGUN;
}

static void levels(const moc_controller *c, const moc_input *in, moc_state *s)
{
    const moc_law *law = c->law;
    moc_memory *memory = &s->memory;
    moc_terms *t = &s->terms;
    const double *x_d = in->x_d;
    double climb[MOC_MAX_JOINTS];
    int n = c->arm->n;

    for (int i = 0; i < n && law->observer_gain > 0.0; i++)
        moc_observe(n, t, i, memory->tau[i], law->observer_gain, law->period, &memory->integral[i],
                    &memory->external[i]);
    moc_tracking_torque(law, n, t, &in->ref, &in->trocar, s->tau);
    for (int i = 0; i < n; i++)
        s->tau[i] -= memory->external[i];
    if (!law->third_level && !law->damped)
        return;
    moc_eliminate(n, t->A, &s->plane);
    memory->rows = moc_null_space(&s->plane, n, memory->rows, memory->Z);
    if (!law->third_level)
        return;
    if (x_d == NULL && law->climbs) {
        moc_climb(c->arm, law, t, memory, climb);
        x_d = climb;
    }
    moc_fill_problem(law, n, t, &in->ref, &in->trocar, x_d, &s->problem);
}

/* --- the whole controller --- */

static bool within(int n, const double *tau, const double *most)
{
    for (int i = 0; i < n; i++)
        if (!(fabs(tau[i]) <= most[i]))
            return false;
    return true;
}

moc_stop moc_start(const moc_controller *c, const moc_measurement *m, moc_state *s)
{
    int n = c->arm->n;

    memset(s, 0, sizeof *s);
    s->reason = MOC_STOP_NOT_STARTED;
    if ((c->guard && !within(n, m->applied, c->guard->tau_max)) ||
        moc_compute_terms(c->arm, m->q, m->v, &s->terms) != MOC_OK)
        return s->reason;
    start_law(c, s);
    if (c->guard)
        moc_guard_start(c->guard, n, m->q, m->v, m->stamp, &s->watch);
    memcpy(s->sent, m->applied, (unsigned)n * sizeof *s->sent);
    return s->reason;
}

/* Store the torque that acted. With a guard, stop if it exceeds a limit, or if memory.rows (of Z) is not 0 to n. */
static void take_applied(const moc_controller *c, const double *applied, moc_state *s)
{
    int n = c->arm->n;

    if (applied && memcmp(applied, s->sent, (unsigned)n * sizeof *s->sent) != 0) {
        memcpy(s->sent, applied, (unsigned)n * sizeof *s->sent);
        memcpy(s->memory.tau, applied, (unsigned)n * sizeof *s->sent);
    }
    if (!c->guard || (s->memory.rows >= 0 && s->memory.rows <= n && within(n, s->sent, c->guard->tau_max)))
        return;
    s->reason = first_of(s->reason, MOC_STOP_STATE);
    for (int i = 0; i < n; i++)
        s->sent[i] = isnan(s->sent[i]) ? 0.0 : clip(s->sent[i], -c->guard->tau_max[i], c->guard->tau_max[i]);
}

static moc_stop believe(const moc_controller *c, const moc_input *in, moc_state *s)
{
    moc_measurement seen = in->measured;
    moc_stop reason = MOC_RUNNING;

    seen.applied = s->sent;
    if (c->guard) {
        reason = moc_guard_believe(c->guard, c->arm->n, &seen, &s->watch);
        seen.q = s->watch.q;
        seen.v = s->watch.v;
    }
    if (moc_compute_terms(c->arm, seen.q, seen.v, &s->terms) != MOC_OK)
        return first_of(reason, MOC_STOP_STATE);
    if (!c->guard)
        return MOC_RUNNING;
    return first_of(reason, moc_guard_incision(c->guard, s->terms.pose, &in->trocar, seen.wrench, &s->watch));
}

moc_stop moc_begin(const moc_controller *c, const moc_input *in, moc_state *s)
{
    if (s->begun != MOC_BEGUN)
        return MOC_STOP_NOT_STARTED;
    memcpy(s->tip_ref, in->ref.X, sizeof s->tip_ref);
    take_applied(c, in->measured.applied, s);
    if (s->reason == MOC_RUNNING)
        s->reason = believe(c, in, s);
    if (s->reason == MOC_RUNNING)
        levels(c, in, s);
    return s->reason;
}

static moc_stop complete(const moc_controller *c, const moc_answer *answer, moc_state *s)
{
    static const double zero[MOC_MAX_JOINTS];
    const moc_law *law = c->law;
    moc_memory *memory = &s->memory;
    unsigned bytes = (unsigned)c->arm->n * sizeof *s->tau;

    if (law->third_level)
        s->fault = moc_supervise(c->supervision, &s->problem, answer, memory, s->x);
    memory->share = law->third_level ? smaller(memory->share + law->fade, 1.0) : 1.0;
    moc_add_third_level(law, c->arm->n, &s->terms, memory, law->third_level ? s->x : zero, s->tau);
    memcpy(memory->tau, s->tau, bytes);
    if (!c->guard)
        return MOC_RUNNING;
    const moc_terms *t = &s->terms;
    moc_stop reason = moc_guard_follow(c->guard, c->arm, t, t->tip, s->tip_ref, s->sent, s->tau, &s->watch);
    if (s->watch.limited) /* the observer needs the torque that acts, not the one before the limits */
        memcpy(memory->tau, s->tau, bytes);
    return reason;
}

moc_stop moc_finish(const moc_controller *c, const moc_answer *answer, moc_state *s, double *tau)
{
    unsigned bytes = (unsigned)c->arm->n * sizeof *tau;

    if (s->begun != MOC_BEGUN) {
        memset(tau, 0, bytes);
        return MOC_STOP_NOT_STARTED;
    }
    if (s->reason == MOC_RUNNING)
        s->reason = complete(c, answer, s);
    if (s->reason != MOC_RUNNING && c->guard) {
        moc_guard_rest(c->guard, c->arm, s->sent, &s->watch, s->tau);
        s->watch.limited = 0;
    }
    memcpy(tau, s->tau, bytes);
    memcpy(s->sent, s->tau, bytes);
    return s->reason;
}

moc_answer moc_ask_exact(const moc_controller *c, moc_state *s)
{
    static const moc_claim claims[] = {MOC_CLAIMS_OPTIMUM, MOC_CLAIMS_INFEASIBLE, MOC_GIVES_NONE}; /* by moc_status */
    if (!c->law->third_level)
        return (moc_answer){s->answer, MOC_GIVES_NONE, MOC_TAKEN, 0.0};
    s->status = moc_solve_eliminated(&s->plane, &s->problem, c->tolerance, s->answer, s->y);
    return (moc_answer){s->answer, claims[s->status], MOC_TAKEN, 0.0};
}

moc_stop moc_step(const moc_controller *c, const moc_input *in, moc_state *s, double *tau)
{
    moc_answer answer = {s->answer, MOC_GIVES_NONE, MOC_TAKEN, 0.0};

    if (moc_begin(c, in, s) == MOC_RUNNING)
        answer = moc_ask_exact(c, s);
    return moc_finish(c, &answer, s, tau);
}
