/* Kinematics and dynamics of a serial chain (Featherstone 2008, chapter 5). Twists [lin, ang] and momenta are in world
 * axes, at the world's origin: lin is the velocity of the body's point that is there. */
#include "vec.h"

void moc_place(const moc_arm *arm, const double *q, moc_frame *frame, moc_twist *twist)
{
    static const moc_frame world = {{{1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}, {0.0, 0.0, 1.0}}, {0.0, 0.0, 0.0}};

    for (int j = 0; j < arm->n; j++) {
        const moc_joint *joint = &arm->joint[j];
        const moc_frame *before = j ? &frame[j - 1] : &world;
        moc_frame *here = &frame[j];
        double slides = joint->slides > 0.0 ? 1.0 : 0.0, angle = (1.0 - slides) * q[j];
        double cosine = cos(angle), sine = sin(angle), axis[3];

        for (int i = 0; i < 3; i++) {
            const double *row = before->R[i];
            double fixed[3]; /* the row at q_j = 0 */
            for (int c = 0; c < 3; c++)
                fixed[c] = row[0] * joint->rotation[0][c] + row[1] * joint->rotation[1][c] +
                           row[2] * joint->rotation[2][c];
            axis[i] = dot3(fixed, joint->axis);
            for (int c = 0; c < 3; c++) /* Rodrigues' formula */
                here->R[i][c] = cosine * fixed[c] + (1.0 - cosine) * axis[i] * joint->axis[c];
            add_cross(sine, fixed, joint->axis, here->R[i]);
            here->p[i] = before->p[i] + dot3(row, joint->origin) + slides * q[j] * axis[i];
        }
        for (int i = 0; i < 3; i++) {
            twist[j].ang[i] = (1.0 - slides) * axis[i];
            twist[j].lin[i] = slides * axis[i];
        }
        add_cross(1.0, here->p, twist[j].ang, twist[j].lin);
    }
}

void moc_point(const moc_arm *arm, const moc_frame *frame, const moc_twist *twist, int which, double point[3],
               double J[][MOC_MAX_JOINTS])
{
    const moc_frame *last = &frame[arm->n - 1];
    for (int i = 0; i < 3; i++)
        point[i] = last->p[i] + dot3(last->R[i], arm->point[which]);
    for (int j = 0; j < arm->n; j++) {
        double column[3] = {0.0, 0.0, 0.0};
        if (arm->moves[which][j]) {
            memcpy(column, twist[j].lin, sizeof column);
            add_cross(1.0, twist[j].ang, point, column);
        }
        for (int i = 0; i < 3; i++)
            J[i][j] = column[i];
    }
}

/* Mass, first moment and inertia (lower triangle) about the world's origin. */
typedef struct {
    double mass, moment[3], I[3][3];
} body;

static body link_in_world(const moc_joint *joint, const moc_frame *frame)
{
    const double *I = joint->inertia, share = joint->mass > 0.0 ? 1.0 / joint->mass : 0.0;
    double local[3][3] = {{I[0], I[1], I[3]}, {I[1], I[2], I[4]}, {I[3], I[4], I[5]}};
    body link = {.mass = joint->mass};

    for (int i = 0; i < 3; i++)
        link.moment[i] = joint->mass * frame->p[i] + dot3(frame->R[i], joint->moment);
    /* parallel axes: add m (|c|^2 1 - c c^T), with the centre of mass c in the world */
    double square = share * dot3(link.moment, link.moment);
    for (int i = 0; i < 3; i++) {
        double turned[3] = {dot3(frame->R[i], local[0]), dot3(frame->R[i], local[1]), dot3(frame->R[i], local[2])};
        for (int c = 0; c <= i; c++)
            link.I[i][c] = dot3(turned, frame->R[c]) - share * link.moment[i] * link.moment[c];
        link.I[i][i] += square;
    }
    return link;
}

static moc_twist momentum(const body *b, const moc_twist *twist)
{
    const double *w = twist->ang;
    moc_twist H = {{b->mass * twist->lin[0], b->mass * twist->lin[1], b->mass * twist->lin[2]},
                   {b->I[0][0] * w[0] + b->I[1][0] * w[1] + b->I[2][0] * w[2],
                    b->I[1][0] * w[0] + b->I[1][1] * w[1] + b->I[2][1] * w[2],
                    b->I[2][0] * w[0] + b->I[2][1] * w[1] + b->I[2][2] * w[2]}};
    add_cross(1.0, w, b->moment, H.lin);
    add_cross(1.0, b->moment, twist->lin, H.ang);
    return H;
}

/* dS/dt of a twist S = [lin, ang] that moves with a body of twist V = [v, w]: [w x lin + v x ang, w x ang] */
static moc_twist carried(const moc_twist *V, const moc_twist *S)
{
    moc_twist rate = {{0.0, 0.0, 0.0}, {0.0, 0.0, 0.0}};
    add_cross(1.0, V->ang, S->lin, rate.lin);
    add_cross(1.0, V->lin, S->ang, rate.lin);
    add_cross(1.0, V->ang, S->ang, rate.ang);
    return rate;
}

static double power(const moc_twist *a, const moc_twist *b)
{
    return dot3(a->lin, b->lin) + dot3(a->ang, b->ang);
}

static void add(double s, const moc_twist *what, moc_twist *to)
{
    for (int i = 0; i < 3; i++) {
        to->lin[i] += s * what->lin[i];
        to->ang[i] += s * what->ang[i];
    }
}

/* Fill M, h, gravity and energy_slope. *V is the last link's twist, *acceleration its dV/dt. */
static void dynamics(const moc_arm *arm, const moc_frame *frame, const moc_twist *S, moc_terms *t, moc_twist *V,
                     moc_twist *acceleration)
{
    int n = arm->n;
    body link[MOC_MAX_JOINTS];
    moc_twist rate[MOC_MAX_JOINTS], H[MOC_MAX_JOINTS], force[MOC_MAX_JOINTS];

    memset(V, 0, sizeof *V);
    memset(acceleration, 0, sizeof *acceleration);
    for (int k = 0; k < n; k++) { /* from the base outwards */
        link[k] = link_in_world(&arm->joint[k], &frame[k]);
        rate[k] = carried(V, &S[k]);
        add(t->v[k], &S[k], V);
        add(t->v[k], &rate[k], acceleration);
        H[k] = momentum(&link[k], V);
        /* dH/dt = I dV/dt + V x* H, with the inertia I and Featherstone's cross product x* of twist and momentum */
        force[k] = momentum(&link[k], acceleration);
        add_cross(1.0, V->ang, H[k].lin, force[k].lin);
        add_cross(1.0, V->ang, H[k].ang, force[k].ang);
        add_cross(1.0, V->lin, H[k].lin, force[k].ang);
    }
    for (int k = n - 1; k >= 0; k--) { /* from the tip inwards: link, H and force become sums over links k to n - 1 */
        if (k + 1 < n) {
            link[k].mass += link[k + 1].mass;
            for (int i = 0; i < 3; i++) {
                link[k].moment[i] += link[k + 1].moment[i];
                for (int c = 0; c <= i; c++)
                    link[k].I[i][c] += link[k + 1].I[i][c];
            }
            add(1.0, &H[k + 1], &H[k]);
            add(1.0, &force[k + 1], &force[k]);
        }
        moc_twist own = momentum(&link[k], &S[k]), weight = {{0.0}, {0.0}};
        for (int i = 0; i < 3; i++)
            weight.lin[i] = -link[k].mass * arm->gravity[i];
        add_cross(-1.0, link[k].moment, arm->gravity, weight.ang);
        for (int j = 0; j <= k; j++)
            t->M[j][k] = t->M[k][j] = power(&S[j], &own);
        t->M[k][k] += arm->joint[k].rotor;
        t->gravity[k] = power(&S[k], &weight);
        t->h[k] = power(&S[k], &force[k]) + t->gravity[k];
        t->energy_slope[k] = power(&rate[k], &H[k]);
    }
}

/* Compute dJ/dt v, the acceleration of a point of the last link at ddq = 0. */
static void point_drift(const moc_twist *V, const moc_twist *acceleration, const double point[3], double out[3])
{
    double velocity[3];
    for (int i = 0; i < 3; i++) {
        velocity[i] = V->lin[i];
        out[i] = acceleration->lin[i];
    }
    add_cross(1.0, V->ang, point, velocity);
    add_cross(1.0, acceleration->ang, point, out);
    add_cross(1.0, V->ang, velocity, out);
}

void moc_gravity(const moc_arm *arm, const double *q, double *torque)
{
    moc_frame frame[MOC_MAX_JOINTS];
    moc_twist twist[MOC_MAX_JOINTS], V, acceleration;
    moc_terms t;

    memset(t.v, 0, sizeof t.v);
    moc_place(arm, q, frame, twist);
    dynamics(arm, frame, twist, &t, &V, &acceleration);
    memcpy(torque, t.gravity, (unsigned)arm->n * sizeof *torque);
}

static void pose_of(const moc_arm *arm, const moc_frame *last, double pose[4][3])
{
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++)
            pose[k][i] = dot3(last->R[i], arm->tool[k]);
        pose[3][i] = last->p[i] + dot3(last->R[i], arm->point[MOC_TIP]);
    }
}

void moc_tool_pose(const moc_arm *arm, const double *q, double pose[4][3])
{
    moc_frame frame[MOC_MAX_JOINTS];
    moc_twist twist[MOC_MAX_JOINTS];
    moc_place(arm, q, frame, twist);
    pose_of(arm, &frame[arm->n - 1], pose);
}

void moc_kinematics(const moc_arm *arm, const double *q, moc_frame *frame, moc_twist *twist, moc_terms *t)
{
    int n = arm->n;
    memcpy(t->q, q, (unsigned)n * sizeof *q);
    moc_place(arm, q, frame, twist);
    pose_of(arm, &frame[n - 1], t->pose);
    moc_point(arm, frame, twist, MOC_TIP, t->tip, t->A);
    moc_point(arm, frame, twist, MOC_WRIST, t->wrist, t->A + 3);
    for (int i = 0; i < 3; i++)
        t->u[i] = t->tip[i] - t->wrist[i];
    t->span = normalise3(t->u);
    moc_gram gram = moc_gram_of(n, t->A);
    t->mu = moc_manipulability(n, twist, t->A, &gram, t->grad_mu);
    t->mu_shaft = moc_shaft_manipulability(n, twist, t->A, &gram, t->u, t->grad_mu_shaft);
}

moc_status moc_compute_terms(const moc_arm *arm, const double *q, const double *v, moc_terms *t)
{
    moc_frame frame[MOC_MAX_JOINTS];
    moc_twist twist[MOC_MAX_JOINTS], V, acceleration;

    if (!all_finite(arm->n, q) || !all_finite(arm->n, v))
        return MOC_NOT_FINITE;
    memcpy(t->v, v, (unsigned)arm->n * sizeof *v);
    moc_kinematics(arm, q, frame, twist, t);
    dynamics(arm, frame, twist, t, &V, &acceleration);
    point_drift(&V, &acceleration, t->tip, t->drift);
    point_drift(&V, &acceleration, t->wrist, t->drift + 3);
    return MOC_OK;
}
