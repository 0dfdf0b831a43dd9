/* What Python needs of the core beside the controller; no part of the exported folder. */
#ifndef MOC_TOOLS_H
#define MOC_TOOLS_H

#include "shared.h"

/* --- rnn.c --- */

/* How the network of rnn.c steps. */
typedef struct {
    int steps;      /* at most so many */
    double h_x, h_y; /* step sizes of x and of the multipliers, dt/eps */
    double k;       /* the paper's gain */
    double scale;   /* multiplies c0, c1, c2 and rho */
    int implicit;   /* 1: the multipliers see the new x */
    double rest;    /* it ends where its right-hand side is at most this [rad/s, m/s] */
} moc_network;

/* Advance x (n,) and y (6,) in place. Returns MOC_OK at rest, MOC_UNFINISHED, or MOC_DOUBTFUL where a number is no
 * longer finite; *made is the number of steps. */
moc_status moc_step_network(const moc_problem *problem, const moc_network *network, double *x, double y[6], int *made);

/* --- planning (plan.c) --- */

/* An arm inside its limits, with a tip and a wrist that it has to keep. A joint whose limits are equal stands still. */
typedef struct {
    const moc_arm *arm;
    const double *low, *high; /* (n,) */
    double target[2][3];      /* tip and wrist [m] */
} plan_task;

/* Newton's method for a pose with the tip (points = 1), or tip and wrist (points = 2), at the target; q (n,) is where
 * it begins, and may be the best pose. Returns what the best pose misses by [m]. */
double plan_place(const plan_task *task, int points, int iterations, const double *q, double *best);

/* Samples s, poses (most, n) and mu of the curve from q on along the unit tangent (n,); returns how many. One joint
 * more than tip and wrist fix may move. At a joint limit the curve ends with that joint set to it; a curve that returns
 * to its start, up to whole turns, is closed with that pose. */
int plan_follow(const plan_task *task, const double *q, const double *tangent, double step, int most, double *s,
                double *poses, double *mus, int *closed);

/* Place q (n,) and climb to a local maximum of mu inside the limits, in place; returns mu, -1 where it has no pose. */
double plan_ascend(const plan_task *task, double *q);

/* What the poses of one time are worth by those of the time next to it, value[branches][m].
 *
 * Poses q (branches, m, n) with slack, NaN where there is none; gain (branches, m): what a pose adds, -inf: forbidden.
 * Those of the next time stand in the order of their joint `sorted`, branch by branch, those of NaN at the end. A pose
 * is next to another where no joint turns by more than its step (n,) and both slacks; in its own branch, or in one whose
 * number differs in bits of crossing[m]. price: of a step's square [1/rad^2]. */
typedef struct {
    int branches, m, next, n, sorted;
    const double *q, *slack, *gain;
    const double *q_next, *slack_next, *value_next;
    const double *step;
    const double *crossing; /* whole numbers */
    double price, reach;    /* reach: step and largest slack_next of joint `sorted` */
} plan_stage;

void plan_advance(const plan_stage *stage, double *value);

#endif
