/* One tick: of the law, before and after any solver; and of the whole controller, with `exact` and the safety filter. */
#include <string.h>

#include "vec.h"

void moc_start(const moc_law *law, int n, const moc_terms *t, moc_memory *memory)
{
    (void)law;
    memset(memory, 0, sizeof *memory);
    memory->rows = moc_null_space(n, ((moc_terms *)t)->A, 0, memory->Z);
    for (int i = 0; i < n; i++) {
        memory->integral[i] = dot(n, t->M[i], t->v); /* the momentum: no external torque so far */
        memory->tau[i] = t->h[i];
    }
}

void moc_begin(const moc_arm *arm, const moc_law *law, const moc_terms *t, const moc_reference *ref,
               const moc_trocar *trocar, const double *pull, moc_memory *memory, moc_problem *problem, double *tau)
{
    double climb[MOC_MAX_JOINTS];
    int n = arm->n;

    if (law->observer_gain > 0.0) /* friction and model error, from the last torque */
        moc_observe(n, t, memory->tau, law->observer_gain, law->period, memory->integral, memory->external);
    moc_tracking_torque(law, n, t, ref, trocar, tau);
    for (int i = 0; i < n; i++)
        tau[i] -= memory->external[i];
    if (!law->third_level && !law->damped)
        return;
    if (!moc_follow_null_space(n, ((moc_terms *)t)->A, t->u, memory->rows, memory->Z))
        memory->rows = moc_null_space(n, ((moc_terms *)t)->A, memory->rows, memory->Z);
    if (!law->third_level)
        return;
    if (pull == NULL && law->climbs) {
        moc_climb(arm, law, t, climb);
        pull = climb;
    }
    moc_fill_problem(law, n, t, ref, trocar, pull, problem);
}

void moc_finish(const moc_law *law, int n, const moc_terms *t, const double *x, moc_memory *memory, double *tau)
{
    static const double rest[MOC_MAX_JOINTS];

    memory->share = law->third_level ? fmin(1.0, memory->share + law->fade) : 1.0;
    moc_add_third_level(law, n, t, memory, x ? x : rest, tau);
    memcpy(memory->tau, tau, (unsigned)n * sizeof *tau);
}

/* --- the whole controller --- */

static int within(int n, const double *tau, const double *most)
{
    for (int i = 0; i < n; i++)
        if (!(fabs(tau[i]) <= most[i]))
            return 0;
    return 1;
}

moc_stop moc_begin_run(const moc_controller *c, const moc_measurement *m, moc_state *state)
{
    int n = c->arm->n;

    memset(state, 0, sizeof *state);
    state->reason = MOC_STOP_NOT_STARTED;
    if (!within(n, m->applied, c->guard->tau_max) || moc_compute_terms(c->arm, m->q, m->v, &state->terms) != MOC_OK)
        return state->reason;
    moc_start(c->law, n, &state->terms, &state->memory);
    moc_guard_start(c->guard, n, m->q, m->v, m->stamp, &state->watch);
    memcpy(state->sent, m->applied, (unsigned)n * sizeof *state->sent);
    state->begun = MOC_BEGUN;
    return state->reason = MOC_RUNNING;
}

/* The law's torque at the pose that is believed. */
static moc_stop compute(const moc_controller *c, const moc_reference *ref, const moc_trocar *trocar, moc_state *s,
                        double *tau)
{
    const moc_claim claims[] = {MOC_CLAIMS_OPTIMUM, MOC_CLAIMS_INFEASIBLE, MOC_GIVES_NONE};
    moc_terms *t = &s->terms;

    if (moc_compute_terms(c->arm, s->watch.q, s->watch.v, t) != MOC_OK)
        return MOC_STOP_STATE;
    moc_begin(c->arm, c->law, t, ref, trocar, NULL, &s->memory, &s->problem, tau);
    if (c->law->third_level) {
        s->status = moc_solve_exact(&s->problem, c->tolerance, s->answer, s->y);
        s->fault = moc_supervise(c->supervision, &s->problem, MOC_TAKEN, claims[s->status], s->answer, 0.0, &s->memory,
                                 s->x);
    }
    moc_finish(c->law, c->arm->n, t, c->law->third_level ? s->x : NULL, &s->memory, tau);
    moc_stop found = moc_guard_follow(c->guard, c->arm, t, t->tip, ref->X, s->sent, tau, &s->watch);
    if (s->watch.limited) /* the observer takes what went out */
        memcpy(s->memory.tau, tau, (unsigned)c->arm->n * sizeof *tau);
    return found;
}

moc_stop moc_step(const moc_controller *c, const moc_measurement *m, const moc_reference *ref,
                  const moc_trocar *trocar, moc_state *s, double *tau)
{
    int n = c->arm->n;
    moc_measurement seen = *m;

    if (s->begun != MOC_BEGUN) {
        memset(tau, 0, (unsigned)n * sizeof *tau);
        return MOC_STOP_NOT_STARTED;
    }
    if (m->applied && memcmp(m->applied, s->sent, (unsigned)n * sizeof *tau) != 0) {
        memcpy(s->sent, m->applied, (unsigned)n * sizeof *tau);
        memcpy(s->memory.tau, m->applied, (unsigned)n * sizeof *tau);
    }
    if (s->memory.rows < 0 || s->memory.rows > n || !within(n, s->sent, c->guard->tau_max)) {
        s->reason = s->reason == MOC_RUNNING ? MOC_STOP_STATE : s->reason;
        for (int i = 0; i < n; i++)
            s->sent[i] = isnan(s->sent[i]) ? 0.0 : clip(s->sent[i], -c->guard->tau_max[i], c->guard->tau_max[i]);
    }
    seen.applied = s->sent;
    if (s->reason == MOC_RUNNING)
        s->reason = moc_guard_believe(c->guard, c->arm, &seen, trocar, &s->watch);
    if (s->reason == MOC_RUNNING)
        s->reason = compute(c, ref, trocar, s, tau);
    if (s->reason != MOC_RUNNING) {
        moc_guard_rest(c->guard, c->arm, s->sent, &s->watch, tau);
        s->watch.limited = 0;
    }
    memcpy(s->sent, tau, (unsigned)n * sizeof *tau);
    return s->reason;
}
