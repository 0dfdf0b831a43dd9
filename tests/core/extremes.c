/* Random, extreme and damaged states through the core: nothing reads or writes beyond its arrays, every loop ends, and
 * the torque that leaves the safety filter is finite and within its limits. Built with sanitizers by `make sanitize`.
 * What lies behind the first n numbers of an array is NaN, and the digest of all results is the same whatever the
 * compiler fills new variables with: neither decides anything.
 *
 * extremes [courses] [seed]: 0 where that held. */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tools.h"
#include "vec.h"

static uint64_t seed = 1, digest = 14695981039346656037u;

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

/* NaN, infinite, denormal or huge, and any pattern of bits. */
static double extreme(void)
{
    static const double strange[] = {0.0, -0.0, 1e300, -1e300, 5e-324, 1.7976931348623157e308, 1e16, 1.5707963267948966};
    double any;
    uint64_t pattern = bits();
    switch (bits() % 4) {
    case 0:
        return (double)NAN;
    case 1:
        return chance(2) ? HUGE_VAL : -HUGE_VAL;
    case 2:
        memcpy(&any, &pattern, sizeof any);
        return any;
    default:
        return strange[bits() % (sizeof strange / sizeof strange[0])];
    }
}

static void note(const double *x, int count)
{
    for (int i = 0; i < count; i++) {
        uint64_t pattern;
        memcpy(&pattern, &x[i], sizeof pattern);
        digest = (digest ^ (isnan(x[i]) ? 1 : pattern)) * 1099511628211u;
    }
}

static void fill(double *x, int count, double value)
{
    for (int i = 0; i < count; i++)
        x[i] = value;
}

/* NaN behind the first n numbers of each row. */
static void behind(double *x, int rows, int n)
{
    for (int i = 0; i < rows; i++)
        fill(x + i * MOC_MAX_JOINTS + n, MOC_MAX_JOINTS - n, (double)NAN);
}

static void spoil(double *x, int count, unsigned one_in)
{
    for (int i = 0; i < count; i++)
        if (chance(one_in))
            x[i] = extreme();
}

/* A chain of 1 to 16 joints, turning and sliding, with any axes; now and then of coinciding ones. */
static void draw_arm(moc_arm *arm)
{
    unsigned idle = chance(3) ? 2 : 10; /* with few joints that move the tool it has one freedom of sixteen */
    memset(arm, 0, sizeof *arm);
    fill(&arm->joint[0].rotation[0][0], MOC_MAX_JOINTS * (int)(sizeof *arm->joint / sizeof(double)), (double)NAN);
    arm->n = chance(3) ? MOC_MAX_JOINTS : 1 + (int)(bits() % MOC_MAX_JOINTS);
    for (int j = 0; j < arm->n; j++) {
        moc_joint *joint = &arm->joint[j];
        double angle = uniform(-3.0, 3.0), length = 0.0;
        memset(joint, 0, sizeof *joint);
        joint->rotation[0][0] = joint->rotation[1][1] = cos(angle);
        joint->rotation[1][0] = sin(angle);
        joint->rotation[0][1] = -sin(angle);
        joint->rotation[2][2] = 1.0;
        for (int i = 0; i < 3; i++) {
            joint->origin[i] = chance(4) ? 0.0 : uniform(-0.3, 0.3);
            joint->axis[i] = chance(3) ? 0.0 : uniform(-1.0, 1.0);
            joint->moment[i] = uniform(-0.1, 0.1);
            length += joint->axis[i] * joint->axis[i];
        }
        for (int i = 0; i < 3; i++)
            joint->axis[i] = length > 0.0 ? joint->axis[i] / sqrt(length) : i == 2 ? 1.0 : 0.0;
        joint->slides = chance(5);
        joint->mass = uniform(0.0, 3.0);
        joint->inertia[0] = joint->inertia[2] = joint->inertia[5] = uniform(0.01, 0.2);
        joint->rotor = uniform(0.0, 0.3);
        arm->moves[0][j] = arm->moves[1][j] = !chance(idle);
    }
    arm->point[0][2] = 0.35;
    arm->tool[0][0] = arm->tool[1][1] = arm->tool[2][2] = 1.0;
    arm->gravity[2] = -9.81;
}

static void draw_law(moc_law *law, int n)
{
    *law = (moc_law){
        .K_X = 3000.0, .D_X = 80.0, .K_N = 800.0, .D_N = 60.0, .rcm_lambda = chance(3) ? 0.5 : 0.0,
        .projector = (moc_projector)(bits() % 3), .feedforward = chance(2), .k0 = uniform(0.1, 10.0), .c0 = 0.01,
        .c1 = 0.01, .c2 = 1e-3, .rho = chance(3) ? 0.0 : 1e-5, .shaft_margin = chance(2) ? 0.02 : 0.0,
        .spare_speed = 1.0, .observer_gain = chance(2) ? 20.0 : 0.0, .period = 0.002, .fade = 0.01,
        .third_level = !chance(4),
    };
    law->damped = !law->third_level && chance(2);
    law->climbs = law->rho > 0.0 && chance(2);
    behind(law->K_N2, 3, n); /* with D_N2 and tau_max */
    behind(law->q_min, 3, n);
    for (int j = 0; j < n; j++) {
        law->K_N2[j] = uniform(0.0, 120.0);
        law->D_N2[j] = uniform(0.0, 6.0);
        law->tau_max[j] = chance(3) ? HUGE_VAL : 200.0;
        law->q_min[j] = -uniform(1.0, 3.0);
        law->q_max[j] = uniform(1.0, 3.0);
        law->v_max[j] = uniform(0.5, 2.0);
    }
}

static void draw_guard(moc_guard *g, const moc_law *law, int n)
{
    *g = (moc_guard){
        .period = 0.002, .patience = (int)(bits() % 5), .carries = !chance(4), .wall_stiffness = 2000.0,
        .wall_damping = 20.0, .wall_brake = 2.0, .torque_step = 40.0, .jump = 0.05, .speed_factor = 5.0,
        .tip_error = 0.01, .tip_share = 0.02, .in_incision = !chance(4), .incision_share = 0.02, .tool_mass = 0.3,
        .tool_length = 0.3, .tip_force = 10.0, .stop_holding = 0.25, .stop_yield = 8.0, .stop_yield_ticks = 200,
        .press_share = 0.1, .motion = !chance(3), .motion_s = 0.1, .motion_rad = 0.001, .motion_lag_s = 0.012,
        .repeat_m = 0.003, .repeat_torque = 0.06, .repeat_whole_m = 0.0005, .repeat_whole_torque = 0.0005,
        .repeat_whole_ticks = 25.0, .repeat_joint_ticks = chance(2) ? HUGE_VAL : 40.0,
        .repeat_reading_ticks = chance(2) ? HUGE_VAL : 3.0, .replayed_ticks = 25.0, .stuck_speed = 0.2,
        .residual_torque = 0.2, .residual_whole = 0.5, .residual_rate = 40.0, .residual_share = 0.008,
        .settling_ticks = 75,
    };
    for (int k = 0; k < 2; k++) {
        g->warning[k] = chance(3) ? HUGE_VAL : k ? 8.0 : 0.006;
        g->limit[k] = chance(3) ? HUGE_VAL : k ? 15.0 : 0.012;
    }
    behind(g->low, 4, n); /* with high, v_max and tau_max */
    behind(g->held, 1, n);
    for (int j = 0; j < n; j++) {
        g->low[j] = law->q_min[j] + 0.045;
        g->high[j] = law->q_max[j] - 0.045;
        g->v_max[j] = law->v_max[j];
        g->tau_max[j] = 200.0;
        g->held[j] = 5.0;
    }
}

/* Memory that somebody else has written to, but for the counts that say how much of an array is used. */
static void damage(moc_memory *memory, moc_watch *watch)
{
    if (chance(2))
        spoil(&memory->Z[0][0], MOC_MAX_JOINTS * MOC_MAX_JOINTS, 50);
    spoil(memory->integral, MOC_MAX_JOINTS, 10);
    spoil(memory->tau, MOC_MAX_JOINTS, 10);
    spoil(memory->good, MOC_MAX_JOINTS, 10);
    spoil(watch->q, MOC_MAX_JOINTS, 10);
    spoil(watch->v, MOC_MAX_JOINTS, 10);
    spoil(watch->number, MOC_SLOTS, 1000);
    spoil(watch->at, MOC_SLOTS, 1000);
    spoil(&watch->joint[0].gap, (int)(sizeof watch->joint / (sizeof(double))), 20);
}

/* What no tick has written yet. */
static void poison(moc_state *s, int n)
{
    moc_terms *t = &s->terms;
    moc_problem *p = &s->problem;
    behind(t->q, 2, n);
    behind(t->A[0], 6, n);
    behind(t->grad_mu, 2, n);
    behind(t->M[0], MOC_MAX_JOINTS, n);
    behind(t->h, 3, n);
    behind(p->A[0], 6, n);
    behind(p->grad_mu, 4, n);
    behind(p->q, 1, n);
    behind(s->memory.Z[0], MOC_MAX_JOINTS, n);
    behind(s->memory.integral, 4, n);
    behind(s->watch.q, 4, n);
    behind(s->tau, 1, n);
    behind(s->x, 2, n);
    behind(s->sent, 1, n);
}

static int bounded(const moc_guard *g, int n, const double *tau)
{
    for (int i = 0; i < n; i++)
        if (!(tau[i] >= -g->tau_max[i] && tau[i] <= g->tau_max[i]))
            return 0;
    return 1;
}

/* A copy of its own length on the heap: the sanitizer sees what is beyond it. */
static double *alone(const double *x, int count)
{
    double *own = malloc((unsigned)count * sizeof *own);
    memcpy(own, x, (unsigned)count * sizeof *own);
    return own;
}

/* The arm's poses and curves for the planning, and a value function over them. */
static void plan(const moc_arm *arm, const moc_law *law, const double *from)
{
    enum { MOST = 12 };
    static const double none[MOST * MOC_MAX_JOINTS];
    int n = arm->n, closed;
    double *low = alone(law->q_min, n), *high = alone(law->q_max, n), *q = alone(from, n), *best = alone(none, n);
    double *s = alone(none, MOST), *poses = alone(none, MOST * n), *mus = alone(none, MOST), *way = alone(from, n);
    double *slack = alone(none, MOST * n), *step = alone(none, n), *value = alone(none, MOST);
    static const double crossing[] = {1.0, 0.0, 1.0, 0.0, 0.0, 1.0};
    moc_frame frame[MOC_MAX_JOINTS];
    moc_twist twist[MOC_MAX_JOINTS];
    moc_terms terms;
    plan_task task = {.arm = arm, .low = low, .high = high};

    for (int j = 0; j < n; j++)
        low[j] = chance(10) ? high[j] = q[j] : low[j];
    moc_kinematics(arm, q, frame, twist, &terms);
    memcpy(task.target[MOC_TIP], terms.tip, sizeof terms.tip);
    memcpy(task.target[MOC_WRIST], terms.wrist, sizeof terms.wrist);
    spoil(task.target[MOC_TIP], 6, 100);
    for (int j = 0; j < n; j++)
        best[j] = q[j] + uniform(-0.1, 0.1);
    plan_place(&task, 1 + chance(2), 8, best, best);
    note(best, n);
    fill(way, n, 1.0);
    int count = plan_follow(&task, q, way, 0.05, MOST, s, poses, mus, &closed);
    note(poses, count * n);
    note(mus, count);
    note(s, count);
    plan_ascend(&task, q);
    note(q, n);
    fill(step, n, 0.1);
    const plan_stage stage = {2, MOST / 2, MOST / 2, n, (int)(bits() % (unsigned)n), poses, slack, none, poses, slack,
                              mus, step, crossing, 1e-3, 0.1};
    plan_advance(&stage, value);
    note(value, MOST);
    double *own[] = {low, high, q, best, s, poses, mus, way, slack, step, value};
    for (int k = 0; k < (int)(sizeof own / sizeof *own); k++)
        free(own[k]);
}

static long reasons[MOC_STOPS], faults[MOC_FAULTS], statuses[4];

/* One tick of either state: `own` solver between the halves, whose answers and claims are spoilt, or moc_step. */
static moc_stop tick(const moc_controller *c, const moc_input *in, int own, moc_state *state, double *tau)
{
    double x[MOC_MAX_JOINTS] = {0.0}, y[6];
    moc_answer answer = {x, (moc_claim)(bits() % 4), MOC_TAKEN, uniform(0.0, 100.0)};

    if (!own)
        return moc_step(c, in, state, tau);
    if (moc_begin(c, in, state) == MOC_RUNNING && c->law->third_level) {
        spoil(state->problem.A[0], MOC_MAX_JOINTS, 2000);
        statuses[moc_solve_exact(&state->problem, 1e-9, x, y) & 3]++;
        spoil(x, c->arm->n, 300);
        if (chance(5)) {
            const moc_network net = {20, 1.0, 1.0, 0.5, 100.0, chance(2), 1e-7};
            int made;
            moc_step_network(&state->problem, &net, x, y, &made);
            note(y, 6);
        }
    }
    moc_stop reason = moc_finish(c, &answer, state, tau);
    note(state->x, c->law->third_level ? c->arm->n : 0);
    faults[state->fault]++;
    return reason;
}

/* A course of both; 0 where a torque or a friction is not finite and within its limits. */
static int course(void)
{
    static moc_state states[2];
    moc_arm arm;
    moc_law law;
    moc_guard guard;
    moc_input in = {.x_d = NULL};
    double q[MOC_MAX_JOINTS], v[MOC_MAX_JOINTS], sent[MOC_MAX_JOINTS], pose[4][3];
    const moc_supervision supervision = {1, 0.1, 0.01, 0.05, 1e-3, 3, 1, (moc_fallback)(bits() % 3),
                                         (moc_late)(bits() % 3), chance(2) ? HUGE_VAL : 50.0};
    const moc_controller controller = {&arm, &law, &supervision, &guard, 1e-9};

    draw_arm(&arm);
    draw_law(&law, arm.n);
    draw_guard(&guard, &law, arm.n);
    for (int j = 0; j < MOC_MAX_JOINTS; j++) {
        q[j] = j >= arm.n ? (double)NAN : chance(3) ? 0.0 : uniform(-2.0, 2.0);
        v[j] = j >= arm.n ? (double)NAN : uniform(-0.3, 0.3);
        sent[j] = j >= arm.n ? (double)NAN : 0.0;
    }
    if (chance(4))
        plan(&arm, &law, q);
    moc_tool_pose(&arm, q, pose);
    for (int i = 0; i < 3; i++) {
        in.ref.X[i] = pose[3][i];
        in.ref.dX[i] = uniform(-0.05, 0.05);
        in.ref.ddX[i] = uniform(-0.5, 0.5);
        in.trocar.P[i] = pose[3][i] - 0.15 * pose[2][i];
        in.trocar.dP[i] = 0.0;
    }
    for (int k = 0; k < 2; k++) {
        memset(&states[k], 0, sizeof states[k]);
        if (!chance(20) &&
            moc_start(&controller, &(moc_measurement){q, v, 0, 1, sent, NULL}, &states[k]) != MOC_RUNNING)
            return 0;
        poison(&states[k], arm.n);
    }
    for (long long k = 1; k < 30; k++) {
        double seen_q[MOC_MAX_JOINTS], seen_v[MOC_MAX_JOINTS], wrench[6];

        memcpy(seen_q, q, sizeof q);
        memcpy(seen_v, v, sizeof v);
        for (int i = 0; i < 6; i++)
            wrench[i] = uniform(-3.0, 3.0);
        spoil(seen_q, arm.n, 400);
        spoil(seen_v, arm.n, 400);
        spoil(wrench, 6, 200);
        if (chance(60))
            spoil(in.ref.X, 9, 4);
        if (chance(60))
            spoil(in.trocar.P, 6, 4);
        in.measured = (moc_measurement){seen_q, seen_v, chance(40) ? (long long)bits() : k, !chance(4),
                                        chance(3) ? sent : NULL, wrench};
        in.x_d = chance(4) ? v : NULL;
        for (int own = 0; own < 2; own++) {
            double tau[MOC_MAX_JOINTS], friction[MOC_MAX_JOINTS];
            moc_state *state = &states[own];

            if (chance(30))
                damage(&state->memory, &state->watch);
            if (chance(60))
                spoil(state->sent, arm.n, 4);
            moc_stop reason = tick(&controller, &in, own, state, tau);
            reasons[reason]++;
            note(tau, arm.n);
            if (!bounded(&guard, arm.n, tau))
                return 0;
            if (reason == MOC_RUNNING)
                continue;
            moc_guard_hold(&guard, &arm, wrench, &state->watch, friction);
            note(friction, arm.n);
            for (int i = 0; i < arm.n; i++)
                if (!(friction[i] >= 0.0))
                    return 0;
        }
        memcpy(sent, states[1].sent, (unsigned)arm.n * sizeof *sent);
        for (int i = 0; i < arm.n; i++)
            q[i] += 0.002 * v[i];
    }
    return 1;
}

/* The small algebra, on copies of its own length; 0 where a factor or a basis is wrong. */
static int algebra(void)
{
    double S[5][MOC_MAX_JOINTS], L[5][MOC_MAX_JOINTS], start[5], worst = 0.0;
    int m = 1 + (int)(bits() % 5);
    double *x = alone(start, m), *inverse = alone(start, m), *u = alone(start, 3), *v = alone(start, 3);
    double(*basis)[3] = malloc(2 * sizeof *basis);

    behind(S[0], 5, 0);
    behind(L[0], 5, 0);
    for (int i = 0; i < m; i++) {
        for (int k = 0; k <= i; k++)
            S[i][k] = S[k][i] = uniform(-0.2, 0.2) + (i == k);
        x[i] = start[i] = uniform(-1.0, 1.0);
    }
    cholesky(m, S, L, inverse);
    solve_factored(m, L, inverse, x);
    for (int i = 0; i < m; i++)
        worst = larger(fabs(dot(m, S[i], x) - start[i]), worst);
    for (int i = 0; i < 3; i++)
        u[i] = chance(4) ? 0.0 : uniform(-1.0, 1.0);
    u[0] += 1e-3;
    double length = sqrt(dot3(u, u));
    worst = larger(fabs(normalise3(u) - length), worst);
    across(u, basis);
    memset(v, 0, 3 * sizeof *v);
    add_cross(1.0, basis[0], basis[1], v);
    for (int i = 0; i < 3; i++)
        worst = larger(fabs(v[i] - u[i]), worst);
    worst = larger(fabs(largest_of(m, start) - fabs(clip(9.0, -1.0, largest_of(m, start)))), worst);
    note(x, m);
    int sound = worst < 1e-12 && all_finite(m, x) && all_finite(3, u);
    free(x);
    free(inverse);
    free(u);
    free(v);
    free(basis);
    return sound;
}

/* What a state and a torque at the start may be: the limits themselves are; 0 where that did not hold. */
static int contract(void)
{
    static moc_state state;
    moc_arm arm;
    moc_law law;
    moc_guard guard;
    moc_input in = {.x_d = NULL};
    const moc_supervision supervision = {.check = 1};
    const moc_controller controller = {&arm, &law, &supervision, &guard, 1e-9};
    double q[MOC_MAX_JOINTS] = {0.0}, v[MOC_MAX_JOINTS] = {0.0}, most[MOC_MAX_JOINTS], tau[MOC_MAX_JOINTS], pose[4][3];
    const double none[6] = {0.0};

    draw_arm(&arm);
    draw_law(&law, arm.n);
    draw_guard(&guard, &law, arm.n);
    fill(most, MOC_MAX_JOINTS, guard.tau_max[0]);
    in.measured = (moc_measurement){q, v, 0, 0, most, none};
    moc_tool_pose(&arm, q, pose);
    memcpy(in.ref.X, pose[3], sizeof in.ref.X);
    for (int i = 0; i < 3; i++)
        in.trocar.P[i] = pose[3][i] - 0.15 * pose[2][i];
    for (int beyond = 0; beyond < 2; beyond++) {
        int j = (int)(bits() % (unsigned)arm.n);
        most[j] = (chance(2) ? -1.0 : 1.0) * (beyond ? nextafter(guard.tau_max[j], HUGE_VAL) : guard.tau_max[j]);
        if ((moc_start(&controller, &in.measured, &state) == MOC_RUNNING) == beyond || (beyond && state.begun))
            return 0;
        most[j] = guard.tau_max[j];
        moc_start(&controller, &in.measured, &state);
        state.sent[j] = beyond ? nextafter(guard.tau_max[j], HUGE_VAL) : guard.tau_max[j];
        in.measured.applied = NULL;
        if ((moc_begin(&controller, &in, &state) == MOC_STOP_STATE) != beyond || state.sent[j] != guard.tau_max[j])
            return 0;
        in.measured.applied = most;
    }
    for (int j = 0; j < arm.n; j++)
        most[j] *= uniform(-1.0, 1.0); /* what acted in place of what was sent */
    moc_begin(&controller, &in, &state);
    if (memcmp(state.sent, most, (unsigned)arm.n * sizeof *most) != 0)
        return 0;
    for (int rows = -1; rows < arm.n + 2; rows++) {
        moc_start(&controller, &in.measured, &state);
        state.memory.rows = rows;
        if ((moc_begin(&controller, &in, &state) == MOC_STOP_STATE) != (rows < 0 || rows > arm.n))
            return 0;
    }
    fill(tau, MOC_MAX_JOINTS, (double)NAN);
    guard.patience = 3; /* a reading that is no number is bridged: the arm is where it was */
    in.measured.q = tau;
    moc_start(&controller, &(moc_measurement){q, v, 0, 0, most, none}, &state);
    if (moc_begin(&controller, &in, &state) != MOC_RUNNING ||
        memcmp(state.terms.q, q, (unsigned)arm.n * sizeof *q) != 0)
        return 0;
    in.measured.v = tau;
    in.measured.q = q;
    if (moc_begin(&controller, &in, &state) != MOC_RUNNING ||
        memcmp(state.terms.v, v, (unsigned)arm.n * sizeof *v) != 0)
        return 0;
    state.begun = 0;
    fill(tau, MOC_MAX_JOINTS, 1.0);
    if (moc_begin(&controller, &in, &state) != MOC_STOP_NOT_STARTED ||
        moc_step(&controller, &in, &state, tau) != MOC_STOP_NOT_STARTED)
        return 0;
    for (int i = 0; i < MOC_MAX_JOINTS; i++)
        if (tau[i] != (i < arm.n ? 0.0 : 1.0))
            return 0;
    for (int reason = -1; reason <= MOC_STOPS; reason++)
        if ((strcmp(moc_reason((moc_stop)reason), "unknown") == 0) != (reason < 0 || reason == MOC_STOPS))
            return 0;
    return 1;
}

int main(int count, char **words)
{
    long courses = count > 1 ? strtol(words[1], NULL, 10) : 40000;
    seed = count > 2 ? 2 * strtoull(words[2], NULL, 10) + 1 : 1;

    for (long k = 0; k < courses; k++) {
        uint64_t from = seed;
        if (!algebra() || !contract() || !course()) {
            printf("not as promised: state of the generator %llu\n", (unsigned long long)from);
            return 1;
        }
    }
    printf("%ld courses of 29 ticks, digest %016llx\n", courses, (unsigned long long)digest);
    for (int k = 0; k < MOC_STOPS; k++)
        printf("  %s: %ld\n", moc_reason((moc_stop)k), reasons[k]);
    for (int k = 0; k < MOC_FAULTS; k++)
        printf("  fault %d: %ld\n", k, faults[k]);
    printf("  exact: %ld solved, %ld infeasible, %ld doubtful\n", statuses[0], statuses[1], statuses[2]);
    return 0;
}
