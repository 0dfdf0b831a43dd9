/* What an answer of the third level is worth, and what may stand in for it. */
#include <string.h>

#include "vec.h"

#define AT_BOUND 1e-4          /* a joint this near to a bound is at it [rad/s] */
#define PASSES 2e-3            /* an answer with a smaller natural residual may be verified: the line is not searched */
#define NO_GRADIENT 1e-12      /* share of the gradient along the self-motion below which there is none */
#define IMMOBILE 1e-12         /* squared length of a joint's column below which it does not move */
#define GRADIENT_ROUNDING 1e-9 /* a reduced gradient below this share of the cost's is zero (qp/residuals.py) */
#define RANK_TOLERANCE 1e-12   /* (qp/residuals.py) */
#define SWEEPS 200             /* of the multipliers; one freedom needs two */
#define DESCENTS 50            /* of the least violation, over the joints */
#define OUTSIDE 1e-6           /* what a retreat may leave the box by [rad/s] */

/* The dimensions of ker A that turn joints which move tip or wrist; the rest are idle joints. */
static int freedoms(const moc_problem *p, int rows)
{
    double column[MOC_MAX_JOINTS] = {0.0}, total = 0.0; /* squares */
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < p->n; j++)
            column[j] += p->A[i][j] * p->A[i][j];
    for (int j = 0; j < p->n; j++)
        total += column[j];
    for (int j = 0; j < p->n; j++)
        rows -= column[j] <= RANK_TOLERANCE * RANK_TOLERANCE * total;
    return rows;
}

/* The steepest descent d (n,) from x that stays in ker A and in the box; returns the scale of the cost.
 *
 * That is the projection of minus the reduced gradient on the tangent cone of the feasible set, and zero at an optimum
 * and nowhere else. Joints that are AT_BOUND may only move inwards; their multipliers are found one after the other
 * (Hildreth 1957), which is exact for one and converges for several. Idle joints are left out. */
static double way_down(const moc_problem *p, int rows, double Z[][MOC_MAX_JOINTS], const double *x, double *d)
{
    double cost[MOC_MAX_JOINTS], Pi[MOC_MAX_JOINTS][MOC_MAX_JOINTS], multiplier[MOC_MAX_JOINTS] = {0.0};
    double largest = 0.0, length = 0.0, left = 0.0, whole = 0.0;
    enum { FREE, LOWER, UPPER, FIXED } side[MOC_MAX_JOINTS];
    int n = p->n;

    for (int j = 0; j < n; j++) {
        cost[j] = p->c2 * p->pull[j] - p->rho * x[j];
        for (int k = 0; k < n; k++) {
            Pi[j][k] = 0.0;
            for (int i = 0; i < rows; i++)
                Pi[j][k] += Z[i][j] * Z[i][k];
        }
    }
    for (int j = 0; j < n; j++) {
        int idle = Pi[j][j] > 1.0 - 1e-12; /* e_j itself lies in ker A */
        int low = x[j] - p->lower[j] <= AT_BOUND, high = p->upper[j] - x[j] <= AT_BOUND;
        d[j] = idle ? 0.0 : dot(n, Pi[j], cost);
        largest = fmax(largest, idle ? 0.0 : p->c2 * fabs(dot(n, Pi[j], p->pull)));
        length = fmax(length, fabs(d[j]));
        side[j] = idle || !(Pi[j][j] > IMMOBILE) ? FREE : low && high ? FIXED : low ? LOWER : high ? UPPER : FREE;
    }
    for (int sweep = 0; sweep < SWEEPS; sweep++) {
        double change = 0.0;
        for (int j = 0; j < n; j++) {
            if (side[j] == FREE)
                continue;
            double step = -d[j] / Pi[j][j];
            step = side[j] == LOWER ? fmax(step, -multiplier[j]) : side[j] == UPPER ? fmin(step, -multiplier[j]) : step;
            multiplier[j] += step;
            for (int k = 0; k < n; k++)
                d[k] += step * Pi[j][k];
            change = fmax(change, fabs(step));
        }
        if (change <= 1e-10 * length)
            break;
    }
    for (int j = 0; j < n; j++) {
        left = fmax(left, fabs(d[j]));
        whole = fmax(whole, fabs(cost[j]));
    }
    if (left <= fmax(1e-8 * length, GRADIENT_ROUNDING * whole))
        memset(d, 0, (unsigned)n * sizeof *d);
    return fmax(largest, p->rho);
}

/* Let s be the coordinate of x along a line of self-motion. On it the cost -c2 g s + rho s^2 / 2 has its optimum at
 * clip(c2 g / rho) on the segment that the box leaves, and that of the opposite gradient at clip(-c2 g / rho). Where
 * the elbow swivel is the only freedom the line is the whole feasible set. With several freedoms it is the steepest
 * way down that the box leaves open at x, and all is zero where there is none. */
moc_residuals moc_judge(const moc_problem *p, int rows, double Z[][MOC_MAX_JOINTS], const double *x)
{
    moc_residuals found = {0.0, 0.0, 0.0, 0.0, 0.0};
    double line[MOC_MAX_JOINTS] = {0.0}, steepest = 0.0, still = 1e-9;
    int n = p->n;

    if (!all_finite(n, x)) {
        found.primal = found.outside = found.natural = found.off = found.opposite = (double)NAN;
        return found;
    }
    for (int i = 0; i < 6; i++)
        found.primal = fmax(found.primal, fabs(dot(n, p->A[i], x) - p->b[i]));
    for (int j = 0; j < n; j++) {
        found.outside = fmax(found.outside, fmax(p->lower[j] - x[j], x[j] - p->upper[j]));
        steepest = fmax(steepest, fabs(p->pull[j]));
    }
    moc_onto(n, rows, Z, p->pull, line);
    if (sqrt(dot(n, line, line)) <= NO_GRADIENT * steepest || !(p->c2 > 0.0))
        return found;
    /* The floor rho: a course that rests asks for x_d = 0, and its gradient (rho/c2) x_d is no scale then. */
    double scale = fmax(p->c2 * steepest, p->rho);
    int several = freedoms(p, rows) > 1, faint = p->rho >= p->c2 * steepest;
    if (several) {
        scale = way_down(p, rows, Z, x, line);
        still = 1e-6;
    }
    double length = sqrt(dot(n, line, line));
    if (!(length > 0.0))
        return found;
    double slope = 0.0, total = 0.0, place = 0.0, pull = 0.0, low = -HUGE_VAL, high = HUGE_VAL, room = HUGE_VAL;
    for (int j = 0; j < n; j++) {
        line[j] /= length;
        slope += line[j] * (p->rho * x[j] - p->c2 * p->pull[j]) / scale;
        pull += p->c2 * line[j] * p->pull[j];
        total += fabs(line[j]);
        place += line[j] * x[j];
        if (fabs(line[j]) > still) {
            double inverse = 1.0 / line[j], one = (p->lower[j] - x[j]) * inverse, other = (p->upper[j] - x[j]) * inverse;
            low = fmax(low, fmin(one, other));
            high = fmin(high, fmax(one, other));
        }
    }
    low = fmin(low, 0.0); /* x itself counts as feasible: its violation is judged above */
    high = fmax(high, 0.0);
    for (int j = 0; j < n; j++) {
        double push = line[j] * slope;
        if (push > still * fabs(slope))
            room = fmin(room, fmax(x[j] - p->lower[j], 0.0));
        else if (push < -still * fabs(slope))
            room = fmin(room, fmax(p->upper[j] - x[j], 0.0));
    }
    double desired = p->rho > 0.0 ? pull / p->rho : HUGE_VAL;
    found.natural = fmin(fabs(slope) / total, room);
    if ((several || faint) && found.natural <= PASSES)
        return found;
    found.off = fabs(fmin(fmax(desired - place, low), high));
    found.opposite = fabs(fmin(fmax(-desired - place, low), high));
    return found;
}

/* The smallest self-motion that brings the arm's other motion into the box; zero where none does.
 *
 * With a damped self-motion the arm follows its references with the shortest x of A x = b, which may move a joint to
 * its limit. The shortest x that the box has as well is an optimum of the same kind, without a pull; what it has of
 * self-motion is the way there. */
static void retreat(const moc_problem *problem, int rows, double Z[][MOC_MAX_JOINTS], double *motion)
{
    moc_problem p = *problem;
    double x[MOC_MAX_JOINTS], y[6];

    memset(p.pull, 0, sizeof p.pull);
    memset(motion, 0, (unsigned)p.n * sizeof *motion);
    p.rho = 1.0;
    p.c2 = 0.0;
    if (moc_solve_exact(&p, OUTSIDE, x, y) != MOC_OK)
        return; /* the box is empty, or A has lost more than a rank */
    for (int i = 0; i < 6; i++)
        if (!(fabs(dot(p.n, p.A[i], x) - p.b[i]) <= OUTSIDE)) /* not for a NaN */
            return;
    moc_onto(p.n, rows, Z, x, motion);
}

/* The x of the box with the least |A x - b|. */
static void least_violation(const moc_problem *p, double *x)
{
    double missing[6], size[MOC_MAX_JOINTS] = {0.0};
    int n = p->n;

    for (int j = 0; j < n; j++) {
        x[j] = fmin(fmax(0.0, p->lower[j]), p->upper[j]);
        for (int i = 0; i < 6; i++)
            size[j] += p->A[i][j] * p->A[i][j];
    }
    for (int i = 0; i < 6; i++)
        missing[i] = dot(n, p->A[i], x) - p->b[i];
    for (int sweep = 0; sweep < DESCENTS; sweep++) /* coordinate descent */
        for (int j = 0; j < n; j++) {
            if (!(size[j] > IMMOBILE))
                continue;
            double along = 0.0;
            for (int i = 0; i < 6; i++)
                along += p->A[i][j] * missing[i];
            double best = fmin(fmax(x[j] - along / size[j], p->lower[j]), p->upper[j]);
            for (int i = 0; i < 6; i++)
                missing[i] += (best - x[j]) * p->A[i][j];
            x[j] = best;
        }
    if (!all_finite(n, x))
        memset(x, 0, (unsigned)n * sizeof *x);
}

static moc_fault fault_of(const moc_supervision *s, const moc_problem *p, const moc_answer *answer, moc_memory *memory)
{
    moc_claim claim = answer->claim;
    if (answer->known != MOC_TAKEN)
        return answer->known;
    if (claim == MOC_CLAIMS_INFEASIBLE)
        return MOC_FAULT_INFEASIBLE;
    if (claim == MOC_GIVES_NONE)
        return MOC_FAULT_FAILED;
    moc_residuals found = moc_judge(p, memory->rows, memory->Z, answer->x);
    double limit = claim == MOC_CLAIMS_OPTIMUM ? s->primal_limit : s->box_limit;
    if (!(found.primal >= 0.0))
        return MOC_FAULT_NOT_FINITE;
    if (s->check && (found.primal > limit || found.outside > limit))
        return MOC_FAULT_OUTSIDE;
    if (s->check && claim == MOC_CLAIMS_OPTIMUM &&
        (found.natural > s->relative_limit || (found.off > s->opposite_limit && found.opposite < found.off)))
        return MOC_FAULT_FALSE_OPTIMUM;
    return answer->us > s->budget_us ? MOC_FAULT_LATE : MOC_TAKEN;
}

moc_fault moc_supervise(const moc_supervision *s, const moc_problem *p, const moc_answer *answer, moc_memory *memory,
                        double *x)
{
    moc_fault fault = fault_of(s, p, answer, memory);
    unsigned bytes = (unsigned)p->n * sizeof *x;

    if (fault == MOC_TAKEN) {
        memcpy(memory->good, answer->x, bytes);
        memcpy(x, answer->x, bytes);
        memory->age = 0;
        return fault;
    }
    memory->age += memory->age < 1 << 30;
    memset(x, 0, bytes);
    if (fault == MOC_FAULT_INFEASIBLE && s->fallback == MOC_LEAST_VIOLATION)
        least_violation(p, x);
    else if (fault == MOC_FAULT_INFEASIBLE && s->fallback == MOC_DAMPING)
        return fault;
    else if (fault == MOC_FAULT_LATE && s->late == MOC_LATE_ZERO)
        return fault;
    else if (fault == MOC_FAULT_LATE && s->late == MOC_LATE_ITERATE && all_finite(p->n, answer->x))
        memcpy(x, answer->x, bytes);
    else if (memory->age <= s->hold_ticks)
        memcpy(x, memory->good, bytes);
    else if (s->keep_off_limits)
        retreat(p, memory->rows, memory->Z, x);
    return fault;
}
