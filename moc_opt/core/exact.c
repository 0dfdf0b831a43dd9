/* The subproblem's optimum by elimination. If A x = b, the cost is rho/2 |x|^2 - c2 pull^T x + constant.
 *
 * Gauss-Jordan elimination with complete pivoting (Golub and Van Loan, Matrix Computations, 3.4.8) writes x as a
 * particular solution plus one self-motion per free joint (a joint that has no pivot and is not idle). With one free
 * joint, a ratio test gives the optimum. With several, polytope.c computes it. Rows are padded to 8 or 16 numbers, so
 * that the compiler unrolls the loops over a row. */
#include "vec.h"

#define RANK_TOLERANCE 1e-12 /* largest (singular value of A) / |A|_F that counts as zero */
#define TIED 1e-7            /* the same for the sixth singular value, which is zero for a rigid tool */
#define LOOK_CLOSER 1e3      /* own_part finds the rank if pivot / (first pivot) <= this * RANK_TOLERANCE (or TIED) */
#define LEFT 1e-6            /* largest allowed |A x - b| of a result [m/s] */
#define SOUND 1e-6           /* if the last pivot is smaller, the result is checked [m] */
#define UNBALANCED 1e-4      /* largest allowed |A^T y - force| / max(c2 |pull|, rho) of a result */
#define IDLE 1e-12           /* a joint is idle (moves neither tip nor wrist) if its eliminated column is not larger */
#define ROUNDING 1e-9        /* an idle joint's pull below this share of the largest pull counts as zero */
#define GROWTH 4e-12         /* assumed bound on the relative rounding error of the elimination */
#define WIDEST 1e-5          /* largest tolerance of moc_solve_eliminated's second solve [rad/s] */
#define UNCLEAR 1e-3         /* the same for its third solve [rad/s] */
#define SLIVER 2e-9          /* least assumed rounding error with several free joints [rad/s] */

/* g are multipliers of the rows after `steps` elimination steps. Turn them into multipliers of A's rows. */
static inline void weigh_back(const moc_plane *plane, int steps, double g[6])
{
    for (int k = steps - 1; k >= 0; k--) {
        double own = -plane->inverse[k] * dot(6, plane->scale[k], g);
        g[k] = g[plane->from[k]];
        g[plane->from[k]] = own;
    }
}

/* Estimate the (k + 1)-th largest singular value of A, divided by |A|_F. A row that is left after k steps is e^T A,
 * with weights e. Returns the largest |e^T A| / (|e| |A|_F), which is at most 4 * (next pivot) / (first pivot). */
static double own_part(const moc_plane *plane, int n, double A[][MOC_MAX_JOINTS], int k)
{
    double most = 0.0, size = 0.0;
    for (int i = 0; i < 6; i++)
        size += dot(n, A[i], A[i]);
    for (int i = k; i < 6; i++) {
        double e[6] = {0.0};
        e[i] = 1.0;
        weigh_back(plane, k, e);
        most = larger(dot(n, plane->row[i], plane->row[i]) / (size * dot(6, e, e)), most);
    }
    return sqrt(most);
}

/* Returns the rank of A, or -1 - k if the rank may be k or higher. m: padded row length. */
static inline int eliminate(moc_plane *plane, int n, double A[][MOC_MAX_JOINTS], int m)
{
    double first = plane->pivot = HUGE_VAL;
    for (int i = 0; i < 6; i++)
        for (int c = 0; c < m; c++)
            plane->row[i][c] = c < n ? A[i][c] : 0.0;
    for (int k = 0; k < 6; k++) {
        double largest[MOC_MAX_JOINTS], pivot_row[MOC_MAX_JOINTS];
        int best[MOC_MAX_JOINTS], pivot = k;

        for (int c = 0; c < m; c++) {
            best[c] = c;
            largest[c] = fabs(plane->row[k][c]);
        }
        for (int i = k + 1; i < 6; i++)
            for (int c = 0; c < m; c++)
                largest[c] = larger(largest[c], fabs(plane->row[i][c]));
        for (int half = m / 2; half > 0; half /= 2) /* comparing in pairs is faster than in sequence */
            for (int c = 0; c < half; c++) {
                best[c] = largest[c + half] > largest[c] ? best[c + half] : best[c];
                largest[c] = larger(largest[c + half], largest[c]);
            }
        double size = largest[0];
        int column = best[0];
        first = k == 0 ? size : first;
        double tolerance = k < 5 ? RANK_TOLERANCE : TIED;
        if (!(size > LOOK_CLOSER * tolerance * first)) {
            double own = size > 0.25 * tolerance * first ? own_part(plane, n, A, k) / tolerance : 0.0;
            if (!(own > 10.0))
                return !(own > 1.0) ? k : -1 - k;
        }
        for (int i = k; i < 6; i++)
            pivot = fabs(plane->row[i][column]) >= size ? i : pivot;
        plane->pivot = size;
        plane->joint[k] = column;
        plane->from[k] = pivot;
        /* size = |pivot| is known earlier than the pivot's sign */
        double inverse = plane->inverse[k] = copysign(1.0 / size, plane->row[pivot][column]);
        for (int c = 0; c < m; c++) {
            pivot_row[c] = plane->row[pivot][c] * inverse;
            plane->row[pivot][c] = plane->row[k][c];
        }
        for (int i = 0; i < 6; i++) {
            double scale = plane->scale[k][i] = plane->row[i][column];
            if (i == k)
                continue;
            for (int c = 0; c < m; c++)
                plane->row[i][c] -= scale * pivot_row[c];
        }
        plane->scale[k][k] = -1.0;
        memcpy(plane->row[k], pivot_row, (unsigned)m * sizeof *pivot_row);
    }
    return 6;
}

void moc_eliminate(int n, double A[][MOC_MAX_JOINTS], moc_plane *plane)
{
    int found = n <= 8 ? eliminate(plane, n, A, 8) : eliminate(plane, n, A, 16), idle = n;
    bool taken[MOC_MAX_JOINTS] = {false};

    plane->doubtful = found < 0;
    plane->rank = found < 0 ? -1 - found : found;
    plane->freedoms = 0;
    for (int k = 0; k < plane->rank; k++)
        taken[plane->joint[k]] = true;
    for (int j = 0; j < n; j++) {
        double reach = 0.0;
        if (taken[j])
            continue;
        for (int i = 0; i < plane->rank; i++)
            reach = larger(fabs(plane->row[i][j]), reach);
        plane->joint[reach > IDLE ? plane->rank + plane->freedoms++ : --idle] = j;
    }
}

/* Apply the steps of the elimination to b. */
static void carry_over(const moc_plane *plane, const double b[6], double right[6])
{
    memcpy(right, b, 6 * sizeof *right);
    for (int k = 0; k < plane->rank; k++) {
        double own = right[plane->from[k]] * plane->inverse[k];
        right[plane->from[k]] = right[k];
        right[k] = 0.0;
        for (int i = 0; i < 6; i++)
            right[i] -= plane->scale[k][i] * own;
    }
}

/* Check x in the rows without a pivot. MOC_INFEASIBLE: no x within the bounds meets such a row. */
static moc_status check_dropped(const moc_plane *plane, const moc_problem *p, const double right[6], const double *x)
{
    moc_status status = MOC_OK;
    for (int i = plane->rank; i < 6; i++) {
        double reach = LEFT;
        if (fabs(dot(p->n, plane->row[i], x) - right[i]) <= LEFT)
            continue;
        for (int j = 0; j < p->n; j++)
            reach += fabs(plane->row[i][j]) * larger(fabs(p->lower[j]), fabs(p->upper[j]));
        if (fabs(right[i]) > reach)
            return MOC_INFEASIBLE;
        status = MOC_DOUBTFUL;
    }
    return status;
}

void moc_direction(const moc_plane *plane, int n, int k, double *z)
{
    int free = plane->joint[plane->rank + k];
    for (int j = 0; j < n; j++)
        z[j] = 0.0;
    for (int i = 0; i < plane->rank; i++)
        z[plane->joint[i]] = -plane->row[i][free];
    z[free] = 1.0;
}

static double idle_speed(const moc_problem *p, int j)
{
    /* rounding in pull must not send an idle joint to its bound */
    bool faint = fabs(p->pull[j]) <= ROUNDING * largest_of(p->n, p->pull);
    double pull = faint ? 0.0 : p->c2 * p->pull[j];
    return clip(pull == 0.0 ? 0.0 : pull / p->rho, p->lower[j], p->upper[j]); /* rho = 0: at a bound */
}

/* x + s z is within the bounds for low <= s <= high. joint[0] limits low, and joint[1] limits high. */
typedef struct {
    double low, high;
    int joint[2];
} segment;

static inline segment ratio_test(const moc_problem *p, const double *x, const double *z, double still, double slack)
{
    segment s = {-HUGE_VAL, HUGE_VAL, {0, 0}};
    for (int j = 0; j < p->n; j++)
        if (fabs(z[j]) > still) {
            double lower = p->lower[j] - slack - x[j], upper = p->upper[j] + slack - x[j], inverse = 1.0 / z[j];
            double start = (signbit(z[j]) ? upper : lower) * inverse, end = (signbit(z[j]) ? lower : upper) * inverse;
            s.joint[0] = start > s.low ? j : s.joint[0];
            s.low = larger(start, s.low);
            s.joint[1] = end < s.high ? j : s.joint[1];
            s.high = smaller(end, s.high);
        }
    return s;
}

/* Move x to the best x + s z within the bounds. */
static void solve_one(const moc_plane *plane, const moc_problem *p, double tolerance, double *x, double *force)
{
    double z[MOC_MAX_JOINTS], zz = 0.0, zx = 0.0, zg = 0.0, slope = 0.0;
    int n = p->n;

    moc_direction(plane, n, 0, z);
    for (int j = 0; j < n; j++) {
        zz += z[j] * z[j];
        zx += z[j] * x[j];
        zg += z[j] * p->pull[j];
    }
    double still = STILL * sqrt(zz);
    segment s = ratio_test(p, x, z, still, 0.0);
    /* rounding may make an interval of one point empty: widen the bounds */
    for (double slack = 1e-17; s.low > s.high && slack < tolerance;) {
        slack = smaller(100.0 * slack, tolerance);
        s = ratio_test(p, x, z, still, slack);
    }
    double best = (p->c2 * zg - p->rho * zx) / (p->rho * zz); /* infinite if rho = 0 */
    if (p->c2 * zg == 0.0 && p->rho == 0.0)
        best = -zx / zz; /* every s is optimal: take the shortest x */
    int at_bound = best > s.high ? s.joint[1] : best < s.low ? s.joint[0] : NONE;
    best = clip(best, s.low, s.high);
    for (int j = 0; j < n; j++) {
        x[j] += best * z[j];
        slope += z[j] * (p->rho * x[j] - p->c2 * p->pull[j]);
    }
    if (at_bound != NONE)
        force[at_bound] = slope / z[at_bound];
}

/* Clip `point` to the bounds, add c2 pull - rho x to the bounds' multipliers in `force`, and solve A^T y = force.
 * Returns the largest bound violation of `point` [rad/s]. */
static double finish(const moc_plane *plane, const moc_problem *p, const double *point, double *force, double *x,
                     double y[6])
{
    double beyond = 0.0;
    for (int j = 0; j < p->n; j++) {
        beyond = larger(larger(p->lower[j] - point[j], point[j] - p->upper[j]), beyond);
        x[j] = clip(point[j], p->lower[j], p->upper[j]);
        force[j] += p->c2 * p->pull[j] - p->rho * x[j];
    }
    for (int k = 0; k < 6; k++)
        y[k] = k < plane->rank ? force[plane->joint[k]] : 0.0;
    weigh_back(plane, plane->rank, y);
    return beyond;
}

/* Whether A^T y = force holds for the joints that move tip or wrist. */
static bool balanced(const moc_plane *plane, const moc_problem *p, const double *force, const double y[6])
{
    double most = UNBALANCED * larger(p->c2 * largest_of(p->n, p->pull), p->rho), gap = 0.0;
    for (int k = 0; k < plane->rank + plane->freedoms && fabs(gap) <= most; k++) {
        gap = force[plane->joint[k]];
        for (int i = 0; i < 6; i++)
            gap -= p->A[i][plane->joint[k]] * y[i];
    }
    return fabs(gap) <= most;
}

static moc_status solve(const moc_plane *plane, const moc_problem *p, double tolerance, double *x, double y[6])
{
    double point[MOC_MAX_JOINTS], force[MOC_MAX_JOINTS], right[6];
    moc_status status = MOC_OK;

    if (plane->doubtful)
        return MOC_DOUBTFUL;
    carry_over(plane, p->b, right);
    for (int k = 0; k < p->n; k++) { /* a particular solution */
        int j = plane->joint[k];
        point[j] = k < plane->rank ? right[k] : k < plane->rank + plane->freedoms ? 0.0 : idle_speed(p, j);
        force[j] = 0.0;
    }
    if (plane->freedoms == 1)
        solve_one(plane, p, tolerance, point, force);
    else if (plane->freedoms)
        status = moc_solve_several(plane, p, tolerance, point, force);
    double beyond = finish(plane, p, point, force, x, y);
    if (status == MOC_OK && beyond <= tolerance && (plane->freedoms > 1 || plane->pivot < SOUND) &&
        !(off_plane(p, x) <= LEFT && balanced(plane, p, force, y)))
        status = MOC_DOUBTFUL;
    if (status != MOC_OK)
        return status;
    return beyond > tolerance ? MOC_INFEASIBLE : check_dropped(plane, p, right, x);
}

/* Estimate the bound violation that rounding can cause [rad/s]: GROWTH |A| |x| / (last pivot) for the largest x. */
static double explained_by_rounding(const moc_plane *plane, const moc_problem *p)
{
    double sum[6] = {0.0};
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < p->n; j++)
            sum[i] += fabs(p->A[i][j]) * larger(fabs(p->lower[j]), fabs(p->upper[j]));
    return larger(GROWTH * largest_of(6, sum) / plane->pivot, plane->freedoms > 1 ? SLIVER : 0.0);
}

moc_status moc_solve_eliminated(const moc_plane *plane, const moc_problem *p, double tolerance, double *x, double y[6])
{
    moc_status status = solve(plane, p, tolerance, x, y);
    /* If rounding may have decided the status, solve again with larger tolerances. The first status holds only if the
     * subproblem is infeasible even with the largest tolerance, `unclear`. With several free joints, `unclear` is
     * larger, because columns may be almost parallel. */
    double explained = status == MOC_OK ? 0.0 : explained_by_rounding(plane, p);
    if (explained <= tolerance)
        return status;
    double unclear = smaller((plane->freedoms > 1 ? 1e5 : 100.0) * explained, UNCLEAR);
    if (solve(plane, p, smaller(100.0 * explained, WIDEST), x, y) == MOC_OK && off_plane(p, x) <= LEFT)
        return MOC_OK;
    return solve(plane, p, unclear, x, y) == MOC_INFEASIBLE ? status : MOC_DOUBTFUL;
}

moc_status moc_solve_exact(const moc_problem *p, double tolerance, double *x, double y[6])
{
    moc_plane plane;
    moc_eliminate(p->n, ((moc_problem *)p)->A, &plane); /* moc_eliminate only reads A */
    return moc_solve_eliminated(&plane, p, tolerance, x, y);
}
