/* The safety filter checks every measurement, limits every torque, and decides when the arm has to stop.
 *
 * The table gives the condition of each reason to stop. A condition marked with * has to hold on more than `patience`
 * ticks in a row. If several conditions hold on a tick, the first in the table is reported. r_i is joint i's momentum
 * residual [Nm]: the torque that its motion implies, minus the applied torque.
 *
 *   LATE              now - newest stamp > delay of the run's first new measurement + patience [ticks]
 *   MEASUREMENT *     no new measurement, |v| > speed_factor v_max, or |q - q_b| > jump + v_max t. q_b is the last
 *                     accepted q, extrapolated with its v. t is the time since this q was accepted
 *   REPLAYED          all sensors repeat what they read k > 1 readings ago, more than n times with the same k. n is the
 *                     smaller of repeat_reading_ticks and (wrench has noise ? repeat_whole_ticks : replayed_ticks)
 *   REPEATED          (a) all q are unchanged on more than `patience` ticks in a row. Since then, the tip's reference
 *                     moved by > repeat_m, or a torque changed by > repeat_torque tau_max, or WRENCH_REPEATED holds.
 *                     If the wrench is unchanged as long, the limits are repeat_whole_m and repeat_whole_torque. Or
 *                     (b) each joint's q and v were both unchanged on more than repeat_reading_ticks ticks in total
 *   RAN_AWAY          |change of q - integral of v| over motion_s > motion_rad + motion_lag_s * (largest recent |v|)
 *   ONE_REPEATED      one q is unchanged for more than repeat_joint_ticks ticks in a row, or one q and its v for
 *                     more than repeat_reading_ticks ticks in total
 *   WRENCH_REPEATED   a noisy wrench is unchanged for more than repeat_whole_ticks ticks in a row
 *   LAGGING           like REPLAYED for one encoder, with n = repeat_reading_ticks
 *   WRENCH *          the wrench is not finite
 *   RCM, FORCE        rms RCM error or rms trocar force > limit
 *   TIP               rms tip error > tip_error
 *   UNEXPLAINED *     |r_i - running mean of r_i| > residual_torque tau_max, or |r_i| > residual_whole tau_max
 *   STUCK             q_i is unchanged on more than `patience` ticks in a row, and the integral of d_i / M_ii in this
 *                     time exceeds stuck_speed. d_i is the change of r_i, less the static friction held_i
 *   TORQUE            the controller's torque is not finite */
#include <limits.h>

#include "vec.h"

#define SHORTEST_DEPTH 0.05 /* below this depth of the tip, all force counts as the trocar's [m] */
#define GRAVITY 9.81        /* [m/s^2] */
#define FIRST_READINGS 100  /* readings that decide whether the wrench has noise */
#define LARGEST_STAMP (LLONG_MAX / 4) /* a stamp is possible if its magnitude is smaller */
#define SHRINK 0.61803398875 /* ratio of successive weights in as_number */
#define FINE 1e9             /* take_in stores x in slot floor(FINE |x|) mod slots */
#define LARGEST_NUMBER 1e6   /* largest |x| that take_in stores */

void moc_guard_start(const moc_guard *g, int n, const double *q, const double *v, long long stamp, moc_watch *w)
{
    memset(w, 0, sizeof *w);
    for (int i = 0; i < n; i++) {
        w->q[i] = w->joint[i].shown = q[i];
        w->v[i] = v[i];
        w->low[i] = smaller(q[i], g->low[i]);
        w->high[i] = larger(q[i], g->high[i]);
        w->joint[i].peak_speed = fabs(v[i]);
        w->joint[i].repeats = -1.0; /* the first reading does not count as a repeat */
    }
    for (int i = 0; i < 3; i++)
        w->point[i] = (double)NAN;
    w->first_tick[MOC_RCM] = w->first_tick[MOC_FORCE] = w->ticks = -1;
    w->now = w->newest = stamp > -LARGEST_STAMP && stamp < LARGEST_STAMP ? stamp - 1 : -1;
}

/* --- the age of a measurement --- */

/* FRESH: a new measurement. REPEAT: no new measurement, but not too late. OLD: the condition of LATE holds. */
enum { FRESH, REPEAT, OLD };

static int age(const moc_guard *g, long long stamp, moc_watch *w)
{
    bool possible = stamp > -LARGEST_STAMP && stamp < LARGEST_STAMP;
    w->now++;
    long long late = possible ? w->now - stamp : LLONG_MAX;
    if (late < 0 && late >= -g->patience) { /* stamp > now: the controller missed ticks */
        w->now = stamp;
        late = 0;
    }
    bool newer = possible && late >= 0 && stamp > w->newest;
    if (newer) {
        w->elapsed += stamp - w->newest;
        w->newest = stamp;
        if (++w->taken == 2) /* the first, from before the run, does not show the delay */
            w->delay = late;
    }
    if (w->now - w->newest > w->delay + g->patience)
        return OLD;
    return newer ? FRESH : REPEAT;
}

/* The check MEASUREMENT. Returns false for NaN. */
static bool believable(const moc_guard *g, int n, const double *q, const double *v, const moc_watch *w)
{
    double ticks = 1.0 + (double)w->bad;
    for (int i = 0; i < n; i++)
        if (!(fabs(q[i] - w->q[i]) <= g->jump + ticks * (g->v_max[i] * g->period) &&
              fabs(v[i]) <= g->speed_factor * g->v_max[i]))
            return false;
    return true;
}

/* --- repeated readings --- */

static bool same(double a, double b)
{
    return a <= b && a >= b;
}

static bool wrench_has_noise(const moc_watch *w)
{
    return w->looked >= FIRST_READINGS && !w->wrench_is_still;
}

static void compare_wrench(const double *wrench, moc_watch *w)
{
    w->wrench_repeats += 1.0;
    for (int i = 0; i < 6; i++) {
        if (!same(wrench[i], w->wrench[i]))
            w->wrench_repeats = 0.0;
        w->wrench[i] = wrench[i];
    }
    if (w->looked < FIRST_READINGS) {
        w->looked++;
        w->wrench_is_still |= w->wrench_repeats > 0.0;
    }
}

/* Returns whether RAN_AWAY applies. */
static bool compare_joint(const moc_guard *g, double q, double v, double elapsed, moc_joint_watch *j)
{
    double keep = 1.0 - smaller(elapsed / g->motion_s, 1.0);
    bool first = j->repeats < 0.0;

    if (first) /* so that drift starts at 0 */
        j->shown = q - elapsed * v;
    j->drift = keep * j->drift + (q - j->shown) - elapsed * v;
    j->peak_speed = larger(fabs(v), keep * j->peak_speed);
    bool repeats = same(q, j->shown);
    /* a joint at rest may repeat q and v */
    j->repeats_both += !first && repeats && same(v, j->speed) && j->peak_speed > 0.0;
    j->speed = v;
    if (first || repeats) {
        j->repeats += 1.0;
    } else {
        j->repeats = 0.0;
        j->at_repeat = j->mean; /* the mean, because the step of a coarse encoder disturbs the residual */
        j->unseen_speed = 0.0;
    }
    j->shown = q;
    return fabs(j->drift) > g->motion_rad + g->motion_lag_s * j->peak_speed;
}

/* Whether the tip's reference or a torque has changed too much since the encoders stopped changing (REPEATED). */
static bool asked_to_move(const moc_guard *g, int n, const double *tau, const moc_watch *w)
{
    bool whole = w->wrench_repeats > g->patience, moved = false;
    double share = whole ? g->repeat_whole_torque : g->repeat_torque, way = whole ? g->repeat_whole_m : g->repeat_m;

    for (int i = 0; i < 3; i++)
        moved |= fabs(w->tip_ref[i] - w->tip_ref_before[i]) > way;
    for (int i = 0; i < n; i++)
        moved |= fabs(tau[i] - w->joint[i].torque) > share * g->tau_max[i];
    return moved;
}

static moc_stop compare_readings(const moc_guard *g, int n, const moc_measurement *m, moc_watch *w)
{
    double elapsed = g->period * larger((double)w->elapsed, 1.0);
    double fewest = 1e18, most = 0.0, fewest_whole = 1e18, most_whole = 0.0;
    bool ran_away = false;

    w->elapsed = 0;
    compare_wrench(m->wrench, w);
    for (int i = 0; i < n; i++) {
        ran_away |= compare_joint(g, m->q[i], m->v[i], elapsed, &w->joint[i]);
        fewest = smaller(w->joint[i].repeats, fewest);
        most = larger(w->joint[i].repeats, most);
        fewest_whole = smaller(w->joint[i].repeats_both, fewest_whole);
        most_whole = larger(w->joint[i].repeats_both, most_whole);
    }
    if (fewest <= g->patience) { /* asked_to_move compares with these values */
        for (int i = 0; i < n; i++)
            w->joint[i].torque = m->applied[i];
        memcpy(w->tip_ref_before, w->tip_ref, sizeof w->tip_ref_before);
    }
    bool wrench_fails = wrench_has_noise(w) && w->wrench_repeats > g->repeat_whole_ticks;
    bool repeated = fewest > g->patience && (wrench_fails || asked_to_move(g, n, m->applied, w));
    return repeated || fewest_whole > g->repeat_reading_ticks                     ? MOC_STOP_REPEATED
           : ran_away                                                             ? MOC_STOP_RAN_AWAY
           : most > g->repeat_joint_ticks || most_whole > g->repeat_reading_ticks ? MOC_STOP_ONE_REPEATED
           : wrench_fails                                                         ? MOC_STOP_WRENCH_REPEATED
                                                                                  : MOC_RUNNING;
}

/* Store a reading in a hash table. Returns how often in a row a reading came back after the same lag [readings]. */
static inline double take_in(double number, int slots, double *numbers, double *at, moc_came_before *before)
{
    if (!(fabs(number) < LARGEST_NUMBER))
        return before->hits;
    before->readings += 1.0;
    int slot = (int)((long long)(fabs(number) * FINE) % slots);
    double lag = before->readings - at[slot];
    if (at[slot] > 0.0 && same(number, numbers[slot]) && lag > 1.0) { /* REPEATED checks lag 1 */
        before->hits = same(lag, before->lag) ? before->hits + 1.0 : 1.0;
        before->lag = lag;
    }
    numbers[slot] = number;
    at[slot] = before->readings;
    return before->hits;
}

/* Add the values to the weighted sum `number`. Equal readings give equal sums. */
static double as_number(int count, const double *values, double number)
{
    for (int i = 0; i < count; i++)
        number = SHRINK * number + values[i];
    return number;
}

/* A replayed recording agrees with the model, so that no other check finds it. */
static moc_stop came_before(const moc_guard *g, int n, const moc_measurement *m, moc_watch *w)
{
    double most = smaller(g->repeat_reading_ticks, wrench_has_noise(w) ? g->repeat_whole_ticks : g->replayed_ticks);
    double lagging = 0.0, whole = as_number(6, m->wrench, as_number(n, m->v, as_number(n, m->q, 0.0)));

    for (int i = 0; i < n && g->repeat_reading_ticks < HUGE_VAL; i++)
        lagging = larger(take_in(SHRINK * m->q[i] + m->v[i], MOC_JOINT_SLOTS, w->joint_number[i], w->joint_at[i],
                                 &w->lagging[i]), lagging);
    if (take_in(whole, MOC_SLOTS, w->number, w->at, &w->whole) > most)
        return MOC_STOP_REPLAYED;
    return lagging > g->repeat_reading_ticks ? MOC_STOP_LAGGING : MOC_RUNNING;
}

moc_stop moc_guard_believe(const moc_guard *g, int n, const moc_measurement *m, moc_watch *w)
{
    int late = g->motion && m->has_stamp ? age(g, m->stamp, w) : FRESH;
    moc_stop found = MOC_RUNNING;

    if (late == FRESH && believable(g, n, m->q, m->v, w)) {
        memcpy(w->q, m->q, (unsigned)n * sizeof *w->q);
        memcpy(w->v, m->v, (unsigned)n * sizeof *w->v);
        w->bad = 0;
        if (g->motion && m->applied) {
            found = compare_readings(g, n, m, w);
            moc_stop again = came_before(g, n, m, w);
            found = again == MOC_STOP_REPLAYED ? again : first_of(found, again);
        }
    } else {
        w->bad += w->bad < INT_MAX;
        for (int i = 0; i < n; i++)
            w->q[i] += w->v[i] * g->period;
        if (w->bad > g->patience)
            found = MOC_STOP_MEASUREMENT;
    }
    return late == OLD ? MOC_STOP_LATE : found;
}

/* --- the incision --- */

static double rcm_error(double pose[4][3], const double P[3])
{
    double line[3] = {P[0] - pose[3][0], P[1] - pose[3][1], P[2] - pose[3][2]};
    double x = dot3(pose[0], line), y = dot3(pose[1], line);
    return sqrt(x * x + y * y);
}

/* Compute the trocar's force f across the shaft [N] from force and torque at the tool's mount. Let z be the tool's
 * axis, L its length, d the depth of the tip beyond the trocar, and g a contact force at the tip. Without the tool's
 * weight, force = f + g and torque = (L - d) z x f + L z x g. Hence f = (L force - torque x z) / d. An overestimated d
 * makes f too small. The result is at least |force| - tip_force, because |g| should not exceed tip_force. *all is
 * |force|. The warning uses it too, because a load on the tool may reduce f. */
static double trocar_force(const moc_guard *g, double pose[4][3], const double P[3], const double *wrench, double *all)
{
    double depth = 0.0, L = g->tool_length, weight[2], force[2];
    for (int i = 0; i < 3; i++)
        depth += pose[2][i] * (pose[3][i] - P[i]);
    for (int i = 0; i < 2; i++) {
        weight[i] = -g->tool_mass * GRAVITY * pose[i][2];
        force[i] = wrench[i] - weight[i];
    }
    double whole = *all = sqrt(force[0] * force[0] + force[1] * force[1]);
    if (!(depth >= SHORTEST_DEPTH))
        return whole;
    /* the weight acts in the middle of the rod */
    double x = (L * force[0] - (wrench[4] - 0.5 * L * weight[0])) / depth;
    double y = (L * force[1] - (-wrench[3] - 0.5 * L * weight[1])) / depth;
    double across = sqrt(x * x + y * y);
    return larger(whole - g->tip_force, across);
}

moc_stop moc_guard_incision(const moc_guard *g, double pose[4][3], const moc_trocar *trocar, const double *wrench,
                            moc_watch *w)
{
    static const moc_stop reasons[2] = {MOC_STOP_RCM, MOC_STOP_FORCE};
    double all;
    moc_stop reason = MOC_RUNNING;

    if (!g->in_incision)
        return MOC_RUNNING;
    memcpy(w->point, trocar->P, sizeof w->point);
    w->ticks++;
    double distance = rcm_error(pose, w->point), force = trocar_force(g, pose, w->point, wrench, &all);
    w->mean_square[MOC_RCM] += g->incision_share * (distance * distance - w->mean_square[MOC_RCM]);
    if (all_finite(1, &force)) {
        w->mean_square[MOC_FORCE] += g->incision_share * (force * force - w->mean_square[MOC_FORCE]);
        w->whole_square += g->incision_share * (all * all - w->whole_square);
        w->unread = 0;
    } else {
        w->unread += w->unread < INT_MAX;
        if (w->unread > g->patience && (g->warning[MOC_FORCE] < HUGE_VAL || g->limit[MOC_FORCE] < HUGE_VAL))
            return MOC_STOP_WRENCH;
    }
    for (int k = 0; k < 2; k++) {
        double value = sqrt(w->mean_square[k]), seen = k == MOC_FORCE ? fmax(value, sqrt(w->whole_square)) : value;
        if (seen > g->warning[k]) {
            w->first_tick[k] = w->first_tick[k] < 0 ? w->ticks : w->first_tick[k];
            w->largest[k] = fmax(w->largest[k], seen);
        }
        if (reason == MOC_RUNNING && g->limit[k] < HUGE_VAL && !(value <= g->limit[k]))
            reason = reasons[k];
    }
    return reason;
}

/* --- torque and motion --- */

/* Whether joint i has clearly the largest residual. Then drive i is at fault: other causes disturb several joints. */
static bool alone(const moc_guard *g, int n, int i, const moc_watch *w)
{
    double mine = fabs(w->joint[i].residual - w->joint[i].mean) / g->tau_max[i];
    for (int k = 0; k < n; k++)
        if (k != i && fabs(w->joint[k].residual - w->joint[k].mean) > 0.7 * mine * g->tau_max[k])
            return false;
    return true;
}

/* The checks STUCK and UNEXPLAINED of the momentum residual (De Luca & Mattone 2003). */
static moc_stop weigh(const moc_guard *g, int n, const moc_terms *t, const double *tau, moc_watch *w)
{
    moc_stop found = MOC_RUNNING;

    w->weighed += w->weighed < INT_MAX;
    for (int i = 0; i < n; i++) {
        moc_joint_watch *j = &w->joint[i];
        if (w->weighed == 1)
            j->integral = dot(n, t->M[i], t->v);
        else
            moc_observe(n, t, i, tau[i], g->residual_rate, g->period, &j->integral, &j->residual);
    }
    for (int i = 0; i < n && w->weighed > 1; i++) {
        moc_joint_watch *j = &w->joint[i];
        if (w->weighed <= g->settling_ticks)
            j->mean = j->at_repeat = j->residual;
        j->mean += g->residual_share * (j->residual - j->mean);
        double beyond = j->residual - j->at_repeat;
        beyond -= clip(beyond, -g->held[i], g->held[i]);
        j->unseen_speed += g->period * beyond / t->M[i][i];
        if (j->repeats > g->patience && fabs(j->unseen_speed) > g->stuck_speed)
            found = MOC_STOP_STUCK;
        bool far = fabs(j->residual - j->mean) > g->residual_torque * g->tau_max[i] ||
                  fabs(j->residual) > g->residual_whole * g->tau_max[i];
        j->exceeded = far ? j->exceeded + 1.0 : 0.0;
        if (j->exceeded > g->patience) {
            w->cut = j->residual * tau[i] < 0.0 && alone(g, n, i, w);
            return MOC_STOP_UNEXPLAINED;
        }
    }
    return found;
}

/* --- limits of the torque --- */

/* Return the largest (torque - gravity torque) towards a wall (soft joint limit), infinite if the wall does not act. */
static double left_by_wall(const moc_guard *g, int i, double distance, double speed)
{
    /* up to this speed, the joint can still stop at the wall */
    double allowed = smaller(sqrt(2.0 * g->wall_brake * larger(distance, 0.0)), g->v_max[i]);
    if (!(distance < 0.0 || speed > allowed))
        return HUGE_VAL;
    return -g->wall_stiffness * larger(-distance, 0.0) - g->wall_damping * larger(speed - allowed, 0.0);
}

/* Compute the gravity torque, or 0 if the drives add it. Returns false if it is not finite. */
static bool weight_of(const moc_guard *g, const moc_arm *arm, const double *q, double *weight)
{
    memset(weight, 0, (unsigned)arm->n * sizeof *weight);
    if (g->carries)
        moc_gravity(arm, q, weight);
    return all_finite(arm->n, weight);
}

/* Returns the number of changed torques. */
static int limit_torque(const moc_guard *g, const moc_arm *arm, const double *before, const moc_watch *w, double *tau)
{
    double least[MOC_MAX_JOINTS], most[MOC_MAX_JOINTS], weight[MOC_MAX_JOINTS];
    bool braked = false;
    int touched = 0;

    for (int i = 0; i < arm->n; i++) {
        most[i] = left_by_wall(g, i, w->high[i] - w->q[i], w->v[i]);
        least[i] = -left_by_wall(g, i, w->q[i] - w->low[i], -w->v[i]);
        braked |= isfinite(most[i]) || isfinite(least[i]);
        if (least[i] > most[i]) /* the limits of both walls contradict each other */
            least[i] = most[i] = 0.0;
    }
    if (braked)
        weight_of(g, arm, w->q, weight);
    for (int i = 0; i < arm->n; i++) {
        double asked = tau[i];
        if (braked)
            tau[i] = larger(weight[i] + least[i], smaller(weight[i] + most[i], tau[i]));
        tau[i] = clip(tau[i], before[i] - g->torque_step, before[i] + g->torque_step);
        tau[i] = clip(tau[i], -g->tau_max[i], g->tau_max[i]);
        touched += !same(tau[i], asked);
    }
    return touched;
}

moc_stop moc_guard_follow(const moc_guard *g, const moc_arm *arm, const moc_terms *t, const double *tip,
                          const double *tip_ref, const double *before, double *tau, moc_watch *w)
{
    moc_stop reason = MOC_RUNNING, found = MOC_RUNNING;

    if (tip_ref && tip) {
        double off[3] = {tip[0] - tip_ref[0], tip[1] - tip_ref[1], tip[2] - tip_ref[2]};
        memcpy(w->tip_ref, tip_ref, sizeof w->tip_ref);
        w->tip_square += g->tip_share * (dot3(off, off) - w->tip_square);
        if (!(w->tip_square <= g->tip_error * g->tip_error))
            reason = MOC_STOP_TIP;
    }
    if (t && g->motion)
        found = weigh(g, arm->n, t, before, w);
    if (!all_finite(arm->n, tau))
        return first_of(first_of(reason, found), MOC_STOP_TORQUE);
    w->limited = limit_torque(g, arm, before, w, tau);
    return first_of(reason, found);
}

/* --- a stop --- */

void moc_guard_rest(const moc_guard *g, const moc_arm *arm, const double *before, const moc_watch *w, double *tau)
{
    double weight[MOC_MAX_JOINTS];
    bool known = weight_of(g, arm, w->q, weight); /* false: the brakes alone hold the arm */

    for (int i = 0; i < arm->n; i++) {
        double wanted = w->cut ? 0.0 : clip(weight[i], -g->tau_max[i], g->tau_max[i]);
        tau[i] = known ? before[i] + clip(wanted - before[i], -g->torque_step, g->torque_step) : 0.0;
    }
}

/* Closed brakes keep the tool pressed on the tissue, and open brakes let the arm sink under an unknown load. Hence the
 * brakes open for stop_yield_ticks at most, and again only after a further rise of the force. They never open if the
 * drives cannot carry the arm's weight. */
void moc_guard_hold(const moc_guard *g, const moc_arm *arm, const double *wrench, moc_watch *w, double *friction)
{
    double weight[MOC_MAX_JOINTS], pose[4][3];
    bool carried = true, known = weight_of(g, arm, w->q, weight);

    for (int i = 0; i < arm->n; i++) {
        weight[i] = known ? fabs(weight[i]) : 0.0;
        carried &= weight[i] <= g->tau_max[i];
    }
    if (g->in_incision && g->stop_yield < HUGE_VAL && carried && !w->cut) {
        double all;
        moc_tool_pose(arm, w->q, pose);
        double force = trocar_force(g, pose, w->point, wrench, &all);
        /* a mean, because the tool's inertia adds to the force when the stop begins */
        w->mean_force = all_finite(1, &force) ? w->mean_force + g->press_share * (force - w->mean_force) : 0.0;
        w->brakes_open = w->mean_force - w->base_force > (w->brakes_open ? 0.5 * g->stop_yield : g->stop_yield);
        w->open_ticks = w->brakes_open ? w->open_ticks + 1 : 0;
        if (w->open_ticks > g->stop_yield_ticks) {
            w->brakes_open = 0;
            w->base_force = w->mean_force;
        } else if (!w->brakes_open) {
            w->base_force = smaller(w->mean_force, w->base_force);
        }
    }
    for (int i = 0; i < arm->n; i++) {
        double beyond = w->cut ? weight[i] : larger(weight[i] - g->tau_max[i], 0.0);
        friction[i] = w->brakes_open ? 0.0 : g->stop_holding * g->tau_max[i] + 1.5 * beyond;
    }
}

const char *moc_reason(moc_stop reason)
{
#define WORDS(name, words) words,
    static const char *const all[] = {MOC_REASONS(WORDS)};
    return reason >= MOC_RUNNING && reason < MOC_STOPS ? all[reason] : "unknown";
}
