/* Check a solver's answer, and replace a refused answer. */
#include "vec.h"

#define AT_BOUND 1e-4          /* largest distance from a bound that counts as zero [rad/s] */
#define PASSES 2e-3            /* if `natural` is at most this, moc_judge may leave `off` and `opposite` 0 [rad/s] */
#define NO_GRADIENT 1e-12      /* largest |part of pull in ker A| / (largest |pull_j|) that counts as zero */
#define IMMOBILE 1e-12         /* least divisor in least_violation, for joints that hardly move tip and wrist [m^2] */
#define GRADIENT_ROUNDING 1e-9 /* largest |d| of steepest_descent that counts as zero */
#define DESCENTS 50            /* sweeps in least_violation */
#define OUTSIDE 1e-6           /* largest allowed bound violation [rad/s] and |A x - b| [m/s] in `retreat` */

/* Whether joint j moves neither tip nor wrist. */
static bool is_idle(int rows, double Z[][MOC_MAX_JOINTS], int j)
{
    double own = 0.0;
    for (int i = 0; i < rows; i++)
        own += Z[i][j] * Z[i][j];
    return own > 1.0 - 1e-12;
}

/* Compute d (n,), the negative gradient, projected on the tangent cone of the feasible set. moc_judge divides the
 * gradient by the returned number. */
static double steepest_descent(const moc_problem *p, int rows, double Z[][MOC_MAX_JOINTS], const double *x, double *d)
{
    moc_problem cone = {.n = p->n, .rho = 1.0};
    double pull[MOC_MAX_JOINTS], y[6], scale = p->rho;

    memcpy(cone.A, p->A, sizeof cone.A);
    moc_onto(p->n, rows, Z, p->pull, pull);
    for (int j = 0; j < p->n; j++) {
        bool idle = is_idle(rows, Z, j);
        cone.pull[j] = p->c2 * p->pull[j] - p->rho * x[j];
        cone.lower[j] = idle || x[j] - p->lower[j] <= AT_BOUND ? 0.0 : -2.0;
        cone.upper[j] = idle || p->upper[j] - x[j] <= AT_BOUND ? 0.0 : 2.0;
        scale = larger(idle ? 0.0 : p->c2 * fabs(pull[j]), scale);
    }
    double length = sqrt(dot(p->n, cone.pull, cone.pull));
    cone.c2 = 1.0 / larger(length, 1e-300); /* |d| <= 1 */
    if (moc_solve_exact(&cone, 1e-9, d, y) != MOC_OK)
        memset(d, 0, (unsigned)p->n * sizeof *d);
    return scale;
}

/* `natural`, `off` and `opposite` (shared.h) are measured on a line through x, parallel to ker A. If ker A has several
 * dimensions, idle joints not counted, this is the line of steepest feasible descent. Its unit vector is z, s = z^T x,
 * g = z^T pull. Along z, the cost is rho s^2/2 - c2 g s + const. The optimum is s = c2 g/rho, clipped to the bounds. */
moc_residuals moc_judge(const moc_problem *p, int rows, double Z[][MOC_MAX_JOINTS], const double *x)
{
    moc_residuals found = {0.0, 0.0, 0.0, 0.0, 0.0};
    double line[MOC_MAX_JOINTS] = {0.0}, steepest = 0.0, still = STILL;
    int n = p->n, freedoms = rows;

    if (!all_finite(n, x)) {
        found.primal = found.outside = found.natural = found.off = found.opposite = (double)NAN;
        return found;
    }
    found.primal = off_plane(p, x);
    for (int j = 0; j < n; j++) {
        found.outside = larger(larger(p->lower[j] - x[j], x[j] - p->upper[j]), found.outside);
        steepest = larger(fabs(p->pull[j]), steepest);
        freedoms -= is_idle(rows, Z, j);
    }
    moc_onto(n, rows, Z, p->pull, line);
    if (sqrt(dot(n, line, line)) <= NO_GRADIENT * steepest || !(p->c2 > 0.0))
        return found;
    /* at least rho: if the elbow follows an x_d, pull is (rho / c2) x_d, which may be almost zero */
    double scale = larger(p->c2 * steepest, p->rho);
    int several = freedoms > 1, faint = p->rho >= p->c2 * steepest;
    if (several) {
        scale = steepest_descent(p, rows, Z, x, line);
        still = 1e-6;
    }
    double length = sqrt(dot(n, line, line));
    if (!(length > (several ? GRADIENT_ROUNDING : 0.0)))
        return found;
    double slope = 0.0, total = 0.0, place = 0.0, pull = 0.0, low = -HUGE_VAL, high = HUGE_VAL, room = HUGE_VAL;
    for (int j = 0; j < n; j++) {
        line[j] /= length;
        slope += line[j] * (p->rho * x[j] - p->c2 * p->pull[j]) / scale;
        pull += p->c2 * line[j] * p->pull[j];
        total += fabs(line[j]);
        place += line[j] * x[j];
        if (fabs(line[j]) > still) {
            double one = (p->lower[j] - x[j]) / line[j], other = (p->upper[j] - x[j]) / line[j];
            low = larger(smaller(one, other), low);
            high = smaller(larger(one, other), high);
        }
    }
    low = smaller(0.0, low); /* low <= 0 <= high, even if x is beyond a bound */
    high = larger(0.0, high);
    for (int j = 0; j < n; j++) {
        double push = line[j] * slope;
        if (fabs(push) > still * fabs(slope))
            room = smaller(larger(signbit(push) ? p->upper[j] - x[j] : x[j] - p->lower[j], 0.0), room);
    }
    double desired = pull / p->rho;
    found.natural = smaller(fabs(slope) / total, room);
    if ((several || faint) && found.natural <= PASSES)
        return found;
    found.off = fabs(smaller(larger(desired - place, low), high));
    found.opposite = fabs(smaller(larger(-desired - place, low), high));
    return found;
}

/* Compute `motion`, the part in ker A of the feasible x with the smallest norm. */
static void retreat(const moc_problem *problem, int rows, double Z[][MOC_MAX_JOINTS], double *motion)
{
    moc_problem p = *problem;
    double x[MOC_MAX_JOINTS], y[6];

    memset(p.pull, 0, sizeof p.pull);
    p.rho = 1.0;
    p.c2 = 0.0;
    if (moc_solve_exact(&p, OUTSIDE, x, y) != MOC_OK || !(off_plane(&p, x) <= OUTSIDE))
        return;
    moc_onto(p.n, rows, Z, x, motion);
}

/* Minimize |A x - b| within the bounds by coordinate descent. */
static void least_violation(const moc_problem *p, double *x)
{
    double missing[6], size[MOC_MAX_JOINTS] = {0.0};
    int n = p->n;

    for (int j = 0; j < n; j++) {
        x[j] = clip(0.0, p->lower[j], p->upper[j]);
        for (int i = 0; i < 6; i++)
            size[j] += p->A[i][j] * p->A[i][j];
    }
    for (int i = 0; i < 6; i++)
        missing[i] = dot(n, p->A[i], x) - p->b[i];
    for (int sweep = 0; sweep < DESCENTS; sweep++)
        for (int j = 0; j < n; j++) {
            double along = 0.0;
            for (int i = 0; i < 6; i++)
                along += p->A[i][j] * missing[i];
            double best = clip(x[j] - along / larger(size[j], IMMOBILE), p->lower[j], p->upper[j]);
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
    memory->age += memory->age <= s->hold_ticks;
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
