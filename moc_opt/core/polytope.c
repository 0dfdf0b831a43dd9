/* The optimum by projection on the feasible set, if ker A has two or more dimensions.
 *
 * Let Pi be the orthogonal projector on ker A, g the vector moc_problem.pull, and x_p the solution of A x = b with
 * Pi x_p = 0. The optimum is the feasible point nearest to x_p + c2 Pi g / rho. The dual active-set method of Goldfarb
 * and Idnani (Math. Programming 27, 1983, algorithm 1) starts there and adds violated bounds one by one. A sweep of Pi
 * on a joint keeps the joint at its bound (Goodnight, The American Statistician 33, 1979). If rho is almost zero, this
 * start is too far away. A proximal point iteration then approaches the optimum (Ferris 1991). */
#include "vec.h"

#define FAR 1e3          /* the start is too far away if |c2 Pi g| / rho >= FAR * (largest upper - lower) */
#define UNMOVED 1e-20    /* joint j cannot move in ker A if Pi_jj is at most this */
#define DEPENDENT 1e-12  /* after sweeps, joint j cannot move if Pi_jj / room_j is at most this */

typedef struct {
    int n, r;                                  /* joints, dimension of ker A */
    double s[MOC_MAX_JOINTS];                  /* x - x_p [rad/s] */
    double low[MOC_MAX_JOINTS], high[MOC_MAX_JOINTS]; /* bounds on s [rad/s] */
    double pull[MOC_MAX_JOINTS];               /* c2 Pi g */
    double side[MOC_MAX_JOINTS];               /* +1 at an active lower bound, -1 at an upper one, 0 elsewhere */
    double force[MOC_MAX_JOINTS];              /* multipliers of the projection [rad/s], positive at a lower bound */
    double room[MOC_MAX_JOINTS];               /* Pi_jj before any sweep */
    double Pi[MOC_MAX_JOINTS][MOC_MAX_JOINTS]; /* swept on the joints with an active bound */
    double Z[MOC_MAX_JOINTS][MOC_MAX_JOINTS];  /* rows: orthonormal basis of ker A, Pi = Z^T Z */
} polytope;

static void fill_projector(polytope *t)
{
    for (int i = 0; i < t->n; i++) {
        double e[MOC_MAX_JOINTS] = {0.0};
        e[i] = 1.0;
        moc_onto(t->n, t->r, t->Z, e, t->Pi[i]);
    }
}

/* With sign 1, sweep Pi on joint p, so that s_p is fixed. Sign -1 undoes the sweep. */
static void sweep(polytope *t, int p, double sign)
{
    double inverse = 1.0 / t->Pi[p][p], row[MOC_MAX_JOINTS];
    memcpy(row, t->Pi[p], (unsigned)t->n * sizeof *row);
    row[p] = -sign;
    for (int i = 0; i < t->n; i++) {
        double scale = t->Pi[i][p] * inverse;
        t->Pi[i][p] = 0.0;
        for (int j = 0; j < t->n; j++)
            t->Pi[i][j] -= scale * row[j];
    }
    for (int j = 0; j < t->n; j++)
        t->Pi[p][j] = sign * inverse * row[j];
}

/* Remove rounding errors from s, which then lies in ker A and on the active bounds. */
static void settle(polytope *t)
{
    moc_onto(t->n, t->r, t->Z, t->s, t->s);
    for (int a = 0; a < t->n; a++) {
        if (t->side[a] == 0.0)
            continue;
        double bound = signbit(t->side[a]) ? t->high[a] : t->low[a], gap = bound - t->s[a];
        for (int j = 0; j < t->n; j++)
            t->s[j] += gap * (1.0 - fabs(t->side[j])) * t->Pi[a][j];
        t->s[a] = bound;
    }
}

static int furthest_out(const polytope *t, double slack)
{
    int joint = NONE;
    for (int j = 0; j < t->n; j++) {
        double beyond = larger(t->low[j] - t->s[j], t->s[j] - t->high[j]);
        if (beyond > slack) {
            slack = beyond;
            joint = j;
        }
    }
    return joint;
}

/* Returns the joint whose multiplier reaches 0 first while that of joint p grows, or NONE. *step: growth until then. */
static int first_to_let_go(const polytope *t, int p, double side, double *step)
{
    int joint = NONE;
    *step = HUGE_VAL;
    for (int j = 0; j < t->n; j++) {
        double fading = side * t->side[j] * t->Pi[p][j];
        if (fading > 1e-12 && fabs(t->force[j]) / fading < *step) {
            *step = fabs(t->force[j]) / fading;
            joint = j;
        }
    }
    return joint;
}

/* Push joint p onto the bound that it violates. Returns false if the active bounds do not permit this. */
static bool push(polytope *t, int p, int *active)
{
    double side = t->s[p] < t->low[p] ? 1.0 : -1.0, bound = signbit(side) ? t->high[p] : t->low[p];
    for (;;) {
        double step, full = HUGE_VAL, gives = t->Pi[p][p];
        int drop = first_to_let_go(t, p, side, &step);
        if (*active < t->r && gives > DEPENDENT * t->room[p])
            full = side * (bound - t->s[p]) / gives;
        else if (drop == NONE)
            return false;
        double length = side * fmin(step, full), move = full < HUGE_VAL ? length : 0.0;
        for (int j = 0; j < t->n; j++) {
            double on = fabs(t->side[j]);
            t->force[j] -= length * on * t->Pi[p][j];
            t->s[j] += move * (1.0 - on) * t->Pi[p][j];
        }
        t->force[p] += length;
        if (full <= step) {
            sweep(t, p, 1.0);
            t->s[p] = bound;
            t->side[p] = side;
            ++*active;
            return true;
        }
        t->force[drop] = t->side[drop] = 0.0;
        --*active;
        sweep(t, drop, -1.0);
    }
}

/* Move s in ker A to the nearest point within the bounds: s - s_start = Pi force. Pi must not be swept on entry. If no
 * point is found, perhaps because of rounding errors, the bounds are widened in growing steps of at most `most`. */
static moc_status project(polytope *t, double slack, double most)
{
    double start[MOC_MAX_JOINTS];
    int active = 0;

    memcpy(start, t->s, sizeof start);
    memset(t->force, 0, sizeof t->force);
    memset(t->side, 0, sizeof t->side);
    for (int round = 0; round < 20 * t->n; round++) {
        int p = furthest_out(t, slack);
        if (p == NONE) {
            settle(t);
            return MOC_OK;
        }
        if (push(t, p, &active))
            continue;
        for (int j = 0; j < t->n; j++) {
            t->low[j] -= slack;
            t->high[j] += slack;
            t->s[j] = start[j];
            t->force[j] = t->side[j] = 0.0;
        }
        fill_projector(t);
        if (!(slack < most))
            return MOC_INFEASIBLE;
        slack = fmin(100.0 * slack, most);
        active = round = 0;
    }
    return MOC_DOUBTFUL;
}

/* Run the proximal point iteration. The last steps have length `base`, and remove the rounding errors of longer steps.
 * Then the bounds' multipliers in the subproblem are (rho + 1 / base) t->force. */
static moc_status approach(polytope *t, double rho, double slack, double most, double base)
{
    static const double scales[] = {1e8, 1e4, 1.0};
    moc_status status = MOC_OK;
    for (int i = 0; i < 3; i++) {
        double step = scales[i] * base, moved = HUGE_VAL;
        for (int round = 0; round < 50 && moved > slack * scales[i]; round++) {
            double before[MOC_MAX_JOINTS];
            memcpy(before, t->s, sizeof before);
            for (int j = 0; j < t->n; j++)
                t->s[j] = (t->s[j] + step * t->pull[j]) / (1.0 + rho * step);
            fill_projector(t);
            status = project(t, slack, most);
            moved = 0.0;
            for (int j = 0; j < t->n; j++) {
                if (status != MOC_OK) /* undo a step that failed through rounding errors */
                    t->s[j] = before[j];
                moved = fmax(moved, fabs(t->s[j] - before[j]));
            }
        }
    }
    return status == MOC_OK ? MOC_OK : MOC_DOUBTFUL;
}

moc_status moc_solve_several(const moc_plane *plane, const moc_problem *p, double tolerance, double *x, double *force)
{
    polytope t = {.n = p->n, .r = plane->freedoms};
    double back[MOC_MAX_JOINTS], widest = 1e-6, weight = p->rho;

    for (int k = 0; k < t.r; k++) {
        moc_direction(plane, t.n, k, t.Z[k]);
        moc_orthonormalise(t.n, t.Z, k, 0.0);
    }
    fill_projector(&t);
    moc_onto(t.n, t.r, t.Z, x, back);
    moc_onto(t.n, t.r, t.Z, p->pull, t.pull);
    for (int j = 0; j < t.n; j++) {
        t.pull[j] *= p->c2;
        t.room[j] = t.Pi[j][j];
        t.low[j] = -HUGE_VAL;
        t.high[j] = HUGE_VAL;
        x[j] -= back[j];
        if (t.room[j] > UNMOVED) {
            t.low[j] = p->lower[j] - x[j];
            t.high[j] = p->upper[j] - x[j];
            widest = fmax(widest, p->upper[j] - p->lower[j]);
        }
    }
    double pull = sqrt(dot(t.n, t.pull, t.pull)), slack = 1e-14 * widest;
    bool direct = pull < FAR * widest * p->rho;
    for (int j = 0; j < t.n; j++)
        t.s[j] = direct ? t.pull[j] / p->rho : 0.0;
    moc_status status = project(&t, slack, 0.1 * tolerance);
    if (!direct && pull > 0.0 && status == MOC_OK) {
        double base = 10.0 * widest / pull;
        weight = p->rho + 1.0 / base;
        status = approach(&t, p->rho, slack, 0.1 * tolerance, base);
    }
    for (int j = 0; j < t.n; j++) {
        x[j] += t.s[j];
        force[j] += weight * t.force[j];
    }
    return status;
}
