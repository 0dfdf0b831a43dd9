#include "moc_motion.h"

#include <limits.h>
#include <math.h>
#include <string.h>

#include "moc_dense.h"
#include "moc_safe.h"

#define FIRST_TICKS 100 /* in which it shows whether the wrench sensor has noise */
#define LARGEST_STAMP (INT64_MAX / 4) /* numbers beyond it are no numbers of control periods */

void moc_motion_start(const double *q, const double *v, int64_t stamp, moc_motion_state *state)
{
    memset(state, 0, sizeof *state);
    state->now = state->newest = stamp - 1;
    state->delay = -2;
    moc_replay_start(&state->replay);
    for (int i = 0; i < MOC_N; i++) {
        state->shown[i] = q[i];
        state->peak[i] = fabs(v[i]);
        state->repeats[i] = -1.0;
    }
}

int moc_motion_age(int64_t stamp, moc_motion_state *state)
{
    if (!MOC_MOTION)
        return MOC_FRESH;
    int possible = stamp > -LARGEST_STAMP && stamp < LARGEST_STAMP;
    state->now++;
    int64_t late = possible ? state->now - stamp : INT64_MAX;
    if (late < 0 && late >= -MOC_PATIENCE_TICKS) { /* the arm counted on while the controller missed ticks */
        state->now = stamp;
        late = 0;
    }
    int newer = possible && late >= 0 && stamp > state->newest;
    if (newer) {
        state->ticks += stamp - state->newest;
        state->newest = stamp;
        if (state->delay < 0) /* the one that the run is started with is as old as it is told to be */
            state->delay = state->delay == -1 ? late : -1;
    }
    if (state->now - state->newest > (state->delay > 0 ? state->delay : 0) + MOC_PATIENCE_TICKS)
        return MOC_OLD;
    return newer ? MOC_FRESH : MOC_REPEAT;
}

/* Take note of the wrench, and of how often in a row it was the same to the last bit. */
static void compare_wrench(const double *wrench, moc_motion_state *state)
{
    state->wrench_repeats += 1.0;
    for (int i = 0; i < 6; i++) {
        if (!(wrench[i] <= state->wrench[i] && wrench[i] >= state->wrench[i]))
            state->wrench_repeats = 0.0;
        state->wrench[i] = wrench[i];
    }
    if (state->looked < FIRST_TICKS) {
        state->looked++;
        state->wrench_is_still |= state->wrench_repeats > 0.0;
    }
}

/* Whether the arm was told to move, or the torque changed, while all encoders repeated themselves. */
static int moved(const double *tau, const moc_motion_state *state)
{
    int whole = state->wrench_repeats > MOC_PATIENCE_TICKS, found = 0;
    double least = whole ? MOC_REPEAT_WHOLE_TORQUE : MOC_REPEAT_TORQUE, way = whole ? MOC_REPEAT_WHOLE_M : MOC_REPEAT_M;

    for (int i = 0; i < 3; i++)
        found |= fabs(state->told[i] - state->still[i]) > way;
    for (int i = 0; i < MOC_N; i++)
        found |= fabs(tau[i] - state->torque[i]) > least * moc_tau_max[i];
    return found;
}

/* Joint i: position against velocity, and whether it repeats itself. Returns whether it runs away from its velocity. */
static int compare_joint(int i, double q, double v, double elapsed, int *all_whole, moc_motion_state *state)
{
    double keep = 1.0 - fmin(1.0, elapsed / MOC_MOTION_S);
    int first = state->repeats[i] < 0.0;

    if (first) /* what it is compared with begins here */
        state->shown[i] = q - elapsed * v;
    state->gap[i] = keep * state->gap[i] + (q - state->shown[i]) - elapsed * v;
    state->peak[i] = fmax(keep * state->peak[i], fabs(v));
    int same = q <= state->shown[i] && q >= state->shown[i];
    /* A velocity that was never other than zero is no sign: the joint has rested since the start. */
    int whole = !first && same && v <= state->speed[i] && v >= state->speed[i] && state->peak[i] > 0.0;
    state->whole[i] += whole;
    *all_whole &= whole;
    state->speed[i] = v;
    if (first || same) {
        state->repeats[i] += 1.0;
    } else {
        state->repeats[i] = 0.0;
        state->at_repeat[i] = state->mean[i]; /* of its last value a coarse step has its share */
        state->unseen[i] = 0.0;
    }
    state->shown[i] = q;
    return fabs(state->gap[i]) > MOC_MOTION_RAD + MOC_MOTION_LAG_S * state->peak[i];
}

/* Whether the wrench sensor never repeated itself in the first readings; 0 until they are in. */
static int has_noise(const moc_motion_state *state)
{
    return state->looked >= FIRST_TICKS && !state->wrench_is_still;
}

/* Compare a new reading with its own velocity and with the last one. */
static int compare_readings(const double *q, const double *v, const double *tau, const double *wrench,
                            moc_motion_state *state)
{
    double elapsed = MOC_PERIOD * (state->ticks > 1 ? (double)state->ticks : 1.0), fewest = 1e18, most = 0.0;
    double most_whole = 0.0;
    int ran_away = 0, all_whole = 1;

    state->ticks = 0;
    compare_wrench(wrench, state);
    for (int i = 0; i < MOC_N; i++) {
        ran_away |= compare_joint(i, q[i], v[i], elapsed, &all_whole, state);
        fewest = fmin(fewest, state->repeats[i]);
        most = fmax(most, state->repeats[i]);
        most_whole = fmax(most_whole, state->whole[i]);
    }
    state->readings_twice += all_whole;
    if (state->readings_twice > MOC_REPEAT_READING_TICKS)
        return MOC_STOP_REPEATED;
    int one = most > MOC_REPEAT_JOINT_TICKS || most_whole > MOC_REPEAT_READING_TICKS;
    int deaf = has_noise(state) && state->wrench_repeats > MOC_REPEAT_WHOLE_TICKS;
    int single = ran_away ? MOC_STOP_RAN_AWAY : one ? MOC_STOP_ONE_REPEATED : deaf ? MOC_STOP_WRENCH_REPEATED : 0;
    if (fewest <= MOC_PATIENCE_TICKS) { /* from here on a repeated reading counts, and so does what changes */
        for (int i = 0; i < MOC_N; i++)
            state->torque[i] = tau[i];
        for (int i = 0; i < 3; i++)
            state->still[i] = state->told[i];
        return single;
    }
    if (deaf || moved(tau, state))
        return MOC_STOP_REPEATED;
    return single;
}

int moc_motion_look(const double *q, const double *v, const double *tau, const double *wrench, moc_motion_state *state)
{
    if (!MOC_MOTION)
        return 0;
    int found = compare_readings(q, v, tau, wrench, state);
    double most = has_noise(state) ? MOC_REPEAT_WHOLE_TICKS : MOC_REPLAYED_TICKS;
    /* Where no encoder repeats a reading, one that came before is found as soon as one that comes twice. */
    if (MOC_REPEAT_READING_TICKS < HUGE_VAL && moc_replay_lagging(q, v, &state->replay) > MOC_REPEAT_READING_TICKS &&
        !found)
        found = MOC_STOP_LAGGING;
    if (moc_replay_count(q, v, wrench, &state->replay) > fmin(most, MOC_REPEAT_READING_TICKS))
        return MOC_STOP_REPLAYED;
    return found;
}

/* A step of the momentum observer: r = K_o (p - integral of (tau + C^T v - g + r)). */
static void observe(const moc_tick_report *seen, const double *v, const double *tau, moc_motion_state *state)
{
    for (int i = 0; i < MOC_N; i++) {
        double p = moc_dot(MOC_N, seen->M + i * MOC_N, v);
        state->integral[i] += (tau[i] + seen->energy_slope[i] - seen->gravity[i] + state->residual[i]) * MOC_PERIOD;
        state->residual[i] = MOC_RESIDUAL_RATE * (p - state->integral[i]);
    }
}

int moc_motion_weigh(const moc_tick_report *seen, const double *v, const double *tau, moc_motion_state *state)
{
    int stuck = 0;

    if (!MOC_MOTION)
        return 0;
    if (state->weighed < INT_MAX)
        state->weighed++;
    if (state->weighed == 1) {
        for (int i = 0; i < MOC_N; i++)
            state->integral[i] = moc_dot(MOC_N, seen->M + i * MOC_N, v);
        return 0;
    }
    observe(seen, v, tau, state);
    for (int i = 0; i < MOC_N; i++) {
        double r = state->residual[i];
        if (state->weighed <= MOC_SETTLING_TICKS) {
            state->mean[i] = state->at_repeat[i] = r;
            state->unseen[i] = 0.0;
        }
        state->mean[i] += MOC_RESIDUAL_SHARE * (r - state->mean[i]);
        double beyond = r - state->at_repeat[i];
        beyond -= moc_clip(beyond, -moc_held[i], moc_held[i]);
        state->unseen[i] += MOC_PERIOD * beyond / seen->M[i * MOC_N + i];
        stuck |= state->repeats[i] > MOC_PATIENCE_TICKS && fabs(state->unseen[i]) > MOC_STUCK_SPEED;
        if (fabs(r - state->mean[i]) > MOC_RESIDUAL_TORQUE * moc_tau_max[i] ||
            fabs(r) > MOC_RESIDUAL_WHOLE * moc_tau_max[i])
            state->exceeded[i] += 1.0;
        else
            state->exceeded[i] = 0.0;
        if (state->exceeded[i] > MOC_PATIENCE_TICKS)
            return MOC_STOP_UNEXPLAINED;
    }
    return stuck ? MOC_STOP_STUCK : 0;
}
