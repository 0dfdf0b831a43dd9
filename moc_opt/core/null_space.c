/* A basis Z of ker A that varies smoothly in time, and a joint velocity x_d in ker A along which mu rises. */
#include "vec.h"

#define RATE 5.0     /* |x_d| / (length of the Newton step) [1/s] */
#define LONGEST 1.0  /* longest Newton step [rad] */
#define PROBE 1e-3   /* step of the finite difference [rad] */

bool moc_orthonormalise(int n, double Z[][MOC_MAX_JOINTS], int k, double least)
{
    for (int twice = 0; twice < 2; twice++) /* twice because of rounding */
        for (int i = 0; i < k; i++) {
            double along = dot(n, Z[i], Z[k]);
            for (int j = 0; j < n; j++)
                Z[k][j] -= along * Z[i][j];
        }
    double length = sqrt(dot(n, Z[k], Z[k]));
    if (!(length > least)) /* also catches NaN */
        return false;
    for (int j = 0; j < n; j++)
        Z[k][j] /= length;
    return true;
}

void moc_onto(int n, int rows, double Z[][MOC_MAX_JOINTS], const double *x, double *part)
{
    double sum[MOC_MAX_JOINTS] = {0.0};
    for (int k = 0; k < rows; k++) {
        double along = dot(n, Z[k], x);
        for (int j = 0; j < n; j++)
            sum[j] += along * Z[k][j];
    }
    memcpy(part, sum, (unsigned)n * sizeof *part);
}

/* Project Z on the new ker A. If the dimension has changed or a row becomes shorter than 0.5, take a new basis. */
int moc_null_space(const moc_plane *plane, int n, int rows, double Z[][MOC_MAX_JOINTS])
{
    double fresh[MOC_MAX_JOINTS][MOC_MAX_JOINTS], turned[MOC_MAX_JOINTS][MOC_MAX_JOINTS];
    int found = n - plane->rank, alike = found == rows;

    for (int i = 0; i < found; i++) {
        moc_direction(plane, n, i, fresh[i]);
        moc_orthonormalise(n, fresh, i, 0.0);
    }
    for (int i = 0; i < found && alike; i++) {
        moc_onto(n, found, fresh, Z[i], turned[i]);
        alike = moc_orthonormalise(n, turned, i, 0.5);
    }
    memcpy(Z, alike ? turned : fresh, (unsigned)found * sizeof *Z);
    return found;
}

static void slope_of(int n, const moc_law *law, const moc_terms *t, int rows, double Z[][MOC_MAX_JOINTS], double *slope)
{
    double push = moc_shaft_push(t->mu_shaft, law->shaft_margin);
    for (int j = 0; j < n; j++)
        slope[j] = t->grad_mu[j] + push * t->grad_mu_shaft[j];
    moc_onto(n, rows, Z, slope, slope);
}

/* Let g_s(q) = (I - A^+ A)(grad mu + moc_shaft_push() grad mu_shaft), z = g_s / |g_s|, and b the derivative of z^T g_s
 * along z, for this constant z. If b < 0, the Newton step along z is |g_s| / |b|, and
 * x_d = RATE min(|g_s| / |b|, LONGEST) z. If b >= 0, x_d = RATE LONGEST z. */
void moc_climb(const moc_arm *arm, const moc_law *law, const moc_terms *t, moc_memory *memory, double *x_d)
{
    double slope[MOC_MAX_JOINTS] = {0.0}, there[MOC_MAX_JOINTS] = {0.0};
    double q[MOC_MAX_JOINTS], Z[MOC_MAX_JOINTS][MOC_MAX_JOINTS];
    moc_frame frame[MOC_MAX_JOINTS];
    moc_twist twist[MOC_MAX_JOINTS];
    moc_terms ahead;
    moc_plane plane;
    int n = arm->n;

    memset(x_d, 0, (unsigned)n * sizeof *x_d);
    slope_of(n, law, t, memory->rows, memory->Z, slope);
    double steepness = sqrt(dot(n, slope, slope));
    if (!(steepness > 1e-12)) /* also catches NaN */
        return;
    for (int j = 0; j < n; j++)
        q[j] = t->q[j] + PROBE * (slope[j] / steepness);
    moc_kinematics(arm, q, frame, twist, &ahead);
    moc_eliminate(n, ahead.A, &plane);
    slope_of(n, law, &ahead, moc_null_space(&plane, n, 0, Z), Z, there);
    double bend = (dot(n, there, slope) / steepness - steepness) / PROBE;
    double step = steepness / fmax(-bend, steepness / LONGEST);
    for (int j = 0; j < n && all_finite(1, &step); j++)
        x_d[j] = RATE * step * (slope[j] / steepness);
}
