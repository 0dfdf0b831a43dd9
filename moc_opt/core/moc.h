/* moc_opt's core: what one control tick computes, in plain C11. No heap, no globals, no callbacks; SI units.
 *
 * Names are those of docs/method.md: q, v joint position [rad, m] and velocity; X tip, N wrist centre, P_t trocar;
 * J_T, J_W their Jacobians, A = [J_T; J_W]; M, h = C v + g; mu manipulability of the tip.
 * Arrays of joints have room for MOC_MAX_JOINTS; only the first n entries are used. */
#ifndef MOC_H
#define MOC_H

#define MOC_MAX_JOINTS 16

typedef enum {
    MOC_OK = 0,
    MOC_INFEASIBLE, /* no x of the box meets A x = b */
    MOC_DOUBTFUL,   /* rounding decides: no answer */
    MOC_UNFINISHED, /* the network (rnn.c) is still moving */
    MOC_NOT_FINITE  /* q or v */
} moc_status;

/* --- the arm --- */

/* A joint, and the link that it carries, in the joint's own axes; the binding relies on the order. */
typedef struct {
    double rotation[3][3]; /* of these axes in the frame of the joint before, at q = 0 */
    double origin[3];      /* in the same frame [m] */
    double axis[3];        /* unit vector */
    double slides;         /* 1: along the axis, 0: it turns about it */
    double mass;           /* [kg] */
    double moment[3];      /* mass times centre of mass [kg m] */
    double inertia[6];     /* about the centre of mass: xx, xy, yy, xz, yz, zz [kg m^2] */
    double rotor;          /* of the drive, felt at the joint [kg m^2] */
} moc_joint;

enum { MOC_TIP = 0, MOC_WRIST = 1 };

typedef struct {
    int n;
    moc_joint joint[MOC_MAX_JOINTS];
    double point[2][3];            /* tip and wrist centre in the last joint's axes [m] */
    double tool[3][3];             /* rows: the tool's axes x, y, z (along the shaft) there */
    int moves[2][MOC_MAX_JOINTS];  /* 0: this joint can never move the tip (the wrist); its column is exactly zero */
    double gravity[3];             /* [m/s^2] */
} moc_arm;

/* What the law needs of the arm at one (q, v); the binding's records rely on the order. */
typedef struct {
    double q[MOC_MAX_JOINTS], v[MOC_MAX_JOINTS];
    double tip[3], wrist[3], u[3];           /* u = (X - N) / L */
    double pose[4][3];                       /* the tool's axes x, y, z (u) and its tip again */
    double A[6][MOC_MAX_JOINTS];             /* J_T over J_W */
    double drift[6];                         /* dJ_T/dt v, dJ_W/dt v [m/s^2] */
    double grad_mu[MOC_MAX_JOINTS], grad_mu_shaft[MOC_MAX_JOINTS];
    double M[MOC_MAX_JOINTS][MOC_MAX_JOINTS];
    double h[MOC_MAX_JOINTS];
    double energy_slope[MOC_MAX_JOINTS];     /* dT/dq = C^T v, T the kinetic energy [Nm] */
    double gravity[MOC_MAX_JOINTS];
    double mu;                               /* [m^3] */
    double span;                             /* L [m] */
    double mu_shaft;                         /* of the shaft once the tip is held [m^2] */
} moc_terms;

/* --- the subproblem --- */

/* min_x c0/2 |J_T x - v_T|^2 + c1/2 |J_W x - v_W|^2 - c2 x^T pull + rho/2 |x|^2,  A x = b,  lower <= x <= upper */
typedef struct {
    int n;
    double A[6][MOC_MAX_JOINTS], b[6];     /* [J_T; J_W], [v_T; v_W] */
    double grad_mu[MOC_MAX_JOINTS];        /* of the pose */
    double pull[MOC_MAX_JOINTS];           /* grad_mu, with the shaft's share; or (rho/c2) x_d of a course or a climb */
    double lower[MOC_MAX_JOINTS], upper[MOC_MAX_JOINTS]; /* [rad/s] */
    double c0, c1, c2, rho;
    double q[MOC_MAX_JOINTS];              /* where it was linearized; no solver here needs it */
} moc_problem;

/* The optimum x (n,) and multipliers y (6,) of the rows of A, by elimination; `tolerance` is the violation of the box
 * that still counts as feasible [rad/s]. Returns MOC_OK, or MOC_INFEASIBLE or MOC_DOUBTFUL without an answer. */
moc_status moc_solve_exact(const moc_problem *problem, double tolerance, double *x, double y[6]);

/* --- the law --- */

typedef struct {
    double X[3], dX[3], ddX[3]; /* of the tip [m], [m/s], [m/s^2] */
} moc_reference;

typedef struct {
    double P[3], dP[3]; /* as registered [m], [m/s] */
} moc_trocar;

/* Null-space projector of level 2: the consistent one, the one of rest, and I - J^T J as the paper prints it. */
typedef enum { MOC_DYNAMIC = 0, MOC_STATIC, MOC_AS_PUBLISHED } moc_projector;

typedef struct {
    double K_X, D_X, K_N, D_N;                   /* springs and dampers of tip and wrist [N/m], [N s/m] */
    double rcm_lambda;                           /* of the paper's |e_N1| = d / lambda; 0: |N_d - N| itself */
    moc_projector projector;
    int feedforward;                             /* 1: the accelerations of tip and desired wrist are fed forward */
    double K_N2[MOC_MAX_JOINTS], D_N2[MOC_MAX_JOINTS]; /* third level [N m s/rad] */
    double tau_max[MOC_MAX_JOINTS];              /* [Nm]; infinite: no limit */
    double k0;                                   /* of the velocity damper [1/s] */
    double c0, c1, c2, rho;                      /* weights of the subproblem */
    double q_min[MOC_MAX_JOINTS], q_max[MOC_MAX_JOINTS], v_max[MOC_MAX_JOINTS]; /* of the subproblem's box */
    double shaft_margin;                         /* below this mu_shaft the climb leads away; 0: nowhere [m^2] */
    double spare_speed;                          /* by how much more than v_max the box opens there, a share */
    double observer_gain;                        /* K_o; 0: no observer [1/s] */
    double period;                               /* of control [s] */
    double fade;                                 /* the third level's share grows by this at each tick */
    int third_level;                             /* 0: none, or only its damping; 1: it follows the subproblem's x */
    int damped;                                  /* 1: the self-motion is damped by D_N2 without a subproblem */
    int climbs;                                  /* 1: scaled steps to the top of mu in place of its gradient */
} moc_law;

/* What the law remembers from tick to tick. */
typedef struct {
    int rows;                                    /* of Z */
    double Z[MOC_MAX_JOINTS][MOC_MAX_JOINTS];    /* orthonormal basis of ker A */
    double share;                                /* of the third level, while it fades in */
    double integral[MOC_MAX_JOINTS];             /* of the observer [Nm s] */
    double external[MOC_MAX_JOINTS];             /* its estimate r of the torque beside the model's [Nm] */
    double tau[MOC_MAX_JOINTS];                  /* that the observer takes to act [Nm] */
    double good[MOC_MAX_JOINTS];                 /* the last answer that was taken [rad/s] */
    int age;                                     /* ticks since then; no more than it takes to give up holding it */
} moc_memory;

/* --- an answer, its supervision, and what stands in for it --- */

/* What a solver says of its answer. */
typedef enum {
    MOC_CLAIMS_OPTIMUM = 0,
    MOC_CLAIMS_INFEASIBLE,
    MOC_CLAIMS_NOTHING, /* an iterate: it ran out of iterations or time */
    MOC_GIVES_NONE      /* no answer */
} moc_claim;

/* What was wrong with an answer; the order is that of control/supervisor.py. */
typedef enum {
    MOC_TAKEN = 0,
    MOC_FAULT_INFEASIBLE,
    MOC_FAULT_FAILED,
    MOC_FAULT_RAISED,    /* known to the caller alone, as are the next one and the last one */
    MOC_FAULT_MALFORMED,
    MOC_FAULT_NOT_FINITE,
    MOC_FAULT_OUTSIDE,
    MOC_FAULT_FALSE_OPTIMUM,
    MOC_FAULT_LATE,
    MOC_FAULT_LOST,
    MOC_FAULTS
} moc_fault;

/* What a solver gives back. */
typedef struct {
    const double *x;  /* (n,) [rad/s]; read only where there is an answer, but never NULL */
    moc_claim claim;
    moc_fault known;  /* a fault that the caller has seen, or MOC_TAKEN */
    double us;        /* time that it took */
} moc_answer;

typedef enum { MOC_DAMPING = 0, MOC_HOLD, MOC_LEAST_VIOLATION } moc_fallback;
typedef enum { MOC_LATE_HOLD = 0, MOC_LATE_ZERO, MOC_LATE_ITERATE } moc_late;

typedef struct {
    int check;              /* 0: residuals are not looked at */
    double box_limit;       /* largest |A x - b| and box violation of an answer without a claim */
    double primal_limit;    /* the same of one that is claimed optimal */
    double relative_limit;  /* largest natural residual of that */
    double opposite_limit;  /* a claim is false if x is farther off, and nearer to the opposite optimum [rad/s] */
    int hold_ticks;         /* for which the last good answer is held */
    int keep_off_limits;    /* 1: afterwards the elbow moves as far as the box asks for; 0: damping only */
    moc_fallback fallback;  /* of an infeasible subproblem */
    moc_late late;          /* what replaces a late answer */
    double budget_us;       /* time that a solve may take; infinite: no limit */
} moc_supervision;

/* --- the safety filter (guard.c) --- */

/* Why the arm has to be stopped, and the words of moc_reason. */
#define MOC_REASONS(REASON)                                                                                            \
    REASON(MOC_RUNNING, "running")                                                                                     \
    REASON(MOC_STOP_NOT_STARTED, "not started") /* or after a start that was refused */                                \
    REASON(MOC_STOP_STATE, "the controller's state is damaged")                                                        \
    REASON(MOC_STOP_MEASUREMENT, "measurements not believed")                                                          \
    REASON(MOC_STOP_WRENCH, "the wrench sensor's readings are no numbers")                                             \
    REASON(MOC_STOP_RCM, "the RCM error has been above its limit")                                                     \
    REASON(MOC_STOP_FORCE, "the trocar's force has been above its limit")                                              \
    REASON(MOC_STOP_TIP, "the tip has been off its reference")                                                         \
    REASON(MOC_STOP_TORQUE, "the controller's torque is not finite")                                                   \
    REASON(MOC_STOP_LATE, "measurements are too late")                                                                 \
    REASON(MOC_STOP_REPEATED, "all encoders repeat one reading, as no arm that moves or has noise does")               \
    REASON(MOC_STOP_RAN_AWAY, "the encoders' positions do not follow their velocities")                                \
    REASON(MOC_STOP_STUCK, "an encoder repeats one reading while torque acts on its joint")                            \
    REASON(MOC_STOP_UNEXPLAINED, "the measured motion is not what the torque makes: a wrong encoder, an unknown "      \
                                 "force, or a loop that shakes at too long a delay")                                   \
    REASON(MOC_STOP_REPLAYED, "the measurements are a recording: they came before, to the last bit")                   \
    REASON(MOC_STOP_ONE_REPEATED, "one encoder repeats its reading, as its noise does not let it")                     \
    REASON(MOC_STOP_WRENCH_REPEATED, "the wrench sensor repeats its reading, as its noise does not let it")            \
    REASON(MOC_STOP_LAGGING, "one encoder lags: its readings came before, to the last bit")

#define MOC_NAME(name, words) name,
typedef enum { MOC_REASONS(MOC_NAME) MOC_STOPS } moc_stop;

/* Levels; one that is infinite is off. The fields of [guard] in a scenario, where docs/scenario.md explains each. */
typedef struct {
    double period;                                      /* of control [s] */
    int patience;                                       /* ticks with a bad measurement that are bridged */
    int carries;                                        /* 1: the drives carry the arm's weight by this torque */
    double low[MOC_MAX_JOINTS], high[MOC_MAX_JOINTS];   /* where the walls begin [rad, m] */
    double v_max[MOC_MAX_JOINTS], tau_max[MOC_MAX_JOINTS];
    double wall_stiffness, wall_damping, wall_brake;    /* [Nm/rad], [Nm s/rad], [rad/s^2] */
    double torque_step;                                 /* largest change of a torque in a tick [Nm] */
    double jump, speed_factor;                          /* a reading farther off [rad], or faster, is not believed */
    double tip_error, tip_share;                        /* root mean square [m]; a tick's share in the mean */
    int in_incision;                                    /* 0: RCM error and trocar force are not looked at */
    double warning[2], limit[2];                        /* of RCM error [m] and trocar force [N] */
    double incision_share;                              /* of a tick in their mean squares */
    double tool_mass, tool_length;                      /* of the rod behind the wrench sensor [kg], [m] */
    double tip_force;                                   /* largest force across the shaft taken for the tip's [N] */
    double stop_holding;                                /* dry friction of closed brakes, share of tau_max */
    double stop_yield;                                  /* trocar force above which the brakes open in a stop [N] */
    int stop_yield_ticks;                               /* for which they do so at most */
    double press_share;                                 /* of a tick in the mean of that force */
    int motion;                                         /* 0: the checks below are off */
    double motion_s, motion_rad, motion_lag_s;          /* position against velocity */
    double repeat_m, repeat_torque;                     /* while all encoders repeat: way, share of tau_max */
    double repeat_whole_m, repeat_whole_torque;         /* the same while the wrench repeats itself too */
    double repeat_whole_ticks;                          /* a wrench sensor with noise may repeat itself for */
    double repeat_joint_ticks, repeat_reading_ticks;    /* one encoder may, in a row; so may all, in a run */
    double replayed_ticks;                              /* readings that may have come before */
    double stuck_speed;                                 /* that a still joint may have gathered [rad/s] */
    double held[MOC_MAX_JOINTS];                        /* change of torque that static friction holds [Nm] */
    double residual_torque, residual_whole;             /* of the momentum residual, shares of tau_max */
    double residual_rate, residual_share;               /* its rate [1/s], a tick's share in its mean */
    int settling_ticks;                                 /* until it is what it will be */
} moc_guard;

enum { MOC_RCM = 0, MOC_FORCE = 1 };

#define MOC_SLOTS 4096      /* readings that are remembered, one a slot */
#define MOC_JOINT_SLOTS 256 /* the same of each encoder */

/* How many readings came before, all of them by the same number of readings. */
typedef struct {
    double readings, lag, hits;
} moc_came_before;

/* What the safety filter remembers of a joint. */
typedef struct {
    double gap, peak, shown, speed;          /* q - integral of v; largest recent |v|; the last q and v */
    double repeats, whole;                   /* ticks in a row with the same q; so far with the same q and v */
    double torque;                           /* where all had repeated themselves for the patience [Nm] */
    double integral, residual, mean;         /* of the momentum observer; the mean of the residual */
    double at_repeat, unseen, exceeded;      /* mean where it began to repeat; speed gathered since; ticks far off */
} moc_joint_watch;

/* What the safety filter remembers. */
typedef struct {
    double q[MOC_MAX_JOINTS], v[MOC_MAX_JOINTS]; /* the last measurement that was believed, moved on since */
    double low[MOC_MAX_JOINTS], high[MOC_MAX_JOINTS]; /* the walls; of a joint that starts inside one it begins there */
    int bad;                                     /* measurements in a row that were not believed */
    double tip_square;                           /* mean square of the tip's error [m^2] */
    double point[3];                             /* the trocar, as registered last [m] */
    double mean_square[2], largest[2], first_tick[2]; /* of RCM error and force; root and tick of a warning, -1: none */
    double whole_square, ticks;                  /* of the whole force on the tool, a contact's too; in the incision */
    int unread;                                  /* readings of the wrench in a row that were no numbers */
    double press, borne;                         /* mean of the trocar's force in a stop; what closed brakes bear [N] */
    int yields, open;                            /* whether the brakes are open because of it; for how many ticks */
    int cut;                                     /* 1: a drive does not do what it is told: none is used in the stop */
    int limited;                                 /* joints at which the last torque was changed */
    long long now, newest, delay, elapsed, taken; /* numbers of control periods: see `age` in guard.c */
    moc_joint_watch joint[MOC_MAX_JOINTS];
    double told[3], still[3];                    /* the tip's reference; where all had repeated themselves [m] */
    double wrench[6], wrench_repeats;
    int looked, wrench_is_still;                 /* the first readings; whether the wrench repeated itself in them */
    int weighed;                                 /* readings that were compared with the torque */
    double number[MOC_SLOTS], at[MOC_SLOTS];     /* a reading as one number, and its place from 1 on; 0: none */
    double joint_number[MOC_MAX_JOINTS][MOC_JOINT_SLOTS], joint_at[MOC_MAX_JOINTS][MOC_JOINT_SLOTS];
    moc_came_before whole, lagging[MOC_MAX_JOINTS];
} moc_watch;

/* A measurement. */
typedef struct {
    const double *q, *v;   /* (n,) */
    long long stamp;       /* number of the control period in which it was taken */
    int has_stamp;         /* 0: its age is not looked at */
    const double *applied; /* (n,) torque that went out before it [Nm]; NULL: not known */
    const double *wrench;  /* (6,) force [N] and torque [Nm] of the tool on its mount, tool axes */
} moc_measurement;

const char *moc_reason(moc_stop reason);

/* Dry friction (n,) [Nm] of the brakes in a stop, once a period; zero while the trocar presses the shaft hard. */
void moc_guard_hold(const moc_guard *g, const moc_arm *arm, const double *wrench, moc_watch *w, double *friction);

/* --- the whole controller (step.c) --- */

/* What stays the same in a run. */
typedef struct {
    const moc_arm *arm;
    const moc_law *law;
    const moc_supervision *supervision;
    const moc_guard *guard; /* NULL: no safety filter; measurements are believed, and nothing stops the arm */
    double tolerance;       /* of moc_solve_exact [rad/s] */
} moc_controller;

/* What comes in at a tick. */
typedef struct {
    moc_measurement measured;
    moc_reference ref;
    moc_trocar trocar;
    const double *x_d; /* velocity (n,) that the third level is to follow [rad/s]; NULL: it climbs mu */
} moc_input;

/* What one arm's controller remembers. */
typedef struct {
    moc_memory memory;
    moc_watch watch;
    moc_terms terms;                /* of the last tick, as are the next ones */
    moc_problem problem;            /* where the law has a third level */
    double told[3];                 /* the tip's reference [m] */
    double tau[MOC_MAX_JOINTS];     /* of levels 1 and 2, less r; after moc_finish what it returned [Nm] */
    moc_fault fault;                /* of the answer */
    double x[MOC_MAX_JOINTS];       /* what the third level followed [rad/s] */
    double answer[MOC_MAX_JOINTS];  /* of moc_step: x of moc_solve_exact, its multipliers and status */
    double y[6];
    moc_status status;
    double sent[MOC_MAX_JOINTS];    /* what the last moc_finish returned [Nm] */
    moc_stop reason;                /* the first one stays */
    unsigned begun;                 /* MOC_BEGUN once moc_start has been called */
} moc_state;

#define MOC_BEGUN 0x6d6f6331u

/* Forget all, and begin at a measurement; m->applied is the torque that acts now. Returns MOC_RUNNING, or
 * MOC_STOP_NOT_STARTED where a number is not finite or a torque beyond its limit. */
moc_stop moc_start(const moc_controller *c, const moc_measurement *m, moc_state *state);

/* The first half of a control period: the measurement is checked, then come the arm's terms, levels 1 and 2, and the
 * subproblem, state->problem, for any solver in any language.
 *
 * measured.applied: the torque that acted in the last period, where that is not the one that was sent; NULL: it is.
 * Returns MOC_RUNNING, or why the arm is stopped: no solver is needed then. */
moc_stop moc_begin(const moc_controller *c, const moc_input *in, moc_state *state);

/* The second half: the answer (NULL: the law has no third level, or the arm is stopped) is checked, and replaced where
 * it is refused; then come level 3 and the safety filter. tau (n,) is the torque to send, finite and within the limits
 * of c->guard whatever was measured.
 *
 * Returns MOC_RUNNING, or why the arm is stopped: tau then carries its weight in the last pose believed, and the drives
 * have to brake, with the dry friction of moc_guard_hold. Only moc_start ends a stop; before it tau is zero. */
moc_stop moc_finish(const moc_controller *c, const moc_answer *answer, moc_state *state, double *tau);

/* Both, with moc_solve_exact between them. What comes in and what goes out must not overlap. */
moc_stop moc_step(const moc_controller *c, const moc_input *in, moc_state *state, double *tau);

#endif
