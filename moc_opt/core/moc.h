/* Control law, exact solver and safety filter in SI units, without heap allocation. A tick is one control period.
 *
 * Symbols: joint positions q [rad, m], joint velocities v, tip X, wrist centre N, trocar P_t, Jacobians J_T of the tip
 * and J_W of the wrist, A = [J_T; J_W], mass matrix M, bias torque h = C v + g, manipulability mu of the tip. Only
 * the first n entries of joint arrays are used. Level 1 moves the tip, level 2 the wrist, level 3 the elbow. */
#ifndef MOC_H
#define MOC_H

#define MOC_MAX_JOINTS 16

typedef enum {
    MOC_OK = 0,
    MOC_INFEASIBLE, /* no x within the bounds solves A x = b */
    MOC_DOUBTFUL,   /* rounding errors are too large for a result */
    MOC_UNFINISHED, /* the neural network (rnn.c) has not converged */
    MOC_NOT_FINITE  /* q or v is not finite */
} moc_status;

/* --- the arm --- */

/* A joint and its link, in the joint's axes. The Python binding relies on the order of the fields. */
typedef struct {
    double rotation[3][3]; /* to the previous joint's axes, at q = 0 */
    double origin[3];      /* in the previous joint's axes [m] */
    double axis[3];        /* unit vector */
    double slides;         /* 1: prismatic, 0: revolute */
    double mass;           /* [kg] */
    double moment[3];      /* mass times centre of mass [kg m] */
    double inertia[6];     /* about the centre of mass: xx, xy, yy, xz, yz, zz [kg m^2] */
    double rotor;          /* drive inertia, reflected to the joint [kg m^2] */
} moc_joint;

enum { MOC_TIP = 0, MOC_WRIST = 1 };

typedef struct {
    int n;
    moc_joint joint[MOC_MAX_JOINTS];
    double point[2][3];            /* tip and wrist centre in the last joint's axes [m] */
    double tool[3][3];             /* rows: tool axes x, y, z (along the shaft) in the last joint's axes */
    int moves[2][MOC_MAX_JOINTS];  /* rows: tip, wrist; 0: the joint never moves this point */
    double gravity[3];             /* gravitational acceleration in world axes [m/s^2] */
} moc_arm;

/* Kinematics and dynamics at (q, v). The Python binding relies on the order of the fields. */
typedef struct {
    double q[MOC_MAX_JOINTS], v[MOC_MAX_JOINTS];
    double tip[3], wrist[3], u[3];           /* X [m], N [m], u = (X - N) / L */
    double pose[4][3];                       /* rows: tool axes x, y, z = u, tip */
    double A[6][MOC_MAX_JOINTS];             /* [J_T; J_W] */
    double drift[6];                         /* dJ_T/dt v, dJ_W/dt v [m/s^2] */
    double grad_mu[MOC_MAX_JOINTS], grad_mu_shaft[MOC_MAX_JOINTS]; /* in q [m^3/rad], [m^2/rad] */
    double M[MOC_MAX_JOINTS][MOC_MAX_JOINTS]; /* [kg m^2] */
    double h[MOC_MAX_JOINTS];                /* C v + g [Nm] */
    double energy_slope[MOC_MAX_JOINTS];     /* C^T v [Nm] */
    double gravity[MOC_MAX_JOINTS];          /* g, the torque that carries the arm's weight [Nm] */
    double mu;                               /* [m^3] */
    double span;                             /* L [m] */
    double mu_shaft;                         /* manipulability of the shaft at a resting tip [m^2] */
} moc_terms;

/* --- the subproblem --- */

/* min_x c0/2 |J_T x - v_T|^2 + c1/2 |J_W x - v_W|^2 - c2 x^T pull + rho/2 |x|^2,  A x = b,  lower <= x <= upper */
typedef struct {
    int n;
    double A[6][MOC_MAX_JOINTS], b[6];     /* [J_T; J_W], [v_T; v_W] [m/s] */
    double grad_mu[MOC_MAX_JOINTS];        /* [m^3/rad] */
    double pull[MOC_MAX_JOINTS];           /* to follow x_d: rho/c2 x_d. Else grad_mu, to which a multiple of
                                            * grad_mu_shaft is added if mu_shaft < shaft_margin */
    double lower[MOC_MAX_JOINTS], upper[MOC_MAX_JOINTS]; /* [rad/s] */
    double c0, c1, c2, rho;
    double q[MOC_MAX_JOINTS];              /* A = A(q); only nonlinear solvers use q */
} moc_problem;

/* Eliminated A x = b. For k < rank: x[joint[k]] + (sum of row[k][j] x[j] over joints j without a pivot) = new b_k. */
typedef struct {
    double row[6][MOC_MAX_JOINTS], pivot; /* pivot of the last step [m] */
    double inverse[6];         /* 1 / (pivot of step k) */
    double scale[6][6];        /* step k: row k = 0, then every row i -= scale[k][i] * (new row k); scale[k][k] = -1 */
    int from[6];               /* row swapped with row k before step k */
    int joint[MOC_MAX_JOINTS]; /* in this order: pivot joints, free joints that move tip or wrist, idle joints */
    int rank, freedoms;        /* freedoms: null-space dimension without idle joints */
    int doubtful;              /* 1: the rank may be higher */
} moc_plane;

/* Compute the optimum x (n,) and the multipliers y (6,) of A x = b. They are valid only with MOC_OK. A problem is
 * infeasible if no solution exists within the bounds widened by `tolerance` [rad/s]. */
moc_status moc_solve_exact(const moc_problem *problem, double tolerance, double *x, double y[6]);

/* --- the law --- */

typedef struct {
    double X[3], dX[3], ddX[3]; /* desired tip [m], [m/s], [m/s^2] */
} moc_reference;

typedef struct {
    double P[3], dP[3]; /* trocar position [m] and velocity [m/s] */
} moc_trocar;

/* Null-space projector of level 2: dynamically or statically consistent, or I - J^T J as in Su et al. 2019. */
typedef enum { MOC_DYNAMIC = 0, MOC_STATIC, MOC_AS_PUBLISHED } moc_projector;

typedef struct {
    double K_X, D_X, K_N, D_N;                   /* stiffness [N/m] and damping [N s/m] at tip and wrist */
    double rcm_lambda;                           /* assumed (RCM error) / (wrist error) of Su et al.; 0: not used */
    moc_projector projector;
    int feedforward;                             /* 1: desired accelerations are fed forward */
    double K_N2[MOC_MAX_JOINTS], D_N2[MOC_MAX_JOINTS]; /* gains of level 3 [N m s/rad] */
    double tau_max[MOC_MAX_JOINTS];              /* torque limits [Nm], may be infinite */
    double k0;                                   /* speed limit / distance from a joint limit [1/s] */
    double c0, c1, c2, rho;                      /* of moc_problem */
    double q_min[MOC_MAX_JOINTS], q_max[MOC_MAX_JOINTS], v_max[MOC_MAX_JOINTS]; /* joint limits [rad], [rad/s] */
    double shaft_margin;                         /* below this mu_shaft, level 3 also raises mu_shaft [m^2] */
    double spare_speed;                          /* if mu_shaft < shaft_margin, v_max grows by up to this share */
    double observer_gain;                        /* K_o of the disturbance observer [1/s]; 0: none */
    double period;                               /* [s] */
    double fade;                                 /* growth of moc_memory.share per tick */
    int third_level;                             /* 1: level 3 follows the subproblem's x; 0: no subproblem */
    int damped;                                  /* 1: D_N2 damps the self-motion if third_level is 0 */
    int climbs;                                  /* 1: level 3 raises mu by Newton steps (moc_climb) */
} moc_law;

typedef struct {
    int rows;
    double Z[MOC_MAX_JOINTS][MOC_MAX_JOINTS];    /* rows: orthonormal basis of ker A */
    double share;                                /* factor of level 3, rises from 0 to 1 */
    double integral[MOC_MAX_JOINTS];             /* of the observer [Nm s] */
    double external[MOC_MAX_JOINTS];             /* observer's estimate r of the external torque [Nm] */
    double tau[MOC_MAX_JOINTS];                  /* torque in this period, for the observer [Nm] */
    double good[MOC_MAX_JOINTS];                 /* last accepted answer [rad/s] */
    int age;                                     /* ticks since the last accepted answer, up to hold_ticks + 1 */
} moc_memory;

/* --- answers --- */

typedef enum {
    MOC_CLAIMS_OPTIMUM = 0,
    MOC_CLAIMS_INFEASIBLE,
    MOC_CLAIMS_NOTHING, /* x is an iterate */
    MOC_GIVES_NONE      /* the solver failed, x is not used */
} moc_claim;

/* Why an answer was refused, in the order of control/supervisor.py. */
typedef enum {
    MOC_TAKEN = 0,
    MOC_FAULT_INFEASIBLE,
    MOC_FAULT_FAILED,
    MOC_FAULT_RAISED,
    MOC_FAULT_MALFORMED,
    MOC_FAULT_NOT_FINITE,
    MOC_FAULT_OUTSIDE, /* A x = b or a bound is violated */
    MOC_FAULT_FALSE_OPTIMUM,
    MOC_FAULT_LATE,
    MOC_FAULT_LOST, /* the solver's process hung or ended */
    MOC_FAULTS
} moc_fault;

typedef struct {
    const double *x;  /* (n,) [rad/s], never NULL */
    moc_claim claim;
    moc_fault known;  /* fault that the caller has found, else MOC_TAKEN */
    double us;        /* time of the solve [us] */
} moc_answer;

typedef enum { MOC_DAMPING = 0, MOC_HOLD, MOC_LEAST_VIOLATION } moc_fallback;
typedef enum { MOC_LATE_HOLD = 0, MOC_LATE_ZERO, MOC_LATE_ITERATE } moc_late;

typedef struct {
    int check;              /* 0: residuals are not checked */
    double box_limit;       /* with MOC_CLAIMS_NOTHING: largest |A x - b| [m/s] and bound violation [rad/s] */
    double primal_limit;    /* the same with MOC_CLAIMS_OPTIMUM */
    double relative_limit;  /* largest moc_residuals.natural (shared.h) of a claimed optimum */
    double opposite_limit;  /* largest distance from the optimum, if the optimum with -pull is nearer to x [rad/s] */
    int hold_ticks;         /* ticks for which moc_memory.good replaces refused answers */
    int keep_off_limits;    /* after hold_ticks: a self-motion that keeps joints off their limits (1), or x = 0 (0) */
    moc_fallback fallback;  /* for an infeasible subproblem; MOC_DAMPING: x = 0 */
    moc_late late;          /* for a late answer; MOC_LATE_ITERATE: use it */
    double budget_us;       /* longest solve that is not late [us] */
} moc_supervision;

/* --- the safety filter --- */

#define MOC_REASONS(REASON)                                                                                            \
    REASON(MOC_RUNNING, "running")                                                                                     \
    REASON(MOC_STOP_NOT_STARTED, "not started") /* or the start was refused */                                         \
    REASON(MOC_STOP_STATE, "the controller's state is damaged")                                                        \
    REASON(MOC_STOP_MEASUREMENT, "measurements not believed")                                                          \
    REASON(MOC_STOP_WRENCH, "the wrench sensor's readings are not finite")                                             \
    REASON(MOC_STOP_RCM, "the RCM error has been above its limit")                                                     \
    REASON(MOC_STOP_FORCE, "the trocar's force has been above its limit")                                              \
    REASON(MOC_STOP_TIP, "the tip has been off its reference")                                                         \
    REASON(MOC_STOP_TORQUE, "the controller's torque is not finite")                                                   \
    REASON(MOC_STOP_LATE, "measurements are too late")                                                                 \
    REASON(MOC_STOP_REPEATED, "all encoders repeat one reading although the tip has to move or the torque changes")    \
    REASON(MOC_STOP_RAN_AWAY, "the encoders' positions do not follow their velocities")                                \
    REASON(MOC_STOP_STUCK, "an encoder repeats one reading while torque acts on its joint")                            \
    REASON(MOC_STOP_UNEXPLAINED, "the measured motion does not fit the torque: a wrong encoder, an unknown "           \
                                 "force, or a loop that oscillates because of a long delay")                           \
    REASON(MOC_STOP_REPLAYED, "the measurements are a recording: they equal earlier ones to the last bit")             \
    REASON(MOC_STOP_ONE_REPEATED, "one encoder repeats its reading more often than its noise allows")                  \
    REASON(MOC_STOP_WRENCH_REPEATED, "the wrench sensor repeats its reading more often than its noise allows")         \
    REASON(MOC_STOP_LAGGING, "one encoder lags: its readings equal earlier ones to the last bit")

#define MOC_NAME(name, words) name,
typedef enum { MOC_REASONS(MOC_NAME) MOC_STOPS } moc_stop;

/* Settings of the safety filter. An infinite limit turns its check off. The table at the top of safety_filter.c defines
 * the reasons to stop (in capitals). r: (torque that a joint's motion implies) - (applied torque). */
typedef struct {
    double period;                                      /* [s] */
    int patience;                                       /* ticks in a row that a check may fail */
    int carries;                                        /* 1: tau carries the arm's weight; 0: the drives do it */
    double low[MOC_MAX_JOINTS], high[MOC_MAX_JOINTS];   /* virtual walls [rad, m] */
    double v_max[MOC_MAX_JOINTS], tau_max[MOC_MAX_JOINTS]; /* [rad/s], [Nm] */
    double wall_stiffness, wall_damping, wall_brake;    /* [Nm/rad], [Nm s/rad], deceleration [rad/s^2] */
    double torque_step;                                 /* largest change of a torque [Nm per tick] */
    double jump;                                        /* MEASUREMENT: most that q changes beyond v_max t [rad] */
    double speed_factor;                                /* MEASUREMENT: largest |v| / v_max */
    double tip_error;                                   /* TIP: largest rms error of the tip [m] */
    double tip_share;                                   /* TIP: weight of a new tick in the mean square */
    int in_incision;                                    /* 0: RCM and FORCE are off */
    double warning[2], limit[2];                        /* of the rms RCM error [m] and the rms trocar force [N] */
    double incision_share;                              /* RCM, FORCE: weight of a new tick in the mean squares */
    double tool_mass, tool_length;                      /* the tool counts as a rod [kg], [m] */
    double tip_force;                                   /* largest force that counts as contact at the tip [N] */
    double stop_holding;                                /* dry friction of closed brakes / tau_max */
    double stop_yield;                                  /* rise of the trocar force that opens the brakes [N] */
    int stop_yield_ticks;                               /* open brakes close after this number of ticks */
    double press_share;                                 /* weight of a new tick in moc_watch.mean_force */
    int motion;                                         /* 0: LATE and all checks below are off */
    double motion_s;                                    /* RAN_AWAY: time over which q and v are compared [s] */
    double motion_rad;                                  /* RAN_AWAY: largest difference of a resting joint [rad] */
    double motion_lag_s;                                /* RAN_AWAY: lag of measured velocities [s] */
    double repeat_m;                                    /* REPEATED: largest motion of the tip's reference [m] */
    double repeat_torque;                               /* REPEATED: largest change of a torque / tau_max */
    double repeat_whole_m, repeat_whole_torque;         /* the same two, if the wrench is unchanged as well */
    double repeat_whole_ticks;                          /* WRENCH_REPEATED, REPLAYED (noisy wrench): most repeats */
    double repeat_joint_ticks;                          /* ONE_REPEATED: most ticks in a row with an unchanged q */
    double repeat_reading_ticks;                        /* REPEATED, ONE_REPEATED, REPLAYED, LAGGING: most repeats */
    double replayed_ticks;                              /* REPLAYED (wrench without noise): most repeats */
    double stuck_speed;                                 /* STUCK: largest moc_joint_watch.unseen_speed [rad/s] */
    double held[MOC_MAX_JOINTS];                        /* STUCK: static friction [Nm] */
    double residual_torque;                             /* UNEXPLAINED: largest |r - mean of r| / tau_max */
    double residual_whole;                              /* UNEXPLAINED: largest |r| / tau_max */
    double residual_rate;                               /* gain of the observer that computes r [1/s] */
    double residual_share;                              /* weight of a new tick in the mean of r */
    int settling_ticks;                                 /* ticks after the start until r has settled */
} moc_guard;

enum { MOC_RCM = 0, MOC_FORCE = 1 };

#define MOC_SLOTS 4096      /* size of the table of earlier readings of all sensors */
#define MOC_JOINT_SLOTS 256 /* the same for one encoder */

/* Counts of one of these tables. A repetition is a reading that equals an earlier one. */
typedef struct {
    double readings;     /* number of readings */
    double lag, hits;    /* lag of the latest repetition [readings]; repetitions in a row with this lag */
} moc_came_before;

typedef struct {
    double drift;            /* change of q minus integral of v, over about motion_s [rad] */
    double peak_speed;       /* largest recent |v| [rad/s] */
    double shown, speed;     /* latest q and v */
    double repeats;          /* ticks in a row with an unchanged q */
    double repeats_both;     /* number of ticks with unchanged q and v */
    double torque;           /* applied torque when the encoders stopped changing [Nm] */
    double integral;         /* of the momentum observer [Nm s] */
    double residual, mean;   /* r and its running mean [Nm] */
    double at_repeat;        /* mean of r when q last changed [Nm] */
    double unseen_speed;     /* STUCK: speed that the joint should have gained since q last changed [rad/s] */
    double exceeded;         /* ticks in a row with r above a limit of UNEXPLAINED */
} moc_joint_watch;

typedef struct {
    double q[MOC_MAX_JOINTS], v[MOC_MAX_JOINTS]; /* believed state, extrapolated if no measurement is accepted */
    double low[MOC_MAX_JOINTS], high[MOC_MAX_JOINTS]; /* virtual walls; a start beyond a wall moves the wall */
    int bad;                                     /* refused measurements in a row */
    double tip_square;                           /* mean square of the tip's error [m^2] */
    double point[3];                             /* trocar [m] */
    double mean_square[2];                       /* of the RCM error [m^2] and the trocar force [N^2] */
    double largest[2], first_tick[2];            /* largest rms above its warning; tick of the first warning, or -1 */
    double whole_square;                         /* mean square of the whole force across the shaft [N^2] */
    double ticks;                                /* number of the tick, from 0 */
    int unread;                                  /* wrenches in a row that were not finite */
    double mean_force;                           /* mean trocar force in a stop [N] */
    double base_force;                           /* closed brakes open if mean_force > base_force + stop_yield [N] */
    int brakes_open, open_ticks;                 /* 1: the brakes are open in a stop; ticks since then */
    int cut;                                     /* 1: a drive is at fault, so that tau goes to zero */
    int limited;                                 /* number of torques limited in this tick */
    long long now, newest;                       /* this control period; stamp of the newest measurement */
    long long delay;                             /* age of the run's first new measurement [periods] */
    long long elapsed;                           /* periods since readings were last compared */
    long long taken;                             /* number of new measurements */
    moc_joint_watch joint[MOC_MAX_JOINTS];
    double tip_ref[3], tip_ref_before[3];        /* tip reference, now and when the encoders stopped changing [m] */
    double wrench[6], wrench_repeats;            /* latest wrench; its repetitions in a row */
    int looked;                                  /* wrenches read, up to FIRST_READINGS (100) */
    int wrench_is_still;                         /* 1: one of these equalled the one before it */
    int weighed;                                 /* measurements compared with the torque */
    double number[MOC_SLOTS], at[MOC_SLOTS];     /* each reading as one number; its index from 1 (0: empty slot) */
    double joint_number[MOC_MAX_JOINTS][MOC_JOINT_SLOTS], joint_at[MOC_MAX_JOINTS][MOC_JOINT_SLOTS];
    moc_came_before whole, lagging[MOC_MAX_JOINTS]; /* repetitions of all sensors, and of each encoder */
} moc_watch;

typedef struct {
    const double *q, *v;   /* (n,) */
    long long stamp;       /* number of its control period */
    int has_stamp;         /* 0: LATE is off */
    const double *applied; /* (n,) torque of the previous period [Nm], NULL if unknown */
    const double *wrench;  /* (6,) force [N] and torque [Nm] of the tool on its mount, in tool axes */
} moc_measurement;

const char *moc_reason(moc_stop reason);

/* Compute the dry friction (n,) that the brakes have to apply [Nm]. Call it once in every period of a stop. */
void moc_guard_hold(const moc_guard *g, const moc_arm *arm, const double *wrench, moc_watch *w, double *friction);

/* --- the whole controller --- */

typedef struct {
    const moc_arm *arm;
    const moc_law *law;
    const moc_supervision *supervision;
    const moc_guard *guard; /* NULL: no safety filter, and nothing stops the arm */
    double tolerance;       /* of moc_solve_exact [rad/s] */
} moc_controller;

typedef struct {
    moc_measurement measured;
    moc_reference ref;
    moc_trocar trocar;
    const double *x_d; /* (n,) joint velocities that level 3 follows [rad/s]; NULL: level 3 raises mu */
} moc_input;

typedef struct {
    moc_memory memory;
    moc_watch watch;
    moc_terms terms;                /* the fields from here to `status` belong to the latest tick */
    moc_problem problem;            /* filled if law->third_level */
    moc_plane plane;                /* problem.A after elimination */
    double tip_ref[3];              /* tip reference [m] */
    double tau[MOC_MAX_JOINTS];     /* of levels 1 and 2, minus memory.external; after moc_finish, to send [Nm] */
    moc_fault fault;
    double x[MOC_MAX_JOINTS];       /* joint velocity that level 3 follows [rad/s] */
    double answer[MOC_MAX_JOINTS];  /* answer, y, status: results of the exact solver in moc_step */
    double y[6];
    moc_status status;
    double sent[MOC_MAX_JOINTS];    /* latest torque sent or measured [Nm] */
    moc_stop reason;                /* first reason to stop */
    unsigned begun;                 /* MOC_BEGUN after moc_start */
} moc_state;

#define MOC_BEGUN 0x6d6f6331u

/* Reset the state and start at a measurement. m->applied is the torque that acts now. Returns MOC_STOP_NOT_STARTED if
 * q or v is not finite or a torque is beyond its limit, else MOC_RUNNING. */
moc_stop moc_start(const moc_controller *c, const moc_measurement *m, moc_state *state);

/* First half of a tick: check the measurement, compute levels 1 and 2, and fill state->problem. Returns MOC_RUNNING or
 * the reason to stop. in->measured.applied may be NULL if the torque sent last has acted. */
moc_stop moc_begin(const moc_controller *c, const moc_input *in, moc_state *state);

/* Second half of a tick: check the answer, add level 3, apply the safety filter. Returns MOC_RUNNING or the reason to
 * stop. tau (n,) is the torque to send, zero before the first moc_start. With a safety filter, it is finite and within
 * the limits of c->guard for any measurement. In a stop, tau carries the arm's weight. If a drive is at fault, tau goes
 * to zero instead. The brakes have to apply the friction of moc_guard_hold. Only moc_start ends a stop. The answer may
 * be NULL in a stop, or without a third level. */
moc_stop moc_finish(const moc_controller *c, const moc_answer *answer, moc_state *state, double *tau);

/* moc_begin, moc_solve_exact and moc_finish in one call. Input and output must not overlap in memory. */
moc_stop moc_step(const moc_controller *c, const moc_input *in, moc_state *state, double *tau);

#endif
