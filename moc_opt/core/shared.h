/* What the files of the core share; moc.h is the interface. Vectors of joints are (n,), rows have MOC_MAX_JOINTS. */
#ifndef MOC_SHARED_H
#define MOC_SHARED_H

#include <stdbool.h>

#include "moc.h"

#define NONE (-1) /* no joint */

/* --- arm.c, manipulability.c --- */

/* Where a joint's axes are in the world. */
typedef struct {
    double R[3][3]; /* rows */
    double p[3];    /* [m] */
} moc_frame;

/* Velocity that a unit speed of one joint gives, at the world's origin. */
typedef struct {
    double lin[3], ang[3];
} moc_twist;

/* All terms. Returns MOC_OK or MOC_NOT_FINITE. */
moc_status moc_compute_terms(const moc_arm *arm, const double *q, const double *v, moc_terms *terms);

/* Every joint's axes in the world, frame[n], and its twist[n]; of the terms what needs no velocity, at a finite q. */
void moc_place(const moc_arm *arm, const double *q, moc_frame *frame, moc_twist *twist);
void moc_kinematics(const moc_arm *arm, const double *q, moc_frame *frame, moc_twist *twist, moc_terms *terms);

/* The tool's axes x, y, z and its tip in the world. */
void moc_tool_pose(const moc_arm *arm, const double *q, double pose[4][3]);

/* Torque that carries the arm's weight [Nm]. */
void moc_gravity(const moc_arm *arm, const double *q, double *torque);

/* Tip or wrist in the world [m], and its Jacobian (3,n): zeros for joints that never move it. */
void moc_point(const moc_arm *arm, const moc_frame *frame, const moc_twist *twist, int which, double point[3],
               double J[][MOC_MAX_JOINTS]);

/* mu = sqrt(det(J J^T)) of J (3,n) and its gradient (NULL: without); the same of the shaft, of A (6,n). */
double moc_manipulability(int n, const moc_twist *twist, double J[][MOC_MAX_JOINTS], double *gradient);
double moc_shaft_manipulability(int n, const moc_twist *twist, double A[][MOC_MAX_JOINTS], const double u[3],
                                double *gradient);

/* --- record.c --- */

/* Between a struct and its packed record; moc_opt/qp/problem.py and moc_opt/robots/model.py read the same ones. */
typedef enum { UNPACK, PACK } direction;
void moc_copy_problem(moc_problem *problem, int n, double *record, direction way);
void moc_copy_terms(moc_terms *terms, int n, double *record, direction way);

/* --- levels.c, null_space.c --- */

/* Levels 1 and 2, tau_tip + tau_rcm [Nm]. */
void moc_tracking_torque(const moc_law *law, int n, const moc_terms *t, const moc_reference *ref,
                         const moc_trocar *trocar, double *tau);

/* This tick's subproblem; x_d: a velocity [rad/s] that replaces the climb of mu, or NULL. */
void moc_fill_problem(const moc_law *law, int n, const moc_terms *t, const moc_reference *ref,
                      const moc_trocar *trocar, const double *x_d, moc_problem *problem);

/* tau += share M Z^T (Z M Z^T)^-1 Z (K_N2 (x - v) - D_N2 v), cut at tau_max. */
void moc_add_third_level(const moc_law *law, int n, const moc_terms *t, const moc_memory *memory, const double *x,
                         double *tau);

/* N_d = X + L e, which puts the shaft through the trocar, and dN_d, for a tip at X that moves with dX. */
void moc_desired_wrist(const double X[3], const double dX[3], const moc_trocar *trocar, double span, double N_d[3],
                       double dN_d[3]);

/* r = K_o (p - integral(tau + C^T v - g + r)), p = M v, of joint i, advanced by one period over which tau acted. */
void moc_observe(int n, const moc_terms *t, int i, double tau, double gain, double period, double *integral, double *r);

/* Weight of grad mu_shaft beside grad mu [m]. */
double moc_shaft_push(double mu_shaft, double margin);

/* x_d of the scaled climb [rad/s], with the basis in the memory; zero at a top of mu, and in a singular pose. */
void moc_climb(const moc_arm *arm, const moc_law *law, const moc_terms *t, moc_memory *memory, double *x_d);

/* An orthonormal basis Z of ker A, turned towards the one that is in it (rows, n) where that has as many; returns how
 * many. */
int moc_null_space(int n, double A[][MOC_MAX_JOINTS], int rows, double Z[][MOC_MAX_JOINTS]);

/* Row k of Z less its part along the rows before it, as a unit vector; false where no more than `least` was left. */
bool moc_orthonormalise(int n, double Z[][MOC_MAX_JOINTS], int k, double least);

/* part = Z^T Z x of an orthonormal basis Z (rows, n); part may be x. */
void moc_onto(int n, int rows, double Z[][MOC_MAX_JOINTS], const double *x, double *part);

/* --- exact.c, polytope.c --- */

#define STILL 1e-10 /* a joint that moves less on a step of one freedom is not stopped by its bounds (qp/extremes.py) */

/* A x = b, eliminated: row k < rank reads x[joint[k]] + sum over free joints of row[k][j] x[j] = right[k]. */
typedef struct {
    double row[6][MOC_MAX_JOINTS], right[6], pivot; /* pivot: of the last step [m] */
    double step[6][6];         /* how much of row k went into each row, at step k */
    int from[6];               /* with which row k changed its place before */
    int joint[MOC_MAX_JOINTS]; /* those of the pivots, then the free ones that move tip or wrist */
    int rank, freedoms;
} moc_plane;

/* Eliminate A x = b, and number the other joints behind those of the pivots; false where the rank is in doubt. */
bool moc_eliminate(moc_plane *plane, const moc_problem *problem);

/* How all joints move along A x = b when free joint number k moves by one. */
void moc_direction(const moc_plane *plane, int n, int k, double *z);

/* Move x, any point of the plane, along it to the optimum over the box, where the plane has two freedoms or more. The
 * multipliers of the active bounds are added to force. */
moc_status moc_solve_several(const moc_plane *plane, const moc_problem *problem, double tolerance, double *x,
                             double *force);

/* --- answer.c --- */

typedef struct {
    double primal;   /* |A x - b|_inf; NaN where x is not finite [m/s] */
    double outside;  /* violation of the box [rad/s] */
    double natural;  /* natural residual along the self-motion, the gradient scaled to length 1 [rad/s] */
    double off;      /* distance from the optimum [rad/s] */
    double opposite; /* and from that of the opposite gradient [rad/s] */
} moc_residuals;

/* Judge x on the self-motion that Z leaves. */
moc_residuals moc_judge(const moc_problem *problem, int rows, double Z[][MOC_MAX_JOINTS], const double *x);

/* Check an answer and write the x that the arm follows. */
moc_fault moc_supervise(const moc_supervision *s, const moc_problem *problem, const moc_answer *answer,
                        moc_memory *memory, double *x);

/* --- guard.c --- */

/* Begin at a finite q, v, measurement number `stamp`. */
void moc_guard_start(const moc_guard *g, int n, const double *q, const double *v, long long stamp, moc_watch *w);

/* Judge a measurement; watch->q, v are then what to believe. */
moc_stop moc_guard_believe(const moc_guard *g, int n, const moc_measurement *m, moc_watch *w);

/* Judge RCM error and trocar force, with the tool where it is believed to be. */
moc_stop moc_guard_incision(const moc_guard *g, double pose[4][3], const moc_trocar *trocar, const double *wrench,
                            moc_watch *w);

/* Judge the tip (NULL: not known) and the motion (terms of watch->q, v; NULL: not known), then cut tau in place.
 * before: torque of the last tick. tau stays as it was where it is not finite. */
moc_stop moc_guard_follow(const moc_guard *g, const moc_arm *arm, const moc_terms *t, const double *tip,
                          const double *tip_ref, const double *before, double *tau, moc_watch *w);

/* The torque of a damped stop: the weight of the arm in the last pose believed, reached at the torque rate. */
void moc_guard_rest(const moc_guard *g, const moc_arm *arm, const double *before, const moc_watch *w, double *tau);

/* --- step.c --- */

/* The answer of moc_solve_exact to the subproblem in the state, where its x, multipliers and status are kept. */
moc_answer moc_ask_exact(const moc_controller *c, moc_state *state);

#endif
