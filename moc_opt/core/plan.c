/* Inverse kinematics, curves of self-motion, gradient ascent of mu, dynamic programming. */
#include "tools.h"
#include "vec.h"

#define TOLERANCE 1e-10 /* largest allowed position error of tip and wrist [m] */
#define PI 3.14159265358979323846

/* Compute the position errors of tip and wrist, and A. If grad is not NULL, compute grad mu too. Returns mu. */
static double look(const plan_task *task, const double *q, double error[6], double A[6][MOC_MAX_JOINTS], double *grad)
{
    moc_frame frame[MOC_MAX_JOINTS];
    moc_twist twist[MOC_MAX_JOINTS];
    int n = task->arm->n;

    moc_place(task->arm, q, frame, twist);
    for (int p = 0; p < 2; p++) {
        double point[3];
        moc_point(task->arm, frame, twist, p, point, A + 3 * p);
        for (int i = 0; i < 3; i++)
            error[3 * p + i] = task->target[p][i] - point[i];
    }
    moc_gram gram = moc_gram_of(n, A);
    return moc_manipulability(n, twist, A, &gram, grad);
}

static double distance(int n, const double *p, const double *q)
{
    double total = 0.0;
    for (int i = 0; i < n; i++)
        total += (p[i] - q[i]) * (p[i] - q[i]);
    return sqrt(total);
}

/* --- one pose --- */

#define LONGEST 0.25    /* longest step [rad] */
#define AT_REST 1e-9    /* a joint rests if |its entry in the unit tangent| is at most this */
#define DAMPING 4e-12   /* added to the diagonal of A A^T [m^2], because A has only rank 5 */

/* Compute the step nearest to `desired` with A step = error, by an active-set method. With damping > 0, the
 * equation holds only approximately. No joint moves towards a limit that is nearer than `near`. */
static void allowed_step(const plan_task *task, int rows, const double *q, double A[6][MOC_MAX_JOINTS],
                         const double *error, const double *desired, double damping, double near, double *step)
{
    double part[6][MOC_MAX_JOINTS]; /* A with zero columns for held joints */
    int n = task->arm->n;
    bool held[MOC_MAX_JOINTS] = {false};

    memcpy(part, A, (unsigned)rows * sizeof *part);
    for (int round = 0; round < 4 * n; round++) {
        double S[6][MOC_MAX_JOINTS], L[6][MOC_MAX_JOINTS], inverse[6], force[6], most = 0.0;
        bool left = false;
        int drawn = NONE;

        for (int i = 0; i < rows; i++) {
            for (int k = 0; k < rows; k++)
                S[i][k] = dot(n, part[i], part[k]);
            S[i][i] += damping + DAMPING;
            force[i] = error[i] - dot(n, part[i], desired);
        }
        cholesky(rows, S, L, inverse);
        solve_factored(rows, L, inverse, force);
        for (int j = 0; j < n; j++) {
            double free = desired[j];
            for (int i = 0; i < rows; i++)
                free += A[i][j] * force[i];
            step[j] = held[j] ? 0.0 : free;
            bool outwards = signbit(free) ? q[j] <= task->low[j] + near : q[j] >= task->high[j] - near;
            if (outwards && !held[j]) {
                left = held[j] = true;
                for (int i = 0; i < rows; i++)
                    part[i][j] = 0.0;
            } else if (held[j] && !outwards && fabs(free) > most) {
                drawn = j;
                most = fabs(free);
            }
        }
        if (left)
            continue;
        if (drawn == NONE)
            return;
        held[drawn] = false;
        for (int i = 0; i < rows; i++)
            part[i][drawn] = A[i][drawn];
    }
}

/* Gauss-Newton steps with a damping proportional to the squared error (Sugihara, IEEE Trans. Robotics 27, 2011). */
double plan_place(const plan_task *task, int points, int rounds, const double *start, double *best)
{
    static const double nowhere[MOC_MAX_JOINTS];
    double q[MOC_MAX_JOINTS], A[6][MOC_MAX_JOINTS], error[6], step[MOC_MAX_JOINTS], miss = HUGE_VAL;
    int n = task->arm->n;

    memcpy(q, start, (unsigned)n * sizeof *q);
    memcpy(best, start, (unsigned)n * sizeof *best);
    for (int round = 0; round < rounds; round++) {
        look(task, q, error, A, NULL);
        double worst = largest_of(3 * points, error);
        if (worst < miss) {
            memcpy(best, q, (unsigned)n * sizeof *best);
            miss = worst;
        }
        if (worst < TOLERANCE)
            break;
        allowed_step(task, 3 * points, q, A, error, nowhere, 0.1 * dot(3 * points, error, error), 0.0, step);
        double length = largest_of(n, step);
        for (int j = 0; j < n; j++)
            q[j] = clip(q[j] + step[j] * fmin(1.0, LONGEST / length), task->low[j], task->high[j]);
    }
    return miss;
}

/* --- along a curve --- */

#define STRAIGHT 0.8 /* least cosine between the tangents before and after a step */

/* Return the longest step along the tangent, up to h, within the joint limits. *hit is the limiting joint, or NONE. */
static double room_ahead(const plan_task *task, const double *q, const double *tangent, double h, int *hit)
{
    *hit = NONE;
    for (int j = 0; j < task->arm->n; j++) {
        double limit = signbit(tangent[j]) ? task->low[j] : task->high[j], room = (limit - q[j]) / tangent[j];
        if (fabs(tangent[j]) > AT_REST && room < h) {
            h = room;
            *hit = j;
        }
    }
    return h;
}

/* Compute mu, and the unit tangent at q by projecting the previous tangent `last` on ker A. Returns the cosine
 * between both tangents. */
static double turn_tangent(const plan_task *task, const double *q, const double *last, double *tangent, double *mu)
{
    double error[6], A[6][MOC_MAX_JOINTS], Z[MOC_MAX_JOINTS][MOC_MAX_JOINTS];
    moc_plane plane;
    int n = task->arm->n;

    *mu = look(task, q, error, A, NULL);
    for (int j = 0; j < n; j++)
        for (int i = 0; i < 6 && !(task->low[j] < task->high[j]); i++)
            A[i][j] = 0.0;
    moc_eliminate(n, A, &plane);
    moc_onto(n, moc_null_space(&plane, n, 0, Z), Z, last, tangent);
    double length = sqrt(dot(n, tangent, tangent));
    for (int j = 0; j < n; j++)
        tangent[j] /= length;
    return length;
}

/* Whether the curve's start lies ahead of q within one step. `pose` is the start, brought nearest to q by whole
 * turns of its revolute joints. */
static bool closes(const plan_task *task, const double *start, const double *q, const double *tangent, double step,
                  double *pose, double *gap)
{
    double ahead = 0.0;
    bool inside = true;
    for (int i = 0; i < task->arm->n; i++) {
        double turns = task->arm->joint[i].slides > 0.0 ? 0.0 : nearbyint((q[i] - start[i]) / (2.0 * PI));
        pose[i] = start[i] + 2.0 * PI * turns;
        ahead += (pose[i] - q[i]) * tangent[i];
        inside &= pose[i] >= task->low[i] && pose[i] <= task->high[i];
    }
    *gap = distance(task->arm->n, pose, q);
    return inside && *gap <= 1.01 * step && ahead > 0.0;
}

/* Compute the curve's next pose, mu and tangent. `step` is halved until this succeeds. Returns the distance from q to
 * this pose, or 0 if no step succeeds (at a singularity of the curve). */
static double next_sample(const plan_task *task, const double *q, double step, double *tangent, double *next,
                          double *mu, int *hit)
{
    double low[MOC_MAX_JOINTS], high[MOC_MAX_JOINTS], turned[MOC_MAX_JOINTS];
    int n = task->arm->n;
    unsigned bytes = (unsigned)n * sizeof *low;
    plan_task here = *task;

    here.low = low;
    here.high = high;
    for (int halvings = 0; halvings < 10; halvings++) {
        double ahead = room_ahead(task, q, tangent, step, hit);
        memcpy(low, task->low, bytes);
        memcpy(high, task->high, bytes);
        if (*hit != NONE) /* fix this joint at its limit */
            low[*hit] = high[*hit] = signbit(tangent[*hit]) ? low[*hit] : high[*hit];
        for (int j = 0; j < n; j++)
            next[j] = clip(q[j] + ahead * tangent[j], low[j], high[j]);
        if (plan_place(&here, 2, 10, next, next) < TOLERANCE &&
            turn_tangent(task, next, tangent, turned, mu) > STRAIGHT) {
            memcpy(tangent, turned, bytes);
            return distance(n, next, q);
        }
        step *= 0.5;
    }
    return 0.0;
}

int plan_follow(const plan_task *task, const double *start, const double *tangent_start, double step, int most,
                double *s, double *poses, double *mus, int *closed)
{
    int n = task->arm->n, count = 1, hit = NONE;
    unsigned bytes = (unsigned)n * sizeof *poses;
    double tangent[MOC_MAX_JOINTS], closing[MOC_MAX_JOINTS], gap;

    turn_tangent(task, start, tangent_start, tangent, mus);
    memcpy(poses, start, bytes);
    s[0] = *closed = 0;
    while (count < most && hit == NONE) {
        double *q = poses + (count - 1) * n, *next = q + n;
        double way = next_sample(task, q, step, tangent, next, mus + count, &hit);
        if (way < 1e-9)
            break;
        s[count] = s[count - 1] + way;
        count++;
        if (count < most && closes(task, start, next, tangent, step, closing, &gap)) {
            count += gap > 0.1 * step; /* if gap <= 0.1 step, the start replaces `next` */
            double *end = poses + (count - 1) * n;
            memcpy(end, closing, bytes);
            s[count - 1] = s[count - 2] + distance(n, end, end - n);
            mus[count - 1] = mus[0];
            *closed = 1;
            break;
        }
    }
    return count;
}

/* --- gradient ascent of mu --- */

#define SHORTEST 1e-6  /* the ascent ends below this step [rad] */

double plan_ascend(const plan_task *task, double *q)
{
    static const double nothing[6];
    double error[6], A[6][MOC_MAX_JOINTS], grad[MOC_MAX_JOINTS], way[MOC_MAX_JOINTS], trial[MOC_MAX_JOINTS], h = 0.1;
    int n = task->arm->n;

    if (!(plan_place(task, 2, 40, q, q) < TOLERANCE))
        return -1.0;
    while (h >= SHORTEST) {
        double mu = look(task, q, error, A, grad);
        /* no joint moves towards a limit within 0.01 h, because clipping would spoil the step */
        allowed_step(task, 6, q, A, nothing, grad, 0.0, 0.01 * h, way);
        double length = sqrt(dot(n, way, way));
        for (int j = 0; j < n; j++)
            trial[j] = clip(q[j] + h / length * way[j], task->low[j], task->high[j]);
        bool higher = plan_place(task, 2, 10, trial, trial) < TOLERANCE && look(task, trial, error, A, NULL) > mu;
        if (higher)
            memcpy(q, trial, (unsigned)n * sizeof *q);
        h = higher ? fmin(2.0 * h, LONGEST) : 0.3 * h;
    }
    return look(task, q, error, A, NULL);
}

/* --- dynamic programming --- */

/* Return the largest value_next - price |motion|^2 of the branch's next poses within reach, or `best` if larger. */
static double best_in(const plan_stage *t, int pose, int branch, double best)
{
    const double *q = t->q + pose * t->n, *slack = t->slack + pose * t->n;
    int n = t->n, by = t->sorted, first = branch * t->next, end = first + t->next, beyond = end;
    double way = (t->reach + slack[by]) * (1.0 + 1e-9);

    while (first < beyond) { /* bisection */
        int middle = first + (beyond - first) / 2;
        if (t->q_next[middle * n + by] < q[by] - way)
            first = middle + 1;
        else
            beyond = middle;
    }
    for (int other = first; other < end && t->q_next[other * n + by] <= q[by] + way; other++) {
        double total = t->value_next[other];
        bool near = total > best;
        for (int a = 0; a < n && near; a++) {
            double away = fabs(q[a] - t->q_next[other * n + a]);
            near = away <= t->step[a] + slack[a] + t->slack_next[other * n + a];
            total -= t->price * away * away;
        }
        best = near ? larger(total, best) : best;
    }
    return best;
}

void plan_advance(const plan_stage *t, double *value)
{
    for (int pose = 0; pose < t->branches * t->m; pose++) {
        double best = -HUGE_VAL;
        int bits = (int)t->crossing[pose % t->m], flips = bits + 1;
        while (flips > 0 && t->gain[pose] > -HUGE_VAL) { /* flip each subset of `bits` in the branch's number */
            flips = (flips - 1) & bits;
            best = best_in(t, pose, pose / t->m ^ flips, best);
        }
        value[pose] = best + t->gain[pose];
    }
}
