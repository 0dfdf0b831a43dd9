/* Functions that the core's files share. Vectors of joints are (n,). The rows of matrices are MOC_MAX_JOINTS apart. */
#ifndef MOC_SHARED_H
#define MOC_SHARED_H

#include <stdbool.h>

#include "moc.h"

#define NONE (-1) /* no joint */

/* --- arm.c, manipulability.c --- */

/* A joint's axes in the world: rotation and origin. */
typedef struct {
    double R[3][3];
    double p[3];    /* [m] */
} moc_frame;

/* Linear (at the world's origin) and angular velocity of a body that one joint moves at unit speed. */
typedef struct {
    double lin[3], ang[3];
} moc_twist;

/* Compute all fields of moc_terms. Returns MOC_OK or MOC_NOT_FINITE. */
moc_status moc_compute_terms(const moc_arm *arm, const double *q, const double *v, moc_terms *terms);

/* Compute frame[n] and twist[n] of the joints at a finite q. moc_kinematics also fills the kinematic terms. */
void moc_place(const moc_arm *arm, const double *q, moc_frame *frame, moc_twist *twist);
void moc_kinematics(const moc_arm *arm, const double *q, moc_frame *frame, moc_twist *twist, moc_terms *terms);

/* Compute the tool's axes x, y, z and its tip in the world. */
void moc_tool_pose(const moc_arm *arm, const double *q, double pose[4][3]);

/* Compute the torque that carries the arm's weight [Nm]. */
void moc_gravity(const moc_arm *arm, const double *q, double *torque);

/* Compute tip or wrist in the world [m] and its Jacobian (3,n), with zero columns for joints that never move it. */
void moc_point(const moc_arm *arm, const moc_frame *frame, const moc_twist *twist, int which, double point[3],
               double J[][MOC_MAX_JOINTS]);

/* The determinant of J J^T, and its inverse times the determinant. */
typedef struct {
    double det, adj[3][3];
    bool regular; /* false if the determinant is only rounding error */
} moc_gram;

moc_gram moc_gram_of(int n, double J[][MOC_MAX_JOINTS]);

/* Return mu of J (3,n) or mu_shaft of A (6,n), and write its gradient (n,). NULL is allowed in moc_manipulability.
 * `gram` belongs to J, and to the first three rows of A. */
double moc_manipulability(int n, const moc_twist *twist, double J[][MOC_MAX_JOINTS], moc_gram *gram, double *gradient);
double moc_shaft_manipulability(int n, const moc_twist *twist, double A[][MOC_MAX_JOINTS], moc_gram *gram,
                                const double u[3], double *gradient);

/* --- record.c --- */

/* Copy a struct to or from its packed record. moc_opt/qp/problem.py and moc_opt/robots/model.py read these records. */
typedef enum { UNPACK, PACK } direction;
void moc_copy_problem(moc_problem *problem, int n, double *record, direction way);
void moc_copy_terms(moc_terms *terms, int n, double *record, direction way);

/* --- law.c, null_space.c --- */

/* Compute the torque of levels 1 and 2 [Nm]. */
void moc_tracking_torque(const moc_law *law, int n, const moc_terms *t, const moc_reference *ref,
                         const moc_trocar *trocar, double *tau);

/* Fill this tick's subproblem. If x_d is not NULL, x follows x_d [rad/s] instead of climbing mu. */
void moc_fill_problem(const moc_law *law, int n, const moc_terms *t, const moc_reference *ref,
                      const moc_trocar *trocar, const double *x_d, moc_problem *problem);

/* tau += share M Z^T (Z M Z^T)^-1 Z (K_N2 (x - v) - D_N2 v), clipped to +-tau_max. */
void moc_add_third_level(const moc_law *law, int n, const moc_terms *t, const moc_memory *memory, const double *x,
                         double *tau);

/* Compute the desired wrist N_d = X + span e and dN_d, with the unit vector e from X to the trocar. */
void moc_desired_wrist(const double X[3], const double dX[3], const moc_trocar *trocar, double span, double N_d[3],
                       double dN_d[3]);

/* Advance the observer of joint i by one period with the torque tau: r = gain (M v - integral(tau + C^T v - g + r)). */
void moc_observe(int n, const moc_terms *t, int i, double tau, double gain, double period, double *integral, double *r);

/* Return the weight of grad mu_shaft in moc_problem.pull, in which grad mu has the weight 1 [m]. */
double moc_shaft_push(double mu_shaft, double margin);

/* Compute the joint velocity x_d of the scaled climb of mu [rad/s]. It is zero at a maximum and at a singularity. */
void moc_climb(const moc_arm *arm, const moc_law *law, const moc_terms *t, moc_memory *memory, double *x_d);

/* Write an orthonormal basis of ker A to Z, and return its number of rows. `rows` is the number of rows of the previous
 * basis in Z. If the new basis has as many rows, it is chosen close to the previous one. */
int moc_null_space(const moc_plane *plane, int n, int rows, double Z[][MOC_MAX_JOINTS]);

/* Make row k of Z orthogonal to the rows before it, and scale it to length 1. Returns false if the orthogonal part is
 * not longer than `least`. */
bool moc_orthonormalise(int n, double Z[][MOC_MAX_JOINTS], int k, double least);

/* Compute the projection part = Z^T Z x with an orthonormal basis Z (rows, n). `part` and `x` may be the same array. */
void moc_onto(int n, int rows, double Z[][MOC_MAX_JOINTS], const double *x, double *part);

/* --- exact.c, polytope.c --- */

#define STILL 1e-10 /* the bounds of joint j are ignored along a unit direction z if |z_j| is smaller */

/* Eliminate A (6,n). */
void moc_eliminate(int n, double A[][MOC_MAX_JOINTS], moc_plane *plane);

/* moc_solve_exact, for a problem whose A was eliminated before. */
moc_status moc_solve_eliminated(const moc_plane *plane, const moc_problem *problem, double tolerance, double *x,
                                double y[6]);

/* Compute the motion z (n,) in ker A in which free joint number k moves by one and the other free joints stay still. */
void moc_direction(const moc_plane *plane, int n, int k, double *z);

/* If several joints are free, move a solution x of A x = b to the optimum. Adds the bounds' multipliers to force. */
moc_status moc_solve_several(const moc_plane *plane, const moc_problem *problem, double tolerance, double *x,
                             double *force);

/* --- answer.c --- */

typedef struct {
    double primal;   /* |A x - b|_inf [m/s]. If x is not finite, all residuals are NaN. */
    double outside;  /* largest bound violation [rad/s] */
    double natural;  /* natural residual along the self-motion, for a cost scaled to a gradient of size 1 [rad/s] */
    double off;      /* distance from the optimum [rad/s] */
    double opposite; /* distance from the optimum of the opposite gradient [rad/s] */
} moc_residuals;

/* Compute the residuals of x. The rows of Z are an orthonormal basis of ker A. */
moc_residuals moc_judge(const moc_problem *problem, int rows, double Z[][MOC_MAX_JOINTS], const double *x);

/* Check an answer and write the x that the third level follows. */
moc_fault moc_supervise(const moc_supervision *s, const moc_problem *problem, const moc_answer *answer,
                        moc_memory *memory, double *x);

/* --- safety_filter.c --- */

/* Start at a finite q and v. They were measured in control period number `stamp`. */
void moc_guard_start(const moc_guard *g, int n, const double *q, const double *v, long long stamp, moc_watch *w);

/* Check a measurement. Afterwards watch->q and watch->v are the believed state. */
moc_stop moc_guard_believe(const moc_guard *g, int n, const moc_measurement *m, moc_watch *w);

/* Check RCM error and trocar force at the believed pose of the tool. */
moc_stop moc_guard_incision(const moc_guard *g, double pose[4][3], const moc_trocar *trocar, const double *wrench,
                            moc_watch *w);

/* Check the tip and the motion, then limit tau in place. t are the terms at watch->q and watch->v. If tip or t is
 * NULL, its check is left out. `before` is the torque of the previous tick. If tau is not finite, it is not changed. */
moc_stop moc_guard_follow(const moc_guard *g, const moc_arm *arm, const moc_terms *t, const double *tip,
                          const double *tip_ref, const double *before, double *tau, moc_watch *w);

/* Compute the torque of a stop. In each tick, it approaches the weight's torque by up to torque_step. */
void moc_guard_rest(const moc_guard *g, const moc_arm *arm, const double *before, const moc_watch *w, double *tau);

/* --- step.c --- */

/* Solve the state's subproblem with moc_solve_exact. Stores x, y and the status in the state. */
moc_answer moc_ask_exact(const moc_controller *c, moc_state *state);

#endif
