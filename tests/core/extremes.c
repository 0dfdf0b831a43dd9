/* Runs the core with sanitizers on random, extreme and damaged states (`make sanitize`), and prints a digest of all
 * results. Unused array entries (beyond the arm's n joints) are NaN: if the core uses one, the digest changes.
 *
 * Usage: extremes [rounds] [seed]. Each round draws random settings and runs all checks. */
#include <limits.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tools.h"
#include "vec.h"

static uint64_t seed = 1, digest = 14695981039346656037u;
static long reasons[MOC_STOPS], faults[MOC_FAULTS], statuses[4];
static double grain; /* if above 0, `uniform` returns its multiples */

/* Power series of sin(x) (k = 2, term = x) or cos(x) (k = 1, term = 1). */
static double series(double x, int k, double term)
{
    double sum = term;
    for (; k < 40; k += 2)
        sum += term *= -x * x / (k * (k + 1));
    return sum;
}

/* Replace the C library's sin and cos, because their last bits depend on the processor. */
double sin(double x)
{
    double turned = remainder(x, 6.283185307179586);
    return series(turned, 2, turned);
}

double cos(double x)
{
    return series(remainder(x, 6.283185307179586), 1, 1.0);
}

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
    double x = low + (high - low) * ((double)(bits() >> 11) / 9007199254740992.0);
    return grain > 0.0 ? grain * nearbyint(x / grain) : x;
}

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
        double value = x[i] + 0.0; /* -0 becomes 0: C does not define the sign of fmax(0, -0) */
        memcpy(&pattern, &value, sizeof pattern);
        digest = (digest ^ (isnan(x[i]) ? 1 : pattern)) * 1099511628211u;
    }
}

static void note_one(double x)
{
    note(&x, 1);
}

static void fill(double *x, int count, double value)
{
    for (int i = 0; i < count; i++)
        x[i] = value;
}

/* Return a copy of exactly this length, so that the sanitizer finds accesses beyond its end. */
static double *alone(const double *x, int count)
{
    double *own = malloc((unsigned)count * sizeof *own);
    memcpy(own, x, (unsigned)count * sizeof *own);
    return own;
}

/* Set each row's entries after the first n to NaN. */
static void behind(double *x, int rows, int n)
{
    for (int i = 0; i < rows; i++)
        fill(x + i * MOC_MAX_JOINTS + n, MOC_MAX_JOINTS - n, (double)NAN);
}

/* Replace each entry by an extreme number with probability 1 / one_in. */
static void spoil(double *x, int count, unsigned one_in)
{
    for (int i = 0; i < count; i++)
        if (chance(one_in))
            x[i] = extreme();
}

static void draw_arm(moc_arm *arm)
{
    unsigned idle = chance(3) ? 2 : 10; /* with probability 1 / idle, a joint moves neither tip nor wrist */
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
        joint->inertia[0] = joint->inertia[2] = joint->inertia[5] = uniform(0.07, 0.2);
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
        .K_X = 3000.0, .D_X = 80.0, .K_N = 800.0, .D_N = 60.0, .c0 = 0.01, .c1 = 0.01, .c2 = 1e-3, .spare_speed = 1.0,
        .period = 0.002, .fade = 0.01,
    };
    law->rcm_lambda = chance(3) ? 0.5 : 0.0;
    law->projector = (moc_projector)(bits() % 3);
    law->feedforward = chance(2);
    law->k0 = uniform(0.1, 10.0);
    law->rho = chance(3) ? 0.0 : 1e-5;
    law->shaft_margin = chance(2) ? 0.02 : 0.0;
    law->observer_gain = chance(2) ? 20.0 : 0.0;
    law->third_level = !chance(4);
    law->damped = !law->third_level && chance(2);
    law->climbs = law->rho > 0.0 && chance(2);
    behind(law->K_N2, 3, n); /* K_N2, D_N2 and tau_max */
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

static moc_supervision draw_supervision(void)
{
    moc_supervision s = {1, 0.1, 0.01, 0.25, 0.0625, 0, 0, MOC_DAMPING, MOC_LATE_HOLD, HUGE_VAL};
    s.check = !chance(5);
    s.hold_ticks = (int)(bits() % 4);
    s.keep_off_limits = chance(2);
    s.fallback = (moc_fallback)(bits() % 3);
    s.late = (moc_late)(bits() % 3);
    s.budget_us = chance(2) ? HUGE_VAL : 50.0;
    return s;
}

static moc_answer draw_answer(const double *x)
{
    moc_answer answer = {x, MOC_CLAIMS_OPTIMUM, MOC_TAKEN, uniform(0.0, 100.0)};
    answer.claim = (moc_claim)(bits() % 4);
    return answer;
}

static void draw_guard(moc_guard *g, const moc_law *law, int n)
{
    *g = (moc_guard){
        .period = 0.002, .wall_stiffness = 2000.0, .wall_damping = 20.0, .wall_brake = 2.0, .torque_step = 40.0,
        .jump = 0.05, .speed_factor = 5.0, .tip_error = 0.01, .tip_share = 0.02, .incision_share = 0.02,
        .tool_mass = 0.3, .tool_length = 0.3, .tip_force = 10.0, .stop_holding = 0.25, .stop_yield = 8.0,
        .stop_yield_ticks = 200, .press_share = 0.1, .motion_s = 0.1, .motion_rad = 0.001, .motion_lag_s = 0.012,
        .repeat_m = 0.003, .repeat_torque = 0.06, .repeat_whole_m = 0.0005, .repeat_whole_torque = 0.0005,
        .repeat_whole_ticks = 25.0, .replayed_ticks = 25.0, .stuck_speed = 0.2, .residual_torque = 0.2,
        .residual_whole = 0.5, .residual_rate = 40.0, .residual_share = 0.008, .settling_ticks = 75,
    };
    g->patience = (int)(bits() % 5);
    g->carries = !chance(4);
    g->in_incision = !chance(4);
    g->motion = !chance(3);
    g->repeat_joint_ticks = chance(2) ? HUGE_VAL : 40.0;
    g->repeat_reading_ticks = chance(2) ? HUGE_VAL : 3.0;
    for (int k = 0; k < 2; k++) {
        g->warning[k] = chance(3) ? HUGE_VAL : k ? 8.0 : 0.006;
        g->limit[k] = chance(3) ? HUGE_VAL : k ? 15.0 : 0.012;
    }
    behind(g->low, 4, n); /* low, high, v_max and tau_max */
    behind(g->held, 1, n);
    for (int j = 0; j < n; j++) {
        g->low[j] = law->q_min[j] + 0.045;
        g->high[j] = law->q_max[j] - 0.045;
        g->v_max[j] = law->v_max[j];
        g->tau_max[j] = 200.0;
        g->held[j] = 5.0;
    }
}

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
    spoil(&watch->joint[0].drift, (int)(sizeof watch->joint / (sizeof(double))), 20);
}

static void poison(moc_state *s, int n) /* set all entries after the first n to NaN */
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

static void plan(moc_arm *arm, const moc_law *law, const double *from)
{
    enum { MOST = 12 };
    static const double none[MOST * MOC_MAX_JOINTS];
    int n = arm->n, closed, lone = chance(2) ? n - 1 : NONE;
    double *low = alone(law->q_min, n), *high = alone(law->q_max, n), *q = alone(from, n), *best = alone(none, n);
    double *s = alone(none, MOST), *poses = alone(none, MOST * n), *mus = alone(none, MOST), *way = alone(from, n);
    double *slack = alone(none, MOST * n), *step = alone(none, n), *value = alone(none, MOST);
    static const double crossing[] = {1.0, 0.0, 1.0, 0.0, 0.0, 1.0};
    moc_frame frame[MOC_MAX_JOINTS];
    moc_twist twist[MOC_MAX_JOINTS];
    moc_terms terms;
    plan_task task = {.arm = arm, .low = low, .high = high};

    for (int j = 0; j < n; j++) {
        low[j] = chance(10) || lone != NONE ? high[j] = q[j] : low[j];
        if (j == lone) { /* only this joint turns, so that the curve closes */
            arm->joint[j].slides = arm->joint[j].axis[0] = arm->joint[j].axis[1] = 0.0;
            arm->joint[j].axis[2] = 1.0;
            high[j] += chance(2) ? 7.0 : 6.28;
            low[j] -= 5.0;
        }
    }
    moc_kinematics(arm, q, frame, twist, &terms);
    memcpy(task.target[MOC_TIP], terms.tip, sizeof terms.tip);
    memcpy(task.target[MOC_WRIST], terms.wrist, sizeof terms.wrist);
    spoil(task.target[MOC_TIP], 6, 100);
    if (chance(5))
        task.target[MOC_TIP][0] += 2.0;
    for (int j = 0; j < n; j++)
        best[j] = q[j] + uniform(-0.1, 0.1);
    note_one(plan_place(&task, 1 + chance(2), 8, best, best));
    note(best, n);
    for (int j = 0; j < n; j++)
        way[j] = lone == NONE || j == lone;
    int count = plan_follow(&task, q, way, lone == NONE ? 0.05 : uniform(0.5, 1.0), MOST, s, poses, mus, &closed);
    note_one(closed);
    note(poses, count * n);
    note(mus, count);
    note(s, count);
    note_one(plan_ascend(&task, q));
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

/* Run moc_step or, if `own` is set, moc_begin and moc_finish with a spoilt answer. */
static moc_stop tick(const moc_controller *c, const moc_input *in, int own, moc_state *state, double *tau)
{
    double x[MOC_MAX_JOINTS] = {0.0}, y[6];
    moc_answer answer = draw_answer(x);

    if (!own)
        return moc_step(c, in, state, tau);
    if (moc_begin(c, in, state) == MOC_RUNNING && c->law->third_level) {
        spoil(state->problem.A[0], MOC_MAX_JOINTS, 2000);
        statuses[moc_solve_exact(&state->problem, 1e-9, x, y) & 3]++;
        spoil(x, c->arm->n, 300);
    }
    moc_stop reason = moc_finish(c, &answer, state, tau);
    note(state->x, c->law->third_level ? c->arm->n : 0);
    note_one(state->fault);
    faults[state->fault]++;
    return reason;
}

static double tiny(void) /* 1 or, in half of the calls, a power of two from 2^-59 to 1 */
{
    return chance(2) ? 1.0 : ldexp(1.0, -(int)(bits() % 60));
}

/* Row i of A becomes A_0 - A_1/2 + own A_i. b_i becomes the new A_i x + r with |r| <= beside. */
static void repeat(moc_problem *p, int i, const double *x)
{
    double own = chance(4) ? 0.0 : tiny(), beside = chance(4) ? tiny() : 0.0;
    for (int j = 0; j < p->n; j++)
        p->A[i][j] = p->A[0][j] - 0.5 * p->A[1][j] + own * p->A[i][j];
    p->b[i] = dot(p->n, p->A[i], x) + beside * uniform(-1.0, 1.0);
}

/* Solve a random subproblem, run moc_step_network, supervise answers. Returns 0 if the solution violates A x = b. */
static int subproblem(void)
{
    static const double weights[] = {0x1p-10, 0x1p-17, 0.0, 1e-3};
    moc_problem p = {.n = 1 + (int)(bits() % MOC_MAX_JOINTS), .c0 = 0.01, .c1 = 0.02};
    double x[MOC_MAX_JOINTS], near[MOC_MAX_JOINTS], y[6] = {0.0}, rest = chance(2) ? 0.0 : 1e-3;
    double size = ldexp(1.0, (int)(bits() % 21) - 10), narrow = tiny(), steep = tiny();
    moc_memory memory = {.age = (int)(bits() % 3)};
    moc_plane plane;

    grain = chance(2) ? 0.25 : 0.0;
    p.c2 = weights[bits() % 4];
    p.rho = weights[bits() % 3];
    behind(p.A[0], 6, p.n);
    behind(p.pull, 3, p.n); /* pull, lower and upper */
    for (int j = 0; j < p.n; j++) {
        double share = uniform(0.0, 1.0), speed = tiny(), alike = uniform(-2.0, 2.0), column = chance(9) ? 0.0 : size;
        bool twin = j > 0 && chance(3);
        column *= chance(9) ? tiny() : 1.0;
        p.pull[j] = steep * uniform(-1.0, 1.0);
        p.lower[j] = -speed * (0.25 + uniform(0.0, 1.0));
        p.upper[j] = chance(9) ? p.lower[j] : speed * (0.25 + uniform(0.0, 1.0));
        x[j] = chance(3) ? p.lower[j] : p.lower[j] + share * (p.upper[j] - p.lower[j]);
        for (int i = 0; i < 6; i++) {
            p.A[i][j] = column * uniform(-1.0, 1.0);
            if (twin)
                p.A[i][j] = alike * p.A[i][j - 1] + narrow * p.A[i][j];
        }
    }
    for (int i = 0; i < 6; i++)
        p.b[i] = dot(p.n, p.A[i], x) + (chance(40) ? size * uniform(-1.0, 1.0) : 0.0);
    for (int i = 5; i > 2 && !chance(i); i--)
        repeat(&p, i, x);
    moc_status status = moc_solve_exact(&p, chance(2) ? 1e-9 : 0x1p-30, x, y);
    note_one(status);
    note(x, p.n);
    note(y, 6);
    statuses[status]++;
    if (status == MOC_OK && !(off_plane(&p, x) <= 1e-5))
        return 0;
    const moc_network net = {(int)(bits() % 20), steep < 1.0 ? 1.0 : 0.5, 0.75, 0.5, 100.0, narrow < 1.0, rest};
    int made;
    memcpy(near, x, sizeof near);
    spoil(near, p.n, 99);
    note_one(moc_step_network(&p, &net, near, y, &made));
    note_one(made);
    note(near, p.n);
    note(y, 6);
    fill(&memory.Z[0][0], MOC_MAX_JOINTS * MOC_MAX_JOINTS, (double)NAN);
    moc_eliminate(p.n, p.A, &plane);
    memory.rows = moc_null_space(&plane, p.n, 0, memory.Z);
    behind(memory.Z[0], memory.rows, p.n);
    for (int k = 0; k < 4; k++) {
        const moc_supervision s = draw_supervision();
        moc_answer answer = draw_answer(x);
        double followed[MOC_MAX_JOINTS], step[MOC_MAX_JOINTS], far = tiny();
        moc_residuals found = moc_judge(&p, memory.rows, memory.Z, x);

        if (chance(4))
            answer.known = (moc_fault)(bits() % MOC_FAULTS);
        note(&found.primal, 5);
        note_one(moc_supervise(&s, &p, &answer, &memory, followed));
        note(followed, p.n);
        note_one(memory.age);
        for (int j = 0; j < p.n; j++)
            step[j] = far * uniform(-1.0, 1.0);
        if (k)
            moc_onto(p.n, memory.rows, memory.Z, step, step);
        for (int j = 0; j < p.n; j++)
            x[j] = k == 2 ? clip(x[j] + step[j], p.lower[j], p.upper[j]) : x[j] + step[j];
    }
    return 1;
}

static double level(double most)
{
    return chance(2) ? HUGE_VAL : uniform(0.0, most);
}

/* Run only the safety filter. Most inputs are multiples of 0.25, so that readings repeat and values equal limits. */
static void filter(void)
{
    static const double none[MOC_MAX_JOINTS];
    static moc_watch w;
    moc_arm arm;
    moc_law law;
    moc_guard g;
    moc_terms t;
    unsigned still = 1 + (unsigned)(bits() % 3), noise = (unsigned)(bits() % 3), fast = 1 + (unsigned)(bits() % 30);
    uint64_t kept = seed;

    grain = 0.25;
    draw_arm(&arm);
    draw_law(&law, arm.n);
    draw_guard(&g, &law, arm.n);
    arm.n = arm.n < 3 ? arm.n : 1 + (int)(bits() % 3);
    double *levels[] = {
        &g.torque_step, &g.jump, &g.speed_factor, &g.tip_error, g.warning, g.warning + 1, g.limit, g.limit + 1,
        &g.tip_force, &g.stop_yield, &g.motion_rad, &g.motion_lag_s, &g.repeat_m, &g.repeat_torque, &g.repeat_whole_m,
        &g.repeat_whole_torque, &g.stuck_speed, &g.residual_torque, &g.residual_whole, &g.wall_stiffness, &g.wall_brake,
    };
    for (int k = 0; k < (int)(sizeof levels / sizeof *levels); k++)
        *levels[k] = level(2.0);
    double *counts[] = {&g.repeat_joint_ticks, &g.repeat_reading_ticks, &g.repeat_whole_ticks, &g.replayed_ticks};
    for (int k = 0; k < 4; k++)
        *counts[k] = chance(2) ? HUGE_VAL : (double)(bits() % 9);
    g.period = g.tip_share = g.incision_share = g.press_share = g.residual_share = 0.25;
    g.residual_rate = g.motion_s = 1.0;
    g.motion = !chance(9);
    g.stop_yield_ticks = g.settling_ticks = (int)(bits() % 5);
    double *q = alone(none, arm.n), *v = alone(none, arm.n), *before = alone(none, arm.n), *wrench = alone(none, 6);
    for (int j = 0; j < arm.n; j++) {
        q[j] = uniform(-1.0, 1.0);
        v[j] = uniform(-1.0, 1.0);
        g.v_max[j] *= chance(2) ? 8.0 : 1.0;
        g.tau_max[j] = 0.25 + uniform(0.0, 2.0);
        g.held[j] = uniform(0.0, 0.5);
    }
    moc_guard_start(&g, arm.n, q, v, 0, &w);
    for (long long k = 1; k < 240; k++) {
        double tau[MOC_MAX_JOINTS], tip[3], ref[3], pose[4][3];
        bool again = noise == 0 || (k > 180 && k % 30 > 5);
        moc_trocar trocar = {{0.0}, {0.0}};
        const moc_terms *terms = chance(9) ? NULL : &t;
        const double *applied = chance(9) ? NULL : before;
        long long stamp = chance(99) ? LLONG_MIN : k + 1 - (long long)(bits() % (1 + 2 * still));
        moc_stop reason[3] = {MOC_RUNNING};

        kept = k == 20 ? seed : kept;
        seed = k == 70 ? kept : seed; /* replay the readings from tick 20 on */
        for (int i = 0; i < (int)(sizeof t / sizeof(double)); i++)
            ((double *)&t)[i] = uniform(-0.5, 0.5);
        for (int j = 0; j < arm.n; j++) {
            t.M[j][j] = 0.5 + uniform(0.0, 1.0);
            v[j] = chance(still) ? v[j] : uniform(-1.0, 1.0);
            q[j] = chance(fast) ? uniform(-1.0, 1.0) : q[j] + g.period * v[j] * chance(still);
            before[j] = chance(still) ? before[j] : clip(uniform(-1.0, 1.0), -g.tau_max[j], g.tau_max[j]);
            tau[j] = 2.0 * uniform(-1.0, 1.0);
        }
        for (int i = 0; i < 6; i++)
            wrench[i] = again ? wrench[i] : uniform(-0.5, 0.5) + (noise == 2 ? 1.0 / (double)(k % 50 + 1) : 0.0);
        for (int i = 0; i < 3; i++) {
            tip[i] = uniform(-0.25, 0.25);
            ref[i] = chance(still) ? 0.0 : uniform(-0.25, 0.25);
            trocar.P[i] = uniform(-0.5, 0.5);
        }
        const moc_measurement m = {q, v, stamp, chance(2), applied, wrench};
        reason[0] = moc_guard_believe(&g, arm.n, &m, &w);
        moc_tool_pose(&arm, w.q, pose);
        if (!chance(9))
            reason[1] = moc_guard_incision(&g, pose, &trocar, wrench, &w);
        reason[2] = moc_guard_follow(&g, &arm, terms, chance(9) ? NULL : tip, ref, before, tau, &w);
        for (int i = 0; i < 3; i++) {
            note_one(reason[i]);
            reasons[reason[i]]++;
        }
        note(w.q, arm.n);
        note(tau, arm.n);
        note(w.mean_square, 6);
        note_one(w.limited);
        if (!chance(3))
            continue;
        moc_guard_rest(&g, &arm, before, &w, tau);
        note(tau, arm.n);
        moc_guard_hold(&g, &arm, wrench, &w, tau);
        note(tau, arm.n);
    }
    free(q);
    free(v);
    free(before);
    free(wrench);
}

/* Run a random controller. Returns 0 if moc_start fails, a torque exceeds its limits, or a friction is not >= 0. */
static int run_controller(void)
{
    static moc_state states[2];
    moc_arm arm;
    moc_law law;
    moc_guard guard;
    moc_input in = {.x_d = NULL};
    double q[MOC_MAX_JOINTS], v[MOC_MAX_JOINTS], sent[MOC_MAX_JOINTS], pose[4][3], record[500];
    const moc_supervision supervision = draw_supervision();
    const moc_controller controller = {&arm, &law, &supervision, &guard, 1e-9};

    grain = chance(3) ? 0.125 : 0.0;
    draw_arm(&arm);
    draw_law(&law, arm.n);
    draw_guard(&guard, &law, arm.n);
    for (int j = 0; j < MOC_MAX_JOINTS; j++) {
        q[j] = j >= arm.n ? (double)NAN : chance(3) ? 0.0 : uniform(-2.0, 2.0);
        v[j] = j >= arm.n ? (double)NAN : uniform(-0.3, 0.3);
        sent[j] = j >= arm.n ? (double)NAN : 0.0;
    }
    if (chance(2))
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
        long long stamp = chance(40) ? (long long)bits() : k;
        in.measured = (moc_measurement){seen_q, seen_v, stamp, !chance(4), NULL, wrench};
        if (chance(3))
            in.measured.applied = sent;
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
            note_one(reason);
            note(tau, arm.n);
            moc_copy_terms(&state->terms, arm.n, record, PACK);
            note(record, arm.n * (arm.n + 13) + 18);
            moc_copy_problem(&state->problem, arm.n, record, PACK);
            note(record, law.third_level ? 11 * arm.n + 10 : 0);
            note(state->watch.mean_square, 6); /* mean_square, largest and first_tick */
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

/* Check vec.h. Returns 0 if a result is wrong. */
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

/* Check moc_start and moc_begin with torques above limits, damaged states and NaN. Returns 0 if a check fails. */
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
        most[j] *= uniform(-1.0, 1.0); /* the torque that acted differs from the torque that was sent */
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
    guard.patience = 3; /* up to 3 NaN readings in a row are replaced by q + period v, here with v = 0 */
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
    long rounds = count > 1 ? strtol(words[1], NULL, 10) : 10000;
    seed = count > 2 ? 2 * strtoull(words[2], NULL, 10) + 1 : 1; /* the generator needs a nonzero seed */

    for (long k = 0; k < rounds; k++) {
        int sound = 1;
        for (int i = 0; i < 20; i++)
            sound &= subproblem();
        filter();
        grain = 0.0;
        if (!sound || !algebra() || !contract() || !run_controller()) {
            printf("a check failed in round %ld: run %ld rounds with the same seed to see it again\n", k + 1, k + 1);
            return 1;
        }
    }
    printf("%ld rounds of 29 ticks, digest %016llx\n", rounds, (unsigned long long)digest);
    for (int k = 0; k < MOC_STOPS; k++)
        printf("  %s: %ld\n", moc_reason((moc_stop)k), reasons[k]);
    for (int k = 0; k < MOC_FAULTS; k++)
        printf("  fault %d: %ld\n", k, faults[k]);
    printf("  exact: %ld solved, %ld infeasible, %ld doubtful\n", statuses[0], statuses[1], statuses[2]);
    return 0;
}
