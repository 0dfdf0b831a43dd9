/* Functions that the core's files share. Matrices have rows of MOC_MAX_JOINTS numbers. */
#ifndef MOC_SHARED_H
#define MOC_SHARED_H

#include <stdbool.h>

#include "moc.h"

#define NONE (-1) /* no joint */

/* --- arm.c, manipulability.c --- */

/* A joint's axes in the world. */
typedef struct {
    double R[3][3]; /* rotation from the joint's axes to the world's */
    double p[3];    /* origin [m] */
} moc_frame;

/* A body's velocity: linear (at the world's origin) and angular. In twist[j], only joint j moves, at speed 1. */
typedef struct {
    double lin[3], ang[3];
} moc_twist;

/* Compute all terms at (q, v). Returns MOC_NOT_FINITE if q or v is not finite. */
moc_status moc_compute_terms(const moc_arm *arm, const double *q, const double *v, moc_terms *terms);

/* Compute frame and twist (n,) at a finite q. moc_kinematics also fills the kinematic terms that do not depend on v. */
void moc_place(const moc_arm *arm, const double *q, moc_frame *frame, moc_twist *twist);
void moc_kinematics(const moc_arm *arm, const double *q, moc_frame *frame, moc_twist *twist, moc_terms *terms);

/* Compute moc_terms.pose. */
void moc_tool_pose(const moc_arm *arm, const double *q, double pose[4][3]);

/* Compute the gravity torque g [Nm]. */
void moc_gravity(const moc_arm *arm, const double *q, double *torque);

/* Compute position [m] and Jacobian (3,n) of a point in the world. `which` is MOC_TIP or MOC_WRIST. */
void moc_point(const moc_arm *arm, const moc_frame *frame, const moc_twist *twist, int which, double point[3],
               double J[][MOC_MAX_JOINTS]);

/* Determinant and adjugate of J J^T. */
typedef struct {
    double det, adj[3][3];
    bool regular; /* false: J is singular up to rounding errors */
} moc_gram;

moc_gram moc_gram_of(int n, double J[][MOC_MAX_JOINTS]);

/* Return mu or mu_shaft, and write its gradient (n,), which is zero at a singularity. *gram is moc_gram_of(n, J)
 * or, for mu_shaft, moc_gram_of(n, A). Only moc_manipulability accepts NULL as `gradient`. */
double moc_manipulability(int n, const moc_twist *twist, double J[][MOC_MAX_JOINTS], moc_gram *gram, double *gradient);
double moc_shaft_manipulability(int n, const moc_twist *twist, double A[][MOC_MAX_JOINTS], moc_gram *gram,
                                const double u[3], double *gradient);

/* --- record.c --- */

/* PACK copies a struct to its record, UNPACK copies a record to its struct. A record is an array of the struct's
 * numbers, without unused joints. qp/problem.py and robots/model.py read records. */
typedef enum { UNPACK, PACK } direction;
void moc_copy_problem(moc_problem *problem, int n, double *record, direction way);
void moc_copy_terms(moc_terms *terms, int n, double *record, direction way);

/* --- law.c, null_space.c --- */

/* Compute the torque of levels 1 and 2, including the bias torque h [Nm]. */
void moc_tracking_torque(const moc_law *law, int n, const moc_terms *t, const moc_reference *ref,
                         const moc_trocar *trocar, double *tau);

/* Fill the subproblem. If x_d is NULL, its optimum raises mu. Else the optimum is the feasible x nearest to x_d. */
void moc_fill_problem(const moc_law *law, int n, const moc_terms *t, const moc_reference *ref,
                      const moc_trocar *trocar, const double *x_d, moc_problem *problem);

/* Add the torque of level 3 to tau, then clip tau to +-tau_max. */
void moc_add_third_level(const moc_law *law, int n, const moc_terms *t, const moc_memory *memory, const double *x,
                         double *tau);

/* Compute N_d = X + span * e and its velocity dN_d, with the unit vector e from X to the trocar. */
void moc_desired_wrist(const double X[3], const double dX[3], const moc_trocar *trocar, double span, double N_d[3],
                       double dN_d[3]);

/* Advance the observer of joint i by one period: r = gain ((M v)_i - integral(tau + (C^T v)_i - g_i + r)). */
void moc_observe(int n, const moc_terms *t, int i, double tau, double gain, double period, double *integral, double *r);

/* Return the factor of grad_mu_shaft in moc_problem.pull [m]. */
double moc_shaft_push(double mu_shaft, double margin);

/* Compute the x_d in ker A that raises mu by scaled Newton steps [rad/s]. */
void moc_climb(const moc_arm *arm, const moc_law *law, const moc_terms *t, moc_memory *memory, double *x_d);

/* Replace Z (rows, n) by an orthonormal basis of ker A near Z. Returns the new number of rows. */
int moc_null_space(const moc_plane *plane, int n, int rows, double Z[][MOC_MAX_JOINTS]);

/* Make row k of Z orthonormal to the rows before. Returns false if its orthogonal part is not longer than `least`. */
bool moc_orthonormalise(int n, double Z[][MOC_MAX_JOINTS], int k, double least);

/* Project x on the rows of Z: part = Z^T Z x. `part` and `x` may be the same array. */
void moc_onto(int n, int rows, double Z[][MOC_MAX_JOINTS], const double *x, double *part);

/* --- exact.c, polytope.c --- */

#define STILL 1e-10 /* a motion along the unit vector z does not move joint j if |z_j| is below this */

/* The two halves of moc_solve_exact. */
void moc_eliminate(int n, double A[][MOC_MAX_JOINTS], moc_plane *plane);
moc_status moc_solve_eliminated(const moc_plane *plane, const moc_problem *problem, double tolerance, double *x,
                                double y[6]);

/* Compute the z (n,) in ker A that is 1 at the k-th free joint (see exact.c) and 0 at the other free joints. */
void moc_direction(const moc_plane *plane, int n, int k, double *z);

/* With several free joints, move a solution x of A x = b to the optimum, and add the bounds' multipliers to force. */
moc_status moc_solve_several(const moc_plane *plane, const moc_problem *problem, double tolerance, double *x,
                             double *force);

/* --- answer.c --- */

typedef struct {
    double primal;   /* |A x - b|_inf [m/s]; NaN if x is not finite */
    double outside;  /* largest bound violation [rad/s] */
    double natural;  /* the smaller of: scaled slope of the cost in ker A, distance downhill to a bound; 0 at optimum */
    double off;      /* distance in ker A from the optimum [rad/s] */
    double opposite; /* the same for the optimum with -pull [rad/s] */
} moc_residuals;

/* Compute the residuals of x. Z (rows, n) is an orthonormal basis of ker A. */
moc_residuals moc_judge(const moc_problem *problem, int rows, double Z[][MOC_MAX_JOINTS], const double *x);

/* Check an answer. x (n,) becomes the answer or its replacement. */
moc_fault moc_supervise(const moc_supervision *s, const moc_problem *problem, const moc_answer *answer,
                        moc_memory *memory, double *x);

/* --- safety_filter.c --- */

/* Start at a finite q and v, measured in control period `stamp`. */
void moc_guard_start(const moc_guard *g, int n, const double *q, const double *v, long long stamp, moc_watch *w);

/* Check a measurement. w->q and w->v become the measured state or, if it is refused, an extrapolated state. */
moc_stop moc_guard_believe(const moc_guard *g, int n, const moc_measurement *m, moc_watch *w);

/* Check the RCM error and the trocar's force. */
moc_stop moc_guard_incision(const moc_guard *g, double pose[4][3], const moc_trocar *trocar, const double *wrench,
                            moc_watch *w);

/* Check the tip's error, and whether the previous torque `before` explains the motion. If tau is finite, limit it in
 * place. t: terms at w->q, w->v. If tip is NULL, the tip is not checked. If t is NULL, the motion is not checked. */
moc_stop moc_guard_follow(const moc_guard *g, const moc_arm *arm, const moc_terms *t, const double *tip,
                          const double *tip_ref, const double *before, double *tau, moc_watch *w);

/* Compute the torque in a stop: from `before` towards the gravity torque (0 if w->cut), by at most torque_step. */
void moc_guard_rest(const moc_guard *g, const moc_arm *arm, const double *before, const moc_watch *w, double *tau);

/* --- step.c --- */

/* Solve state->problem exactly. Its A is already eliminated in state->plane. */
moc_answer moc_ask_exact(const moc_controller *c, moc_state *state);

#endif
