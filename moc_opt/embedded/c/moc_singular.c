#include "moc_singular.h"

#include <math.h>
#include <stddef.h>

#include "moc_dense.h"
#include "moc_subproblem.h"
#include "moc_tick.h"

#define IDLE 1e-14     /* a free column smaller than this moves neither tip nor wrist */
#define IMMOBILE 1e-26 /* square of how far a joint goes on a unit step: below it, it does not */
#define PARALLEL 1e-12 /* two bounds whose lines cross at a smaller angle have no corner */
#define SLACK 1e-14    /* of the box's width: rounding of a point on a bound */
#define ROUNDING 1e-9  /* of the largest entry of grad_mu: no gradient for an idle joint */
#define LEFT 1e-6      /* |A x - b| that a dropped row may be left with [m/s] */

/* The points base + along0 w0 + along1 w1, their bounds, and the cost weight/2 |w|^2 - pull . w. */
typedef struct {
    double along[2 * MOC_N];
    double low[MOC_N], high[MOC_N];
    double pull[2], weight;
    double best[2], least;
    int found;
} polygon;

/* Take the point (u, v) for the best one where it is inside and costs less. */
static void consider(polygon *p, double u, double v, double slack)
{
    for (int j = 0; j < MOC_N; j++) {
        double s = p->along[j] * u + p->along[MOC_N + j] * v;
        if (!(s >= p->low[j] - slack && s <= p->high[j] + slack))
            return;
    }
    double cost = 0.5 * p->weight * (u * u + v * v) - p->pull[0] * u - p->pull[1] * v;
    if (!p->found || cost < p->least) {
        p->best[0] = u;
        p->best[1] = v;
        p->least = cost;
        p->found = 1;
    }
}

/* Bound number `side` of joint j as the line (x, y) . w = c; returns 0 where the joint does not move. */
static int bound(const polygon *p, int j, int side, double *x, double *y, double *c)
{
    *x = p->along[j];
    *y = p->along[MOC_N + j];
    *c = side ? p->high[j] : p->low[j];
    return *x * *x + *y * *y > IMMOBILE;
}

static void look_at_every_corner(polygon *p, double slack)
{
    double x, y, c, other_x, other_y, other_c;

    if (p->weight > 0.0)
        consider(p, p->pull[0] / p->weight, p->pull[1] / p->weight, slack);
    for (int one = 0; one < 2 * MOC_N; one++) {
        if (!bound(p, one / 2, one % 2, &x, &y, &c))
            continue;
        double square = x * x + y * y;
        if (p->weight > 0.0) {
            double u = p->pull[0] / p->weight, v = p->pull[1] / p->weight, gap = (c - x * u - y * v) / square;
            consider(p, u + gap * x, v + gap * y, slack);
        }
        for (int two = 0; two < one - one % 2; two++) {
            if (!bound(p, two / 2, two % 2, &other_x, &other_y, &other_c))
                continue;
            double det = x * other_y - y * other_x;
            if (det * det > PARALLEL * PARALLEL * square * (other_x * other_x + other_y * other_y))
                consider(p, (c * other_y - other_c * y) / det, (x * other_c - other_x * c) / det, slack);
        }
    }
}

/* Whether a dropped row asks for a velocity that no x in the box has, or (x given) that this x has not. */
static int left_over(const moc_plane *plane, const double *record, const double *x)
{
    int open[6] = {1, 1, 1, 1, 1, 1}, wrong = 0;
    for (int k = 0; k < plane->rank; k++)
        open[plane->pivot[k]] = 0;
    for (int i = 0; i < 6; i++) {
        double gap = -plane->b[i], reach = LEFT;
        for (int j = 0; j < MOC_N; j++) {
            double entry = plane->W[i * MOC_N + j];
            gap += x ? entry * x[j] : 0.0;
            reach += fabs(entry) * fmax(fabs(record[MOC_LOWER + j]), fabs(record[MOC_UPPER + j]));
        }
        wrong |= open[i] && fabs(gap) > (x ? LEFT : reach);
    }
    return wrong;
}

/* An idle joint goes where the cost alone takes it. */
static double idle(const double *record, int j, double steepest)
{
    double rho = record[MOC_RHO], grad = record[MOC_GRAD + j];
    double pull = fabs(grad) > ROUNDING * steepest ? record[MOC_C2] * grad : 0.0;
    double desired = 0.0;
    if (rho > 0.0)
        desired = pull / rho;
    else if (pull > 0.0 || pull < 0.0)
        desired = pull > 0.0 ? HUGE_VAL : -HUGE_VAL;
    return fmin(fmax(desired, record[MOC_LOWER + j]), record[MOC_UPPER + j]);
}

/* Fill in the polygon around the shortest point of the plane, which x (n,) becomes. */
static void lay_out(polygon *p, const double *record, double *x)
{
    double rho = record[MOC_RHO];
    for (int k = 0; k < 2; k++) {
        const double *along = p->along + k * MOC_N;
        double back = moc_dot(MOC_N, along, x);
        for (int j = 0; j < MOC_N; j++)
            x[j] -= back * along[j];
        p->pull[k] = record[MOC_C2] * moc_dot(MOC_N, along, record + MOC_GRAD);
    }
    for (int j = 0; j < MOC_N; j++) {
        double x2 = p->along[j] * p->along[j] + p->along[MOC_N + j] * p->along[MOC_N + j];
        p->low[j] = x2 > IMMOBILE ? record[MOC_LOWER + j] - x[j] : -HUGE_VAL;
        p->high[j] = x2 > IMMOBILE ? record[MOC_UPPER + j] - x[j] : HUGE_VAL;
    }
    int flat = !(fabs(p->pull[0]) > 0.0 || fabs(p->pull[1]) > 0.0);
    p->weight = rho > 0.0 || !flat ? rho : 1.0; /* nothing to gain anywhere: the shortest motion */
}

int moc_singular_answer(const moc_plane *plane, const double *record, double *x)
{
    polygon p = {.found = 0};
    double steepest = 0.0, width = 1.0, motion[MOC_N], free_x[MOC_N] = {0.0};
    int freedoms = 0;

    for (int j = 0; j < MOC_N; j++) {
        x[j] = 0.0;
        steepest = fmax(steepest, fabs(record[MOC_GRAD + j]));
        width = fmax(width, record[MOC_UPPER + j] - record[MOC_LOWER + j]);
    }
    if (!plane->certain)
        return MOC_TICK_SINGULAR;
    if (left_over(plane, record, NULL))
        return MOC_TICK_INFEASIBLE;
    for (int f = 0; f < MOC_N - plane->rank; f++) {
        int joint = plane->joint[plane->rank + f], moves = 0;
        moc_direction(plane, f, motion);
        for (int j = 0; j < MOC_N; j++)
            moves |= j != joint && fabs(motion[j]) > IDLE;
        if (!moves)
            free_x[joint] = idle(record, joint, steepest);
        else if (freedoms++ < 2)
            for (int j = 0; j < MOC_N; j++)
                p.along[(freedoms - 1) * MOC_N + j] = motion[j];
    }
    if (freedoms != 2)
        return MOC_TICK_SINGULAR;
    for (int k = 0; k < plane->rank; k++)
        x[plane->joint[k]] = plane->b[plane->pivot[k]];
    moc_orthonormalise(2, p.along);
    lay_out(&p, record, x);
    look_at_every_corner(&p, SLACK * width);
    if (!p.found)
        look_at_every_corner(&p, 0.1 * MOC_TOLERANCE);
    if (!p.found)
        return MOC_TICK_INFEASIBLE;
    for (int j = 0; j < MOC_N; j++) {
        x[j] += p.along[j] * p.best[0] + p.along[MOC_N + j] * p.best[1] + free_x[j];
        x[j] = fmin(fmax(x[j], record[MOC_LOWER + j]), record[MOC_UPPER + j]);
    }
    return left_over(plane, record, x) ? MOC_TICK_SINGULAR : MOC_TICK_OK;
}
