/* Manipulability of the tip (Yoshikawa 1985), and of the shaft once the tip is held, each with its gradient. */
#include <string.h>

#include "vec.h"

/* Below this det(J J^T), relative to the cube of the mean of its diagonal, mu is rounding. */
#define SINGULAR 1e-14

/* A symmetric matrix [[a, b, c], [b, d, e], [c, e, f]]. */
typedef struct {
    double a, b, c, d, e, f;
} symmetric;

static symmetric gram(int n, double J[][MOC_MAX_JOINTS])
{
    return (symmetric){dot(n, J[0], J[0]), dot(n, J[0], J[1]), dot(n, J[0], J[2]),
                       dot(n, J[1], J[1]), dot(n, J[1], J[2]), dot(n, J[2], J[2])};
}

/* The adjugate, which is the inverse times the determinant; returns the determinant. */
static double adjugate(symmetric s, symmetric *adj)
{
    *adj = (symmetric){s.d * s.f - s.e * s.e, s.c * s.e - s.b * s.f, s.b * s.e - s.c * s.d,
                       s.a * s.f - s.c * s.c, s.b * s.c - s.a * s.e, s.a * s.d - s.b * s.b};
    return s.a * adj->a + s.b * adj->b + s.c * adj->c;
}

static void times(symmetric s, const double x[3], double out[3])
{
    out[0] = s.a * x[0] + s.b * x[1] + s.c * x[2];
    out[1] = s.b * x[0] + s.d * x[1] + s.e * x[2];
    out[2] = s.c * x[0] + s.e * x[1] + s.f * x[2];
}

static symmetric scaled(double s, symmetric m)
{
    return (symmetric){s * m.a, s * m.b, s * m.c, s * m.d, s * m.e, s * m.f};
}

static void column(double J[][MOC_MAX_JOINTS], int k, double out[3])
{
    for (int i = 0; i < 3; i++)
        out[i] = J[i][k];
}

double moc_yoshikawa(int n, double J[][MOC_MAX_JOINTS])
{
    symmetric unused;
    return sqrt(fmax(adjugate(gram(n, J), &unused), 0.0));
}

/* mu = sqrt(det(J J^T)); dmu/dq_k = mu trace(dJ/dq_k pinv(J)).
 *
 * In a serial chain dJ_j/dq_k = ang_min(j,k) x J_max(j,k). With the columns P_j = (J J^T)^-1 J_j of the pseudo-inverse
 * dmu/dq_k = mu (ang_k . sum_{j>=k} J_j x P_j + J_k . sum_{j<k} P_j x ang_j).
 * At a singularity mu has a kink and no gradient: zero is written, never NaN. */
double moc_manipulability(int n, const moc_twist *twist, double J[][MOC_MAX_JOINTS], double *gradient)
{
    symmetric s = gram(n, J), adj;
    double det = adjugate(s, &adj), mean = (s.a + s.d + s.f) / 3.0, mu = sqrt(fmax(det, 0.0));
    double P[MOC_MAX_JOINTS][3], Jk[3], sum[3] = {0.0, 0.0, 0.0};

    memset(gradient, 0, (unsigned)n * sizeof *gradient);
    if (!(det > SINGULAR * mean * mean * mean))
        return mu;
    for (int k = 0; k < n; k++) { /* the adjugate is the inverse times mu^2: divided by mu at the end */
        column(J, k, Jk);
        times(adj, Jk, P[k]);
        gradient[k] = dot3(Jk, sum);
        add_cross(1.0, P[k], twist[k].ang, sum);
    }
    memset(sum, 0, sizeof sum);
    for (int k = n - 1; k >= 0; k--) {
        column(J, k, Jk);
        add_cross(1.0, Jk, P[k], sum);
        gradient[k] = (gradient[k] + dot3(twist[k].ang, sum)) / mu;
    }
    return mu;
}

/* mu_s = sqrt(pdet(C)), C = J_W (I - pinv(J_T) J_T) J_W^T: how motion that leaves the tip alone moves the wrist.
 *
 * C has no part along the shaft u, so that pdet(C) is the product of its other two eigenvalues. mu mu_s is the volume
 * of the five rows of tip and shaft together: where mu_s is zero a joint speed without bound is needed to turn the
 * shaft. In the axes of the tool, which turn with ang_k, dJ_j/dq_k is zero for k <= j and ang_j x J_k - ang_k x J_j
 * else; with P_j = C^+ (J_W N)_j on the wrist's columns and -K^T P_j on the tip's, K = J_W pinv(J_T),
 * dmu_s/dq_k = mu_s sum_{wrist, tip} (J_k . sum_{j<k} P_j x ang_j - ang_k . sum_{j<k} J_j x P_j).
 * Zero where mu or mu_s has a kink. */
double moc_shaft_manipulability(int n, const moc_twist *twist, double A[][MOC_MAX_JOINTS], const double u[3],
                                double *gradient)
{
    double(*T)[MOC_MAX_JOINTS] = A, (*W)[MOC_MAX_JOINTS] = A + 3;
    symmetric tip = gram(n, T), adj;
    double det = adjugate(tip, &adj), mean = (tip.a + tip.d + tip.f) / 3.0;
    double mixed[3][3], K[3][3], C[3][3];

    memset(gradient, 0, (unsigned)n * sizeof *gradient);
    if (!(det > SINGULAR * mean * mean * mean))
        return 0.0;
    symmetric inverse = scaled(1.0 / det, adj), rest = gram(n, W);
    double whole[3][3] = {{rest.a, rest.b, rest.c}, {rest.b, rest.d, rest.e}, {rest.c, rest.e, rest.f}};
    for (int a = 0; a < 3; a++) {
        for (int b = 0; b < 3; b++)
            mixed[a][b] = dot(n, W[a], T[b]);
        times(inverse, mixed[a], K[a]);
    }
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++)
            C[a][b] = whole[a][b] - dot3(K[a], mixed[b]);

    /* Of rank two: the sum of the principal minors is the product of both eigenvalues. */
    double minors = 0.0, trace = C[0][0] + C[1][1] + C[2][2];
    for (int a = 0, b = 1; a < 3; a++, b = (b + 1) % 3)
        minors += C[a][a] * C[b][b] - C[a][b] * C[b][a];
    double mu = sqrt(fmax(minors, 0.0));
    if (!(minors > SINGULAR * trace * trace))
        return mu;
    double size = 0.5 * trace; /* fills the direction of u, which (J_W N) does not have: any number above zero */
    symmetric full = {C[0][0] + size * u[0] * u[0], C[0][1] + size * u[0] * u[1], C[0][2] + size * u[0] * u[2],
                      C[1][1] + size * u[1] * u[1], C[1][2] + size * u[1] * u[2], C[2][2] + size * u[2] * u[2]};
    inverse = scaled(1.0 / adjugate(full, &adj), adj);

    double turns[2][3] = {{0.0}}, pulls[2][3] = {{0.0}}; /* sums over j < k of J_j x P_j and P_j x ang_j */
    for (int k = 0; k < n; k++) {
        double Jk[2][3], P[2][3], moved[3];
        column(T, k, Jk[MOC_TIP]);
        column(W, k, Jk[MOC_WRIST]);
        for (int a = 0; a < 3; a++)
            moved[a] = Jk[MOC_WRIST][a] - dot3(K[a], Jk[MOC_TIP]); /* column k of J_W N */
        times(inverse, moved, P[MOC_WRIST]);
        for (int a = 0; a < 3; a++)
            P[MOC_TIP][a] =
                -(K[0][a] * P[MOC_WRIST][0] + K[1][a] * P[MOC_WRIST][1] + K[2][a] * P[MOC_WRIST][2]);
        for (int i = 0; i < 2; i++) {
            gradient[k] += mu * (dot3(Jk[i], pulls[i]) - dot3(twist[k].ang, turns[i]));
            add_cross(1.0, P[i], twist[k].ang, pulls[i]);
            add_cross(1.0, Jk[i], P[i], turns[i]);
        }
    }
    return mu;
}
