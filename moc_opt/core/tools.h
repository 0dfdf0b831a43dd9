/* Functions for Python alone: the network and the planning. They are not part of the exported folder. */
#ifndef MOC_TOOLS_H
#define MOC_TOOLS_H

#include "shared.h"

/* --- rnn.c --- */

/* Settings of the network in rnn.c. */
typedef struct {
    int steps;      /* largest number of steps */
    double h_x, h_y; /* step sizes dt/eps of x and of the multipliers */
    double k;       /* the paper's gain */
    double scale;   /* multiplies c0, c1, c2 and rho */
    int implicit;   /* 1: the multipliers are updated with the new x */
    double rest;    /* stop when no right-hand side is larger [rad/s, m/s] */
} moc_network;

/* Advance x (n,) and y (6,) by *made steps. Returns MOC_OK at rest, MOC_UNFINISHED, or MOC_DOUBTFUL if not finite. */
moc_status moc_step_network(const moc_problem *problem, const moc_network *network, double *x, double y[6], int *made);

/* --- planning (plan.c) --- */

/* An arm, its joint limits, and the targets of its tip and wrist. A joint whose limits are equal is fixed. */
typedef struct {
    const moc_arm *arm;
    const double *low, *high; /* (n,) */
    double target[2][3];      /* tip and wrist [m] */
} plan_task;

/* Find a pose with the tip (points = 1), or tip and wrist (points = 2), at the target by Newton's method from q (n,).
 * `best` may be q. Returns the error of the best pose [m]. */
double plan_place(const plan_task *task, int points, int iterations, const double *q, double *best);

/* Sample the curve of self-motion from q along the unit tangent (n,): arc length s, poses (most, n) and mu. Returns the
 * number of samples. Tip and wrist must leave one freedom. The curve ends at a joint limit, with that joint exactly on
 * it; a curve that returns to its start, up to whole turns, ends with that pose, and *closed is 1. */
int plan_follow(const plan_task *task, const double *q, const double *tangent, double step, int most, double *s,
                double *poses, double *mus, int *closed);

/* Bring q (n,) to the target, then to a local maximum of mu within the limits. Returns mu, or -1 without a pose. */
double plan_ascend(const plan_task *task, double *q);

/* One step of the value function: value[branches][m] of the poses of one time from those of the next time.
 *
 * q (branches, m, n) has the poses, with their slack; NaN: no pose. gain (branches, m) is added at a pose;
 * -inf forbids it. In each branch the poses of the next time are sorted by their joint `sorted`, NaN last. A pose can
 * reach another if no joint turns by more than its step (n,) plus both slacks, and if both have the same branch or
 * branches whose numbers differ in bits of crossing[m] only. price is the cost of a squared step [1/rad^2]. */
typedef struct {
    int branches, m, next, n, sorted;
    const double *q, *slack, *gain;
    const double *q_next, *slack_next, *value_next;
    const double *step;
    const double *crossing; /* integers */
    double price, reach;    /* reach: step plus largest slack_next, of joint `sorted` */
} plan_stage;

void plan_advance(const plan_stage *stage, double *value);

#endif
