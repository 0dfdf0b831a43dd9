#include "moc_safe.h"

#include <math.h>
#include <string.h>

#include "moc_dense.h"
#if MOC_ROWS
#include "moc_null_space.h"
#endif
#if MOC_SOLVES
#include "moc_singular.h"
#endif

static void request_stop(moc_safe_state *state, int reason)
{
    if (state->reason == MOC_RUNNING)
        state->reason = reason;
}

/* A state in which nothing is known. */
static void clear(moc_safe_state *state, int reason)
{
    moc_safe_state empty = {.reason = reason, .seal = MOC_SEAL};
#if MOC_SOLVES
    moc_supervisor_start(&empty.supervisor);
#endif
    moc_incision_start(&empty.incision);
    *state = empty;
}

/* Whether this can be the number of a control period. */
static int plausible(int64_t number)
{
    return number > -INT64_MAX / 2 && number < INT64_MAX / 2;
}

/* Whether the state can be what a step has left. */
static int intact(const moc_safe_state *s)
{
    int fine = s->seal == MOC_SEAL && s->reason >= MOC_RUNNING && s->reason < MOC_REASONS;
    fine &= s->guard.bad >= 0 && s->incision.unread >= 0 && s->incision.ticks >= -1;
    fine &= moc_all_finite(MOC_N, s->guard.q) && moc_all_finite(MOC_N, s->guard.v);
    fine &= s->guard.open >= 0 && s->guard.open <= MOC_STOP_YIELD_TICKS + 1 && moc_all_finite(1, &s->guard.borne);
    fine &= moc_all_finite(1, &s->guard.press) && (s->guard.yields == 0 || s->guard.yields == 1);
    for (int i = 0; i < MOC_N; i++)
        fine &= s->sent[i] >= -moc_tau_max[i] && s->sent[i] <= moc_tau_max[i];
#if MOC_SOLVES
    fine &= s->supervisor.age >= 0 && moc_all_finite(MOC_N, s->supervisor.good);
    for (int k = 0; k < MOC_FAULTS; k++)
        fine &= s->supervisor.counts[k] >= 0;
#endif
    if (s->reason != MOC_RUNNING) /* the law is not asked any more */
        return fine;
    fine &= moc_all_finite(MOC_N, s->law.momentum) && moc_all_finite(MOC_N, s->law.external_torque);
    fine &= s->guard.motion.weighed >= 0 && s->guard.motion.looked >= 0;
    fine &= plausible(s->guard.motion.now) && plausible(s->guard.motion.newest);
    fine &= plausible(s->guard.motion.delay) && plausible(s->guard.motion.ticks);
    return fine && moc_all_finite(MOC_N, s->law.torque) && moc_all_finite(1, &s->law.share);
}

int moc_safe_start(const double q[MOC_N], const double v[MOC_N], int64_t stamp, const double sent[MOC_N],
                   moc_safe_state *state)
{
    int fine = plausible(stamp) && moc_all_finite(MOC_N, q) && moc_all_finite(MOC_N, v) && moc_all_finite(MOC_N, sent);
    for (int i = 0; i < MOC_N; i++)
        fine &= sent[i] >= -moc_tau_max[i] && sent[i] <= moc_tau_max[i];
    clear(state, fine ? MOC_RUNNING : MOC_STOP_NOT_STARTED);
    if (!fine)
        return state->reason;
    moc_tick_start(q, v, &state->law);
    moc_guard_start(q, v, stamp, &state->guard);
    for (int i = 0; i < MOC_N; i++)
        state->sent[i] = sent[i];
    if (!intact(state)) /* the numbers overflow */
        clear(state, MOC_STOP_NOT_STARTED);
    return state->reason;
}

static double time_us(void)
{
#if MOC_HAS_BUDGET
    return moc_clock_us();
#else
    return 0.0;
#endif
}

/* The null space Z at this tick; returns its rows. Where the elbow is straight it has one more, and the answer of
 * the subproblem, with `status`, is found anew. */
static int null_space(int *status, moc_tick_report *seen, double Z[MOC_N * MOC_N])
{
#if MOC_ROWS
    if (*status == MOC_TICK_SINGULAR) {
        moc_plane plane = moc_eliminate(MOC_A_OF(seen), MOC_B_OF(seen));
#if MOC_SOLVES
        *status = moc_singular_answer(&plane, seen->subproblem, seen->x);
#endif
        return moc_kernel(&plane, Z);
    }
    memcpy(Z, seen->null_space, sizeof seen->null_space);
#else
    (void)status;
    (void)seen;
    (void)Z;
#endif
    return MOC_ROWS;
}

/* The torque that the levels ask for (n,) [Nm]; what the tick knew is in `seen`. */
static void ask(const double *q, const double *v, const double *tip_ref, const double *trocar, moc_safe_state *state,
                moc_tick_report *seen, double *tau)
{
    double x[MOC_N] = {0.0}, Z[MOC_N * MOC_N];
    double begin = time_us();
    int status = moc_tick_levels(q, v, tip_ref, trocar, &state->law, seen);
    int rows = null_space(&status, seen, Z);
    double took = time_us() - begin;

#if MOC_SOLVES
    moc_supervise(status, seen->subproblem, Z, rows, seen->x, took, &state->supervisor, x);
#else
    (void)took;
#endif
    moc_tick_follow(v, x, Z, rows, seen, &state->law, tau);
    if (!moc_all_finite(6, tip_ref)) /* the generated equations leave out what is zero, and zero times infinity too */
        tau[0] = (double)NAN;
}

int moc_safe_step(const double q[MOC_N], const double v[MOC_N], int64_t stamp, const double tip_ref[9],
                  const double trocar[6], const double wrench[6], moc_safe_state *state, double tau[MOC_N],
                  moc_tick_report *report)
{
    moc_tick_report own, *seen = report ? report : &own;
    moc_guard_state *guard = &state->guard;

    if (!intact(state))
        clear(state, MOC_STOP_STATE);
    state->limited = 0;
    if (state->reason == MOC_RUNNING) {
        request_stop(state, moc_guard_believe(q, v, stamp, state->sent, wrench, guard));
        request_stop(state, moc_incision_look(guard->q, trocar, wrench, &state->incision));
    }
    if (state->reason == MOC_RUNNING) {
        ask(guard->q, guard->v, tip_ref, trocar, state, seen, tau);
        request_stop(state, moc_guard_follow(seen->tip, tip_ref, guard));
        request_stop(state, moc_motion_weigh(seen, guard->v, state->sent, &guard->motion));
        state->limited = moc_guard_limit(state->sent, guard, tau);
        if (state->limited < 0)
            request_stop(state, MOC_STOP_TORQUE);
        if (state->limited > 0)
            for (int i = 0; i < MOC_N; i++)
                state->law.torque[i] = tau[i]; /* what really went out: the observer uses it */
    }
    if (state->reason != MOC_RUNNING) {
        moc_guard_rest(state->sent, guard, tau);
        state->limited = 0;
    }
    for (int i = 0; i < MOC_N; i++)
        state->sent[i] = tau[i] = moc_clip(tau[i], -moc_tau_max[i], moc_tau_max[i]);
    return state->reason;
}

void moc_safe_hold(const double wrench[6], moc_safe_state *state, double friction[MOC_N])
{
    if (!intact(state))
        clear(state, MOC_STOP_STATE);
    moc_guard_hold(moc_incision_force(state->guard.q, wrench, &state->incision), &state->guard, friction);
}

const char *moc_safe_reason(int reason)
{
    static const char *const words[] = {
        "running",
        "not started",
        "the controller's state is damaged",
        "measurements not believed",
        "the wrench sensor's readings are no numbers",
        "the RCM error has been above its limit",
        "the trocar's force has been above its limit",
        "the tip has been off its reference",
        "the controller's torque is not finite",
        "measurements are too late",
        "all encoders repeat one reading, as no arm that moves or has noise does",
        "the encoders' positions do not follow their velocities",
        "an encoder repeats one reading while torque acts on its joint",
        "the measured motion is not what the torque makes: a wrong encoder, an unknown force, or a loop that shakes "
        "at too long a delay",
        "the measurements are a recording: they came before, to the last bit",
        "one encoder repeats its reading, as its noise does not let it",
        "the wrench sensor repeats its reading, as its noise does not let it",
        "one encoder lags: its readings came before, to the last bit",
    };
    return reason >= MOC_RUNNING && reason < MOC_REASONS ? words[reason] : "unknown";
}
