/* Functions that only Python calls: neural network and planning. */
#ifndef MOC_TOOLS_H
#define MOC_TOOLS_H

#include "shared.h"

/* --- rnn.c --- */

typedef struct {
    int steps;       /* largest number of steps */
    double h_x, h_y; /* step sizes of x and y: time step dt / time constant eps */
    double k;        /* gain k of Su et al. 2019 */
    double scale;    /* multiplies c0, c1, c2 and rho */
    int implicit;    /* 1: y is updated with the new x */
    double rest;     /* largest eps |dx_j/dt| [rad/s] and eps |dy_i/dt| [m/s] at rest */
} moc_network;

/* Advance x (n,) and y (6,) in place until both rest. *made is the number of steps. Returns MOC_OK at rest,
 * MOC_DOUBTFUL if x or y is not finite, else MOC_UNFINISHED. */
moc_status moc_step_network(const moc_problem *problem, const moc_network *network, double *x, double y[6], int *made);

/* --- plan.c --- */

/* A joint with equal limits is fixed. */
typedef struct {
    const moc_arm *arm;
    const double *low, *high; /* (n,) */
    double target[2][3];      /* tip and wrist [m] */
} plan_task;

/* Search from q (n,) for a pose with tip (points = 1), or tip and wrist (2), at the target. Returns the largest
 * component of the position errors at `best` [m]. `best` may be `q`. */
double plan_place(const plan_task *task, int points, int iterations, const double *q, double *best);

/* Sample the curve of self-motion from q along the unit tangent (n,): arc length s, poses (most, n), mu. The arm must
 * have one freedom of self-motion. The curve ends at a joint limit, back at the start (*closed = 1), or after `most`
 * samples. Returns the number of samples. */
int plan_follow(const plan_task *task, const double *q, const double *tangent, double step, int most, double *s,
                double *poses, double *mus, int *closed);

/* Bring q (n,) to the target, then to a local maximum of mu. Returns mu, or -1 on failure. */
double plan_ascend(const plan_task *task, double *q);

/* One step of dynamic programming: value (branches, m) = gain + max(value_next - price |motion|^2) over the next poses.
 *
 * q (branches, m, n): poses, NaN where there is none. q_next (branches, next, n): next poses, sorted in each branch by
 * joint `sorted`, with NaN last. gain (branches, m): a pose's reward or -inf. Joint j moves by at most step[j] plus the
 * slacks of both poses, in slack (like q) and slack_next (like q_next). The bit mask crossing[k] belongs to the k-th
 * pose of every branch: a change from branch a to b is allowed if a ^ b has only bits of the mask. */
typedef struct {
    int branches, m, next, n, sorted;
    const double *q, *slack, *gain;
    const double *q_next, *slack_next, *value_next;
    const double *step, *crossing; /* crossing: integers */
    double price;           /* cost of squared motion [1/rad^2] */
    double reach;           /* joint `sorted`: step plus the largest slack_next [rad] */
} plan_stage;

void plan_advance(const plan_stage *stage, double *value);

#endif
