/* Random and extreme states: whatever goes in, the torque is finite and within its limits.
 *
 * extremes [states] [seed]: 0 where that held, 1 with the first state where it did not.
 */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "moc_arm.h"
#include "moc_dense.h"
#include "moc_safe.h"
#if MOC_SOLVES
#include "moc_null_space.h"
#include "moc_singular.h"
#include "moc_subproblem.h"
#endif

static uint64_t seed = 1;

static uint64_t bits(void)
{
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return seed;
}

static int chance(unsigned one_in)
{
    return bits() % one_in == 0;
}

static double uniform(double low, double high)
{
    return low + (high - low) * ((double)(bits() >> 11) / 9007199254740992.0);
}

#if MOC_HAS_BUDGET
double moc_clock_us(void)
{
    return chance(20) ? (double)NAN : uniform(0.0, 2.0 * MOC_BUDGET_US);
}
#endif

/* An extreme number: NaN, infinite, denormal or huge, and ordinary ones between. */
static double extreme(void)
{
    static const double strange[] = {0.0, -0.0, 1e300, -1e300, 1e-300, 5e-324, 1.7976931348623157e308, 1e16, -1e16,
                                     1.5707963267948966, 1e-9};
    double any;
    switch (bits() % 5) {
    case 0:
        return (double)NAN;
    case 1:
        return chance(2) ? HUGE_VAL : -HUGE_VAL;
    case 2: {
        uint64_t pattern = bits();
        memcpy(&any, &pattern, sizeof any);
        return any;
    }
    default:
        return strange[bits() % (sizeof strange / sizeof strange[0])];
    }
}

static void spoil(double *x, int count, unsigned one_in)
{
    for (int i = 0; i < count; i++)
        if (chance(one_in))
            x[i] = extreme();
}

/* A pose: anywhere, or with joints at zero (straight elbow, stretched arm), or at and beyond the limits. */
static void draw_pose(double *q)
{
    unsigned kind = (unsigned)(bits() % 4);
    for (int i = 0; i < MOC_N; i++) {
        double room = moc_q_max[i] - moc_q_min[i];
        q[i] = uniform(moc_q_min[i], moc_q_max[i]);
        if (kind == 1 && chance(2))
            q[i] = 0.0;
        if (kind == 2)
            q[i] = chance(2) ? moc_q_max[i] + uniform(-0.1, 0.01) * room : moc_q_min[i] + uniform(-0.01, 0.1) * room;
        if (kind == 3 && chance(4))
            q[i] = uniform(-1e-9, 1e-9);
    }
}

typedef struct {
    int64_t stamp;
    double q[MOC_N], v[MOC_N], tip_ref[9], trocar[6], wrench[6], sent[MOC_N];
} inputs;

static inputs draw(void)
{
    inputs in;
    double pose[12];

    in.stamp = (int64_t)(bits() % 1000);
    draw_pose(in.q);
    moc_tool_pose(in.q, pose);
    for (int i = 0; i < MOC_N; i++) {
        in.v[i] = uniform(-1.0, 1.0) * moc_v_max[i] * (chance(4) ? 6.0 : 0.3);
        in.sent[i] = uniform(-1.0, 1.0) * moc_tau_max[i];
    }
    for (int i = 0; i < 9; i++)
        in.tip_ref[i] = (i < 3 ? pose[9 + i] : 0.0) + uniform(-1e-3, 1e-3);
    for (int i = 0; i < 3; i++) {
        in.trocar[i] = pose[9 + i] - 0.15 * pose[6 + i] + uniform(-1e-3, 1e-3);
        in.trocar[3 + i] = uniform(-1e-3, 1e-3);
    }
    for (int i = 0; i < 6; i++)
        in.wrench[i] = uniform(-3.0, 3.0);
    return in;
}

static long steps, reasons[MOC_REASONS];
#if MOC_SOLVES
static long faults[MOC_FAULTS];
#endif

/* One step; returns whether its torque is as promised. */
static int safe(const inputs *in, moc_safe_state *state)
{
    double tau[MOC_N];
    int before = state->reason, fine = 1;
    int reason = moc_safe_step(in->q, in->v, in->stamp, in->tip_ref, in->trocar, in->wrench, state, tau, NULL);
    double friction[MOC_N];

    for (int i = 0; i < MOC_N; i++)
        fine &= tau[i] >= -moc_tau_max[i] && tau[i] <= moc_tau_max[i];
    if (reason != MOC_RUNNING) {
        moc_safe_hold(in->wrench, state, friction);
        for (int i = 0; i < MOC_N; i++)
            fine &= friction[i] >= 0.0 && friction[i] < HUGE_VAL;
    }
    if (before == MOC_RUNNING && reason >= 0 && reason < MOC_REASONS)
        reasons[reason]++;
    steps++;
    fine &= reason >= MOC_RUNNING && reason < MOC_REASONS;
#if MOC_SOLVES
    if (reason == MOC_RUNNING)
        faults[state->supervisor.fault]++;
#endif
    return fine;
}

/* A place in the state; the readings that are remembered, its largest part, get one in eight. */
static size_t place(const moc_safe_state *state)
{
    const moc_replay_state *past = &state->guard.motion.replay;
    size_t begin = (size_t)((const unsigned char *)past - (const unsigned char *)state);
    size_t at = (size_t)bits() % (sizeof *state - sizeof *past);
    if (chance(8))
        return begin + (size_t)bits() % sizeof *past;
    return at < begin ? at : at + sizeof *past;
}

/* Memory that somebody else has written to. */
static void damage(moc_safe_state *state)
{
    unsigned char *bytes = (unsigned char *)state;
    double any = extreme();
    size_t at = place(state);
    if (chance(2))
        bytes[at] ^= (unsigned char)(1u << (bits() % 8));
    else
        memcpy(bytes + at - at % 8, &any, sizeof any);
}

/* A course from a drawn start, until some ticks after the stop: measurements drift, and extremes happen. */
static int course(void)
{
    moc_safe_state state;
    inputs in = draw(), given;
    unsigned one_in = chance(3) ? 200 : 4000;

    memset(&state, (int)(bits() & 0xff), sizeof state); /* what lies in memory before the start */
    if (!chance(50))
        moc_safe_start(in.q, in.v, in.stamp, in.sent, &state);
    for (int k = 0, stopped = 0; k < 40 && stopped < 3; k++) {
        given = in;
        given.stamp += k;
        if (chance(one_in)) /* a packet again, or from another time */
            given.stamp = chance(2) ? given.stamp - 1 - (int64_t)(bits() % 5) : (int64_t)bits();
        if (chance(4 * one_in))
            in.stamp -= 1 + (int64_t)(bits() % 3); /* from now on later */
        spoil(given.q, MOC_N, one_in);
        spoil(given.v, MOC_N, one_in);
        spoil(given.tip_ref, 9, 10 * one_in);
        spoil(given.trocar, 6, 10 * one_in);
        spoil(given.wrench, 6, one_in);
        if (chance(one_in))
            damage(&state);
        if (!safe(&given, &state))
            return 0;
        stopped += state.reason != MOC_RUNNING;
        for (int i = 0; i < MOC_N; i++)
            in.q[i] += MOC_PERIOD * in.v[i];
    }
    return 1;
}

#if MOC_SOLVES
/* The supervisor alone, on Jacobians and records that no arm has: zero, huge, repeated, not finite. */
static int alone(void)
{
    double record[MOC_RECORD], Z[MOC_N * MOC_N], x[MOC_N], other[MOC_N], answer[MOC_N];
    double size = chance(3) ? 0.0 : pow(10.0, uniform(-12.0, 12.0));
    moc_supervisor_state state;
    moc_plane plane;

    for (int i = 0; i < MOC_RECORD; i++)
        record[i] = size * uniform(-1.0, 1.0);
    for (int j = 0; j < MOC_N; j++) {
        record[MOC_LOWER + j] = -uniform(0.0, 1.0);
        record[MOC_UPPER + j] = uniform(0.0, 1.0);
        record[MOC_A + 5 * MOC_N + j] = record[MOC_A + j]; /* a row that repeats another */
        record[MOC_A + 4 * MOC_N + j] = record[MOC_A + MOC_N + j];
        answer[j] = uniform(-1.0, 1.0);
        state.good[j] = 0.0;
    }
    if (chance(3))
        spoil(record, MOC_RECORD, 20);
    spoil(answer, MOC_N, 20);
    moc_supervisor_start(&state);
    state.age = MOC_HOLD_TICKS;
    plane = moc_eliminate(record + MOC_A, record + MOC_B);
    int rows = moc_kernel(&plane, Z);
    int status = moc_singular_answer(&plane, record, x);
    moc_supervise(status, record, Z, rows, chance(2) ? x : answer, 0.0, &state, other);
    faults[state.fault]++;
    return moc_all_finite(MOC_N, other);
}
#endif

int main(int count, char **words)
{
    long states = count > 1 ? strtol(words[1], NULL, 10) : 1000000;
    seed = count > 2 ? 2 * strtoull(words[2], NULL, 10) + 1 : 1;

    while (steps < states) {
        uint64_t from = seed;
        int fine = course();
#if MOC_SOLVES
        fine = alone() && fine;
#endif
        if (!fine) {
            printf("not finite, or beyond its limits: seed %llu\n", (unsigned long long)from);
            return 1;
        }
    }
    printf("%ld states: every torque finite and within its limits\n", steps);
    for (int k = 0; k < MOC_REASONS; k++)
        printf("  %s: %ld\n", moc_safe_reason(k), reasons[k]);
#if MOC_SOLVES
    for (int k = 0; k < MOC_FAULTS; k++)
        printf("  fault %d: %ld\n", k, faults[k]);
#endif
    return 0;
}
