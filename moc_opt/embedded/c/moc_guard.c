#include "moc_guard.h"

#include <limits.h>
#include <math.h>

#include "moc_arm.h"
#include "moc_dense.h"
#include "moc_safe.h"

void moc_guard_start(const double *q, const double *v, int64_t stamp, moc_guard_state *state)
{
    for (int i = 0; i < MOC_N; i++) {
        state->q[i] = q[i];
        state->v[i] = v[i];
        state->low[i] = fmin(moc_q_min[i] + moc_wall_margin[i], q[i]);
        state->high[i] = fmax(moc_q_max[i] - moc_wall_margin[i], q[i]);
    }
    state->tip_square = state->press = state->borne = 0.0;
    state->bad = state->yields = state->open = 0;
    moc_motion_start(q, v, stamp, &state->motion);
}

/* No farther from the last belief than its age explains, and not too fast; NaN never is. */
static int believable(const double *q, const double *v, const moc_guard_state *state)
{
    double ticks = 1.0 + (double)state->bad;
    for (int i = 0; i < MOC_N; i++)
        if (!(fabs(q[i] - state->q[i]) <= MOC_JUMP + ticks * (moc_v_max[i] * MOC_PERIOD) &&
              fabs(v[i]) <= MOC_SPEED_FACTOR * moc_v_max[i]))
            return 0;
    return 1;
}

int moc_guard_believe(const double *q, const double *v, int64_t stamp, const double *sent, const double *wrench,
                      moc_guard_state *state)
{
    int age = moc_motion_age(stamp, &state->motion), reason = age == MOC_OLD ? MOC_STOP_LATE : 0;

    if (age == MOC_FRESH && believable(q, v, state)) {
        for (int i = 0; i < MOC_N; i++) {
            state->q[i] = q[i];
            state->v[i] = v[i];
        }
        state->bad = 0;
        int wrong = moc_motion_look(q, v, sent, wrench, &state->motion);
        return reason ? reason : wrong;
    }
    if (state->bad < INT_MAX)
        state->bad++;
    for (int i = 0; i < MOC_N; i++)
        state->q[i] += state->v[i] * MOC_PERIOD;
    if (reason == 0 && state->bad > MOC_PATIENCE_TICKS)
        reason = MOC_STOP_MEASUREMENT;
    return reason;
}

int moc_guard_follow(const double *tip, const double *tip_ref, moc_guard_state *state)
{
    double square = 0.0;
    for (int i = 0; i < 3; i++)
        state->motion.told[i] = tip_ref[i];
    for (int i = 0; i < 3; i++)
        square += (tip[i] - tip_ref[i]) * (tip[i] - tip_ref[i]);
    state->tip_square += MOC_TIP_SHARE * (square - state->tip_square);
    return state->tip_square <= MOC_TIP_ERROR * MOC_TIP_ERROR ? 0 : MOC_STOP_TIP;
}

/* The speed [rad/s] at which a joint may go towards a wall at this distance [rad]: it can still be stopped. */
static double allowed_speed(double v_max, double distance)
{
    return fmin(v_max, sqrt(2.0 * MOC_WALL_BRAKE * fmax(distance, 0.0)));
}

/* What wall and brake leave of the torque above the weight: at least, at most. Returns whether they act. */
static int wall(int i, const moc_guard_state *state, double *least, double *most)
{
    double v = state->v[i], below = state->q[i] - state->low[i], above = state->high[i] - state->q[i];
    double fall = allowed_speed(moc_v_max[i], below), rise = allowed_speed(moc_v_max[i], above);
    int acts = 0;

    *least = -HUGE_VAL;
    *most = HUGE_VAL;
    if (below < 0.0 || v < -fall) {
        *least = MOC_WALL_STIFFNESS * fmax(-below, 0.0) - MOC_WALL_DAMPING * fmin(v + fall, 0.0);
        acts = 1;
    }
    if (above < 0.0 || v > rise) {
        *most = -MOC_WALL_STIFFNESS * fmax(-above, 0.0) - MOC_WALL_DAMPING * fmax(v - rise, 0.0);
        acts = 1;
    }
    if (*least > *most) /* leaving a wall too fast already: neither spring nor brake */
        *least = *most = 0.0;
    return acts;
}

int moc_guard_limit(const double *before, const moc_guard_state *state, double *tau)
{
    double least[MOC_N], most[MOC_N], weight[MOC_N];
    int braked = 0, touched = 0;

    if (!moc_all_finite(MOC_N, tau))
        return -1;
    for (int i = 0; i < MOC_N; i++)
        braked |= wall(i, state, &least[i], &most[i]);
    if (braked)
        moc_gravity(state->q, weight);
    for (int i = 0; i < MOC_N; i++) {
        double asked = tau[i];
        if (braked)
            tau[i] = fmax(fmin(tau[i], weight[i] + most[i]), weight[i] + least[i]);
        tau[i] = fmin(fmax(tau[i], before[i] - MOC_TORQUE_STEP), before[i] + MOC_TORQUE_STEP);
        tau[i] = fmin(fmax(tau[i], -moc_tau_max[i]), moc_tau_max[i]);
        touched += tau[i] < asked || tau[i] > asked;
    }
    return touched;
}

void moc_guard_hold(double force, moc_guard_state *state, double *friction)
{
    double weight[MOC_N];
    int carried = 1;

    moc_gravity(state->q, weight);
    int known = moc_all_finite(MOC_N, weight);
    for (int i = 0; i < MOC_N; i++) {
        weight[i] = known ? fabs(weight[i]) : 0.0;
        carried &= weight[i] <= moc_tau_max[i];
    }
    if (MOC_STOP_YIELD < HUGE_VAL && carried) {
        /* A mean: in the first moments the tool's inertia force stands beside the trocar's. */
        state->press = moc_all_finite(1, &force) ? state->press + MOC_PRESS_SHARE * (force - state->press) : 0.0;
        state->yields = state->press - state->borne > (state->yields ? 0.5 * MOC_STOP_YIELD : MOC_STOP_YIELD);
        state->open = state->yields ? state->open + 1 : 0;
        if (state->open > MOC_STOP_YIELD_TICKS) {
            state->yields = 0;
            state->borne = state->press;
        } else if (!state->yields) {
            state->borne = fmin(state->borne, state->press);
        }
    }
    for (int i = 0; i < MOC_N; i++) {
        double beyond = fmax(weight[i] - moc_tau_max[i], 0.0); /* what the drive cannot carry */
        friction[i] = state->yields ? 0.0 : MOC_STOP_HOLDING * moc_tau_max[i] + 1.5 * beyond;
    }
}

void moc_guard_rest(const double *before, const moc_guard_state *state, double *tau)
{
    double weight[MOC_N];

    moc_gravity(state->q, weight);
    int known = moc_all_finite(MOC_N, weight);
    for (int i = 0; i < MOC_N; i++) {
        double wanted = known ? moc_clip(weight[i], -moc_tau_max[i], moc_tau_max[i]) : 0.0;
        double change = moc_clip(wanted - before[i], -MOC_TORQUE_STEP, MOC_TORQUE_STEP);
        tau[i] = known ? before[i] + change : 0.0; /* a pose that gives no weight: the brakes alone */
    }
}
