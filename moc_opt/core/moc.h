/* The public functions of moc_opt's core. Together they compute one control period (a tick). The code is plain C11 in
 * SI units, without heap, global variables or callbacks.
 *
 * The names are those of docs/method.md: joint positions q [rad, m], joint velocities v, tip X, wrist centre N, trocar
 * P_t, Jacobians J_T of the tip and J_W of the wrist, A = [J_T; J_W], mass matrix M, h = C v + g, manipulability mu of
 * the tip. Level 1 of the law moves the tip, level 2 keeps the shaft in the trocar, and level 3 uses the self-motion.
 * Arrays with one entry per joint have room for MOC_MAX_JOINTS. Only their first n entries are used. */
#ifndef MOC_H
#define MOC_H

#define MOC_MAX_JOINTS 16

typedef enum {
    MOC_OK = 0,
    MOC_INFEASIBLE, /* no x within the bounds solves A x = b */
    MOC_DOUBTFUL,   /* there is no result, because rounding errors would decide it */
    MOC_UNFINISHED, /* the network (rnn.c) has not converged yet */
    MOC_NOT_FINITE  /* q or v is not finite */
} moc_status;

/* --- the arm --- */

/* A joint and the link that it moves, in the joint's own axes. The Python binding relies on the order of the fields. */
typedef struct {
    double rotation[3][3]; /* from the joint's axes to the previous joint's axes, at q = 0 */
    double origin[3];      /* origin of the joint's axes, in the previous joint's axes [m] */
    double axis[3];        /* unit vector along which the joint slides, or about which it turns */
    double slides;         /* 1: prismatic, 0: revolute */
    double mass;           /* [kg] */
    double moment[3];      /* mass times centre of mass [kg m] */
    double inertia[6];     /* about the centre of mass: xx, xy, yy, xz, yz, zz [kg m^2] */
    double rotor;          /* inertia of the drive, reflected to the joint [kg m^2] */
} moc_joint;

enum { MOC_TIP = 0, MOC_WRIST = 1 };

typedef struct {
    int n;
    moc_joint joint[MOC_MAX_JOINTS];
    double point[2][3];            /* tip and wrist centre in the last joint's axes [m] */
    double tool[3][3];             /* rows: the tool's axes x, y, z (along the shaft) in the last joint's axes */
    int moves[2][MOC_MAX_JOINTS];  /* 0: the joint never moves the tip (row 0) or the wrist (row 1) */
    double gravity[3];             /* [m/s^2] */
} moc_arm;

/* Kinematics and dynamics of the arm at one (q, v). The Python binding relies on the order of the fields. */
typedef struct {
    double q[MOC_MAX_JOINTS], v[MOC_MAX_JOINTS];
    double tip[3], wrist[3], u[3];           /* u = (X - N) / L */
    double pose[4][3];                       /* rows: the tool's axes x, y, z = u, and the tip */
    double A[6][MOC_MAX_JOINTS];             /* rows of J_T, then of J_W */
    double drift[6];                         /* dJ_T/dt v, dJ_W/dt v [m/s^2] */
    double grad_mu[MOC_MAX_JOINTS], grad_mu_shaft[MOC_MAX_JOINTS];
    double M[MOC_MAX_JOINTS][MOC_MAX_JOINTS];
    double h[MOC_MAX_JOINTS];
    double energy_slope[MOC_MAX_JOINTS];     /* dT/dq = C^T v with the kinetic energy T [Nm] */
    double gravity[MOC_MAX_JOINTS];          /* torque that carries the arm's weight [Nm] */
    double mu;                               /* [m^3] */
    double span;                             /* L [m] */
    double mu_shaft;                         /* manipulability of the shaft while the tip stays still [m^2] */
} moc_terms;

/* --- the subproblem --- */

/* min_x c0/2 |J_T x - v_T|^2 + c1/2 |J_W x - v_W|^2 - c2 x^T pull + rho/2 |x|^2,  A x = b,  lower <= x <= upper */
typedef struct {
    int n;
    double A[6][MOC_MAX_JOINTS], b[6];     /* [J_T; J_W], [v_T; v_W] */
    double grad_mu[MOC_MAX_JOINTS];
    double pull[MOC_MAX_JOINTS];           /* grad_mu + moc_shaft_push() grad_mu_shaft, or rho/c2 x_d to follow x_d */
    double lower[MOC_MAX_JOINTS], upper[MOC_MAX_JOINTS]; /* [rad/s] */
    double c0, c1, c2, rho;
    double q[MOC_MAX_JOINTS];              /* the pose to which A belongs; only nonlinear solvers use it */
} moc_problem;

/* A (6,n) after elimination. Row k < rank of A x = b reads x[joint[k]] + sum of row[k][j] x[j] over free joints j = the
 * eliminated b_k. */
typedef struct {
    double row[6][MOC_MAX_JOINTS], pivot; /* pivot: the pivot of the last step [m] */
    double inverse[6];         /* 1 / pivot of step k */
    double scale[6][6];        /* step k subtracted scale[k][i] * (row k) from row i; scale[k][k] is -1 */
    int from[6];               /* the row that was swapped with row k before step k */
    int joint[MOC_MAX_JOINTS]; /* pivot joints, then free joints that move tip or wrist, then idle joints */
    int rank, freedoms;        /* freedoms: number of free joints that move tip or wrist */
    int doubtful;              /* 1: rounding hides the rank; `rank` is the lower of two possible ranks */
} moc_plane;

/* Compute the optimum x (n,) and the multipliers y (6,) of A x = b by elimination. The problem counts as
 * feasible if its bounds, widened by `tolerance` [rad/s], allow a solution. x and y are valid only with MOC_OK. */
moc_status moc_solve_exact(const moc_problem *problem, double tolerance, double *x, double y[6]);

/* --- the law --- */

typedef struct {
    double X[3], dX[3], ddX[3]; /* desired motion of the tip [m], [m/s], [m/s^2] */
} moc_reference;

typedef struct {
    double P[3], dP[3]; /* registered position [m] and velocity [m/s] of the trocar */
} moc_trocar;

/* Null-space projector of level 2: dynamically or statically consistent, or I - J^T J as in Su et al. 2019. */
typedef enum { MOC_DYNAMIC = 0, MOC_STATIC, MOC_AS_PUBLISHED } moc_projector;

typedef struct {
    double K_X, D_X, K_N, D_N;                   /* stiffness and damping at tip and wrist [N/m], [N s/m] */
    double rcm_lambda;                           /* constant lambda of Su et al. (see law.c); 0: not used */
    moc_projector projector;
    int feedforward;                             /* 1: the desired accelerations of tip and wrist are fed forward */
    double K_N2[MOC_MAX_JOINTS], D_N2[MOC_MAX_JOINTS]; /* gains of the third level [N m s/rad] */
    double tau_max[MOC_MAX_JOINTS];              /* largest torques [Nm], may be infinite */
    double k0;                                   /* rate of the velocity damper at joint limits [1/s] */
    double c0, c1, c2, rho;                      /* weights of the subproblem */
    double q_min[MOC_MAX_JOINTS], q_max[MOC_MAX_JOINTS], v_max[MOC_MAX_JOINTS]; /* joint limits */
    double shaft_margin;                         /* below this value of mu_shaft, level 3 also raises mu_shaft [m^2] */
    double spare_speed;                          /* if mu_shaft < shaft_margin, v_max grows by up to this share */
    double observer_gain;                        /* gain K_o of the disturbance observer [1/s]; 0: no observer */
    double period;                               /* control period T [s] */
    double fade;                                 /* growth of the third level's share per tick, at the start */
    int third_level;                             /* 1: level 3 follows the subproblem's x; 0: no subproblem is solved */
    int damped;                                  /* 1: if third_level is 0, D_N2 damps the self-motion */
    int climbs;                                  /* 1: level 3 climbs mu by Newton steps (moc_climb) */
} moc_law;

/* What the law remembers from tick to tick. */
typedef struct {
    int rows;                                    /* number of rows of Z */
    double Z[MOC_MAX_JOINTS][MOC_MAX_JOINTS];    /* its rows are an orthonormal basis of ker A */
    double share;                                /* factor of level 3, rises from 0 to 1 at the start */
    double integral[MOC_MAX_JOINTS];             /* the observer's integral [Nm s] */
    double external[MOC_MAX_JOINTS];             /* the observer's estimate r of friction and model error [Nm] */
    double tau[MOC_MAX_JOINTS];                  /* torque that acts in this period, for the observer [Nm] */
    double good[MOC_MAX_JOINTS];                 /* the last accepted answer [rad/s] */
    int age;                                     /* ticks since the last accepted answer, up to hold_ticks + 1 */
} moc_memory;

/* --- an answer, its check, and its replacements --- */

/* The status that a solver reports for its answer. */
typedef enum {
    MOC_CLAIMS_OPTIMUM = 0,
    MOC_CLAIMS_INFEASIBLE,
    MOC_CLAIMS_NOTHING, /* x is an iterate: the solver ran out of iterations or time */
    MOC_GIVES_NONE      /* there is no answer */
} moc_claim;

/* Why an answer was refused, in the order of control/supervisor.py. RAISED, MALFORMED and LOST come from callers. */
typedef enum {
    MOC_TAKEN = 0,
    MOC_FAULT_INFEASIBLE,
    MOC_FAULT_FAILED,
    MOC_FAULT_RAISED,
    MOC_FAULT_MALFORMED,
    MOC_FAULT_NOT_FINITE,
    MOC_FAULT_OUTSIDE,
    MOC_FAULT_FALSE_OPTIMUM,
    MOC_FAULT_LATE,
    MOC_FAULT_LOST,
    MOC_FAULTS
} moc_fault;

typedef struct {
    const double *x;  /* (n,) [rad/s], never NULL */
    moc_claim claim;
    moc_fault known;  /* a fault that the caller has found already, or MOC_TAKEN */
    double us;        /* time of the solve [us] */
} moc_answer;

typedef enum { MOC_DAMPING = 0, MOC_HOLD, MOC_LEAST_VIOLATION } moc_fallback;
typedef enum { MOC_LATE_HOLD = 0, MOC_LATE_ZERO, MOC_LATE_ITERATE } moc_late;

typedef struct {
    int check;              /* 0: the residuals are not checked */
    double box_limit;       /* largest |A x - b| and bound violation with MOC_CLAIMS_NOTHING */
    double primal_limit;    /* largest |A x - b| and bound violation of a claimed optimum */
    double relative_limit;  /* largest natural residual of a claimed optimum */
    double opposite_limit;  /* a claimed optimum farther than this from the true optimum is refused if it lies nearer
                             * to the optimum of the opposite gradient [rad/s] */
    int hold_ticks;         /* number of ticks for which the last accepted answer replaces refused answers */
    int keep_off_limits;    /* after hold_ticks, x is the smallest self-motion within the bounds (1) or zero (0) */
    moc_fallback fallback;  /* for an infeasible subproblem */
    moc_late late;          /* for a late answer */
    double budget_us;       /* longest solve time [us]; infinite: no limit */
} moc_supervision;

/* --- the safety filter (safety_filter.c) --- */

/* The reasons to stop the arm, with the words that moc_reason returns. */
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

/* Settings of the safety filter, from [guard] of a scenario (docs/scenario.md). An infinite limit turns its check off.
 * Names in capitals are reasons to stop. Their formulas are at the top of safety_filter.c. */
typedef struct {
    double period;                                      /* control period T [s] */
    int patience;                                       /* ticks in a row on which a check may fail without a stop */
    int carries;                                        /* 0: the drives carry the arm's weight themselves */
    double low[MOC_MAX_JOINTS], high[MOC_MAX_JOINTS];   /* where the virtual walls begin [rad, m] */
    double v_max[MOC_MAX_JOINTS], tau_max[MOC_MAX_JOINTS];
    double wall_stiffness, wall_damping, wall_brake;    /* [Nm/rad], [Nm s/rad], [rad/s^2] */
    double torque_step;                                 /* largest change of a torque in a tick [Nm] */
    double jump, speed_factor;                          /* MEASUREMENT: largest jump [rad], largest |v| / v_max */
    double tip_error, tip_share;                        /* TIP: largest rms [m], weight of a tick in the mean square */
    int in_incision;                                    /* 0: RCM error and trocar force are not checked */
    double warning[2], limit[2];                        /* thresholds of rms RCM error [m], rms trocar force [N] */
    double incision_share;                              /* weight of a tick in the mean squares of RCM and force */
    double tool_mass, tool_length;                      /* mass [kg] and length [m] of the tool, a rod */
    double tip_force;                                   /* largest force that may come from a contact of the tip [N] */
    double stop_holding;                                /* dry friction of closed brakes, divided by tau_max */
    double stop_yield;                                  /* trocar force above which the brakes open in a stop [N] */
    int stop_yield_ticks;                               /* largest number of ticks for which the brakes stay open */
    double press_share;                                 /* weight of a tick in the mean trocar force of a stop */
    int motion;                                         /* 0: LATE and the checks named below are off */
    double motion_s, motion_rad, motion_lag_s;          /* RAN_AWAY: memory [s], largest gap [rad], largest lag [s] */
    double repeat_m, repeat_torque;                     /* REPEATED: motion of the reference [m], share of tau_max */
    double repeat_whole_m, repeat_whole_torque;         /* REPEATED: motion [m], share, if the wrench is unchanged */
    double repeat_whole_ticks;                          /* WRENCH_REPEATED, REPLAYED: ticks if the wrench has noise */
    double repeat_joint_ticks, repeat_reading_ticks;    /* ONE_REPEATED: ticks in a row, ticks in total */
    double replayed_ticks;                              /* REPLAYED: ticks if the wrench has no noise */
    double stuck_speed;                                 /* STUCK: largest |integral| in its formula [rad/s] */
    double held[MOC_MAX_JOINTS];                        /* STUCK: change of torque that static friction can hold [Nm] */
    double residual_torque, residual_whole;             /* UNEXPLAINED: largest residuals, divided by tau_max */
    double residual_rate, residual_share;               /* observer gain [1/s], weight of a tick in the mean of r */
    int settling_ticks;                                 /* ticks until the residual has settled */
} moc_guard;

enum { MOC_RCM = 0, MOC_FORCE = 1 };

#define MOC_SLOTS 4096      /* size of the table of earlier readings */
#define MOC_JOINT_SLOTS 256 /* size of the table of each encoder */

/* Number of readings so far, lag between the latest two equal readings, and number of repetitions with this lag. */
typedef struct {
    double readings, lag, hits;
} moc_came_before;

/* What the safety filter remembers about a joint. */
typedef struct {
    double gap, peak, shown, speed;          /* q - integral of v; largest recent |v|; last q; last v */
    double repeats, whole;                   /* ticks with unchanged q, in a row; with unchanged q and v, in total */
    double torque;                           /* torque when all encoders stopped changing [Nm] */
    double integral, residual, mean;         /* momentum observer: integral, residual and its mean */
    double at_repeat, unseen, exceeded;      /* mean when q last changed; STUCK: speed; UNEXPLAINED: ticks in a row */
} moc_joint_watch;

/* What the safety filter remembers. */
typedef struct {
    double q[MOC_MAX_JOINTS], v[MOC_MAX_JOINTS]; /* last believed measurement; v extrapolates q after it */
    double low[MOC_MAX_JOINTS], high[MOC_MAX_JOINTS]; /* virtual walls; a start beyond a wall moves the wall */
    int bad;                                     /* measurements in a row that were not believed */
    double tip_square;                           /* mean square of the tip's error [m^2] */
    double point[3];                             /* the trocar, as last registered [m] */
    double mean_square[2], largest[2], first_tick[2]; /* RCM error, force: mean square; largest rms, first warning */
    double whole_square, ticks;                  /* mean square of the whole force across the shaft; tick number */
    int unread;                                  /* wrench readings in a row that were not finite */
    double press, borne;                         /* in a stop: mean trocar force; level that it is compared with */
    int yields, open;                            /* 1: the trocar force has opened the brakes; ticks since then */
    int cut;                                     /* 1: a drive is at fault, so the torque of the stop goes to zero */
    int limited;                                 /* number of joints whose last torque was limited */
    long long now, newest, delay, elapsed, taken; /* numbers of control periods: see `age` in safety_filter.c */
    moc_joint_watch joint[MOC_MAX_JOINTS];
    double told[3], still[3];                    /* tip's reference, now and when all encoders stopped changing [m] */
    double wrench[6], wrench_repeats;            /* latest wrench; how many readings in a row before it were equal */
    int looked, wrench_is_still;                 /* wrenches read, up to FIRST_READINGS; 1: two in a row were equal */
    int weighed;                                 /* number of readings that were compared with the torque */
    double number[MOC_SLOTS], at[MOC_SLOTS];     /* table of take_in: readings and their indices (0: empty) */
    double joint_number[MOC_MAX_JOINTS][MOC_JOINT_SLOTS], joint_at[MOC_MAX_JOINTS][MOC_JOINT_SLOTS];
    moc_came_before whole, lagging[MOC_MAX_JOINTS];
} moc_watch;

typedef struct {
    const double *q, *v;   /* (n,) */
    long long stamp;       /* number of the control period in which it was taken */
    int has_stamp;         /* 0: the age of the measurement is not checked */
    const double *applied; /* (n,) torque of the previous period [Nm], NULL if unknown */
    const double *wrench;  /* (6,) force [N] and torque [Nm] of the tool on its mount, in the tool's axes */
} moc_measurement;

const char *moc_reason(moc_stop reason);

/* Compute the dry friction (n,) of the brakes [Nm], zero for open brakes. Call once per period of a stop. */
void moc_guard_hold(const moc_guard *g, const moc_arm *arm, const double *wrench, moc_watch *w, double *friction);

/* --- the whole controller (step.c) --- */

/* The settings of a run. */
typedef struct {
    const moc_arm *arm;
    const moc_law *law;
    const moc_supervision *supervision;
    const moc_guard *guard; /* NULL: no safety filter; every measurement is believed, and nothing stops the arm */
    double tolerance;       /* argument of moc_solve_exact [rad/s] */
} moc_controller;

typedef struct {
    moc_measurement measured;
    moc_reference ref;
    moc_trocar trocar;
    const double *x_d; /* velocity (n,) for the third level to follow [rad/s]; NULL: climb mu */
} moc_input;

/* The state of one arm's controller. */
typedef struct {
    moc_memory memory;
    moc_watch watch;
    moc_terms terms;                /* the fields from here to `status` belong to the latest tick */
    moc_problem problem;            /* filled if the law has a third level */
    moc_plane plane;                /* problem.A after elimination */
    double told[3];                 /* the tip's reference [m] */
    double tau[MOC_MAX_JOINTS];     /* after moc_begin: levels 1 and 2 minus r; after moc_finish: the torque to send */
    moc_fault fault;                /* why the answer was refused, or MOC_TAKEN */
    double x[MOC_MAX_JOINTS];       /* velocity that the third level followed [rad/s] */
    double answer[MOC_MAX_JOINTS];  /* x, y and status of moc_solve_exact in moc_step */
    double y[6];
    moc_status status;
    double sent[MOC_MAX_JOINTS];    /* torque that the latest moc_finish returned [Nm] */
    moc_stop reason;                /* the first reason to stop; only moc_start clears it */
    unsigned begun;                 /* MOC_BEGUN after moc_start */
} moc_state;

#define MOC_BEGUN 0x6d6f6331u

/* Reset the state and start at a measurement; m->applied is the torque that acts now. Returns MOC_RUNNING, or
 * MOC_STOP_NOT_STARTED if a number is not finite or a torque is beyond its limit. */
moc_stop moc_start(const moc_controller *c, const moc_measurement *m, moc_state *state);

/* First half of a control period: check the measurement, then compute the arm's terms, levels 1 and 2, and the
 * subproblem state->problem. If the torque that acted in the last period differs from the sent torque,
 * measured.applied is the torque that acted. Else it may be NULL. Returns MOC_RUNNING, or the reason to stop. In a
 * stop, no solver has to be called. */
moc_stop moc_begin(const moc_controller *c, const moc_input *in, moc_state *state);

/* Second half of a control period: check the answer, replace it if it is refused, then add level 3 and apply the safety
 * filter. The answer may be NULL if the law has no third level or the arm is stopped. tau (n,) is the torque to send.
 * With a safety filter, tau is finite and within the limits of c->guard for any measurement.
 * Returns MOC_RUNNING, or the reason to stop. In a stop, tau carries the arm's weight in the last believed pose. If a
 * drive is at fault, tau goes to zero instead. The brakes have to apply the friction of moc_guard_hold. Only
 * moc_start ends a stop. Before the first moc_start, tau is zero. */
moc_stop moc_finish(const moc_controller *c, const moc_answer *answer, moc_state *state, double *tau);

/* moc_begin, moc_solve_exact and moc_finish in one call. Input and output must not overlap in memory. */
moc_stop moc_step(const moc_controller *c, const moc_input *in, moc_state *state, double *tau);

#endif
