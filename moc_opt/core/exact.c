/* The subproblem's optimum by elimination, without iterating towards a tolerance.
 *
 * On A x = b the c0, c1 terms are constant: what is left is rho/2 |x|^2 - c2 pull^T x over the box. Gauss-Jordan
 * with complete pivoting (Golub and Van Loan, Matrix Computations, 3.4.8) writes x = particular + (free joints). Joints
 * whose column is zero (joint 7 under a tool on its axis) move nothing and are solved alone. One freedom that is left,
 * the elbow swivel, is a ratio test in closed form; several are a projection onto a polytope, see polytope.c. The
 * elimination is compiled for rows of 8 and of 16 numbers, padded with zeros: no loop over a row is left then. */
#include "vec.h"

#define RANK_TOLERANCE 1e-12 /* of |A|_F: a singular value below it is rounding */
#define TIED 1e-7            /* the same of the sixth one: that row repeats the others, as a rigid tool makes it do */
#define LOOK_CLOSER 1e3      /* a pivot below this multiple of its tolerance is looked at more closely */
#define LEFT 1e-6            /* |A x - b| that a dropped row may be left with: the judge's primal tolerance [m/s] */
#define SOUND 1e-6           /* a last pivot above it divides rounding into nothing that counts [m] */
#define UNBALANCED 1e-4      /* of the cost's slope, that forces may leave: a tenth of what the judge accepts */
#define IDLE 1e-12           /* a free column smaller than this moves neither tip nor wrist */
#define ROUNDING 1e-9        /* of the largest entry of pull */
#define GROWTH 4e-12         /* 2^14 roundings: what six steps cancel between columns that differ a thousandfold */
#define WIDEST 1e-5          /* of the tolerances that rounding may explain [rad/s] */
#define UNCLEAR 1e-3         /* up to which rounding may explain that there is no answer [rad/s] */
#define SLIVER 2e-9          /* what it explains at the least where self-motions may be all but parallel [rad/s] */

/* Weights g (6,) of the eliminated rows become those of the rows of A: the transposed steps, backwards. */
static void weigh_back(const moc_plane *plane, int steps, double g[6])
{
    for (int k = steps - 1; k >= 0; k--) {
        double own = dot(6, plane->step[k], g);
        g[k] = g[plane->from[k]];
        g[plane->from[k]] = own;
    }
}

/* How much the rows e^T A that are left at step k have of their own, |e^T A| / |e| as a share of |A|_F: the next
 * singular value, roughly. The pivot is at least a quarter of that, and up to a hundred times as much where e is long. */
static double own_part(const moc_plane *plane, const moc_problem *p, int k)
{
    double most = 0.0, size = 0.0;
    for (int i = 0; i < 6; i++)
        size += dot(p->n, p->A[i], p->A[i]);
    for (int i = k; i < 6; i++) {
        double e[6] = {0.0};
        e[i] = 1.0;
        weigh_back(plane, k, e);
        most = larger(dot(p->n, plane->row[i], plane->row[i]) / (size * dot(6, e, e)), most);
    }
    return sqrt(most);
}

/* The rank of A; -1 - rank of the rest where a row is neither repeated nor independent. */
static inline int eliminate(moc_plane *plane, const moc_problem *p, int m)
{
    double first = plane->pivot = HUGE_VAL;
    for (int i = 0; i < 6; i++) {
        for (int c = 0; c < m; c++)
            plane->row[i][c] = c < p->n ? p->A[i][c] : 0.0;
        plane->right[i] = p->b[i];
    }
    for (int k = 0; k < 6; k++) {
        double largest[MOC_MAX_JOINTS], pivot_row[MOC_MAX_JOINTS], size = 0.0;
        int column = 0, pivot = k;

        for (int c = 0; c < m; c++)
            largest[c] = fabs(plane->row[k][c]);
        for (int i = k + 1; i < 6; i++)
            for (int c = 0; c < m; c++)
                largest[c] = larger(fabs(plane->row[i][c]), largest[c]);
        for (int c = 0; c < m; c++) {
            column = largest[c] > size ? c : column;
            size = larger(largest[c], size);
        }
        first = k == 0 ? size : first;
        double tolerance = k < 5 ? RANK_TOLERANCE : TIED;
        if (!(size > LOOK_CLOSER * tolerance * first)) {
            double own = size > 0.25 * tolerance * first ? own_part(plane, p, k) / tolerance : 0.0;
            if (!(own > 10.0))
                return !(own > 1.0) ? k : -1 - k;
        }
        for (int i = k; i < 6; i++)
            pivot = fabs(plane->row[i][column]) == size ? i : pivot;
        plane->pivot = size;
        plane->joint[k] = column;
        plane->from[k] = pivot;
        double inverse = 1.0 / plane->row[pivot][column], pivot_right = plane->right[pivot] * inverse;
        for (int c = 0; c < m; c++) {
            pivot_row[c] = plane->row[pivot][c] * inverse;
            plane->row[pivot][c] = plane->row[k][c];
        }
        plane->right[pivot] = plane->right[k];
        for (int i = 0; i < 6; i++) {
            double scale = plane->row[i][column];
            plane->step[k][i] = -scale * inverse;
            plane->right[i] -= scale * pivot_right;
            for (int c = 0; c < m; c++)
                plane->row[i][c] -= scale * pivot_row[c];
        }
        plane->step[k][k] = inverse;
        plane->right[k] = pivot_right;
        memcpy(plane->row[k], pivot_row, (unsigned)m * sizeof *pivot_row);
    }
    return 6;
}

/* Whether x meets the dropped rows too. One that repeats others with another right-hand side may ask for a velocity
 * that no x of the box has; else it is neither independent nor repeated, and what it allows cannot be told. */
static moc_status check_dropped(const moc_plane *plane, const moc_problem *p, const double *x)
{
    moc_status status = MOC_OK;
    for (int i = plane->rank; i < 6; i++) {
        double reach = LEFT, right = plane->right[i];
        if (fabs(dot(p->n, plane->row[i], x) - right) <= LEFT)
            continue;
        for (int j = 0; j < p->n; j++)
            reach += fabs(plane->row[i][j]) * larger(fabs(p->lower[j]), fabs(p->upper[j]));
        if (fabs(right) > reach)
            return MOC_INFEASIBLE;
        status = MOC_DOUBTFUL;
    }
    return status;
}

bool moc_eliminate(moc_plane *plane, const moc_problem *p)
{
    int found = p->n <= 8 ? eliminate(plane, p, 8) : eliminate(plane, p, 16), next;
    bool taken[MOC_MAX_JOINTS] = {false};

    next = plane->rank = found < 0 ? -1 - found : found;
    for (int k = 0; k < plane->rank; k++)
        taken[plane->joint[k]] = true;
    for (int j = 0; j < p->n; j++)
        if (!taken[j])
            plane->joint[next++] = j;
    return found >= 0;
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

/* Where the cost alone takes a joint that moves neither tip nor wrist. */
static double idle_speed(const moc_problem *p, int j)
{
    /* a gradient at rounding level must not throw an idle joint to its bound */
    bool faint = fabs(p->pull[j]) <= ROUNDING * largest_of(p->n, p->pull);
    double pull = faint ? 0.0 : p->c2 * p->pull[j];
    return clip(pull == 0.0 ? 0.0 : pull / p->rho, p->lower[j], p->upper[j]); /* without rho at a bound */
}

/* The ends of the s for which x + s z leaves no bound by more than the slack, and the joints that stop it there. */
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

/* One freedom, x + s z: the best point of that interval, in closed form. */
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
    /* Rounding may empty an interval that is a point. Where it stays empty, `finish` finds x out of its box. */
    for (double slack = 1e-17; s.low > s.high && slack < tolerance;) {
        slack = fmin(100.0 * slack, tolerance);
        s = ratio_test(p, x, z, still, slack);
    }
    double best = (p->c2 * zg - p->rho * zx) / (p->rho * zz); /* without rho beyond one of the ends */
    if (p->c2 * zg == 0.0 && p->rho == 0.0)
        best = -zx / zz; /* every point is optimal: the slowest one */
    int at_bound = best > s.high ? s.joint[1] : best < s.low ? s.joint[0] : NONE;
    best = clip(best, s.low, s.high);
    for (int j = 0; j < n; j++) {
        x[j] += best * z[j];
        slope += z[j] * (p->rho * x[j] - p->c2 * p->pull[j]);
    }
    if (at_bound != NONE)
        force[at_bound] = slope / z[at_bound];
}

/* Put x into its box, and write y: A^T y = force - (rho x - c2 pull). Returns by how much x was outside [rad/s]. */
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

/* Whether A^T y = force, for the joints that move. */
static bool balanced(const moc_plane *plane, const moc_problem *p, const double *force, const double y[6])
{
    double most = UNBALANCED * fmax(p->c2 * largest_of(p->n, p->pull), p->rho), gap = 0.0;
    for (int k = 0; k < plane->rank + plane->freedoms && fabs(gap) <= most; k++) {
        gap = force[plane->joint[k]];
        for (int i = 0; i < 6; i++)
            gap -= p->A[i][plane->joint[k]] * y[i];
    }
    return fabs(gap) <= most;
}

/* With one tolerance. */
static moc_status solve(moc_plane *plane, const moc_problem *p, double tolerance, double *x, double y[6])
{
    double point[MOC_MAX_JOINTS], force[MOC_MAX_JOINTS];
    moc_status status = MOC_OK;

    plane->freedoms = 0;
    if (!moc_eliminate(plane, p))
        return MOC_DOUBTFUL;
    for (int k = 0; k < p->n; k++) { /* a particular solution */
        point[plane->joint[k]] = k < plane->rank ? plane->right[k] : 0.0;
        force[k] = 0.0;
    }
    for (int k = plane->rank; k < p->n; k++) {
        int j = plane->joint[k];
        double reach = 0.0;
        for (int i = 0; i < plane->rank; i++)
            reach = larger(fabs(plane->row[i][j]), reach);
        if (reach > IDLE)
            plane->joint[plane->rank + plane->freedoms++] = j;
        else
            point[j] = idle_speed(p, j);
    }
    if (plane->freedoms == 1)
        solve_one(plane, p, tolerance, point, force);
    else if (plane->freedoms)
        status = moc_solve_several(plane, p, tolerance, point, force);
    double beyond = finish(plane, p, point, force, x, y);
    if (status == MOC_OK && beyond <= tolerance && (plane->freedoms > 1 || plane->pivot < SOUND) &&
        !(off_plane(p, x) <= LEFT && balanced(plane, p, force, y)))
        status = MOC_DOUBTFUL; /* as with parallel columns, of which rounding alone makes a freedom */
    if (status != MOC_OK)
        return status;
    return beyond > tolerance ? MOC_INFEASIBLE : check_dropped(plane, p, x);
}

/* How far rounding of A x = b may put a joint out of its box [rad/s]: a rounding error of the largest |A| |x| in the
 * box, divided by the last pivot. */
static double explained_by_rounding(const moc_plane *plane, const moc_problem *p)
{
    double sum[6] = {0.0};
    for (int i = 0; i < 6; i++)
        for (int j = 0; j < p->n; j++)
            sum[i] += fabs(p->A[i][j]) * larger(fabs(p->lower[j]), fabs(p->upper[j]));
    return larger(GROWTH * largest_of(6, sum) / plane->pivot, plane->freedoms > 1 ? SLIVER : 0.0);
}

moc_status moc_solve_exact(const moc_problem *p, double tolerance, double *x, double y[6])
{
    moc_plane plane;
    moc_status status = solve(&plane, p, tolerance, x, y);

    /* Where rounding may have decided it, the tolerance on the way is raised to what rounding explains; the answer lies
     * in its box all the same, and has to meet A x = b to within LEFT. */
    double explained = status == MOC_OK ? 0.0 : explained_by_rounding(&plane, p);
    if (explained <= tolerance)
        return status;
    double unclear = fmin((plane.freedoms > 1 ? 1e5 : 100.0) * explained, UNCLEAR); /* parallel ones multiply it */
    if (solve(&plane, p, fmin(100.0 * explained, WIDEST), x, y) == MOC_OK && off_plane(p, x) <= LEFT)
        return MOC_OK;
    return solve(&plane, p, unclear, x, y) == MOC_INFEASIBLE ? status : MOC_DOUBTFUL;
}
