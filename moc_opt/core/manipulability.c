/* Manipulability of the tip (Yoshikawa 1985) and of the shaft, and their gradients. */
#include "vec.h"

/* largest det(S) / (mean of S_ii)^3 at which S = J J^T counts as singular */
#define SINGULAR 1e-14

moc_gram moc_gram_of(int n, double J[][MOC_MAX_JOINTS])
{
    double S[3][3];
    moc_gram gram;
    for (int i = 0; i < 3; i++)
        for (int k = 0; k <= i; k++)
            S[i][k] = S[k][i] = dot(n, J[i], J[k]);
    gram.det = adjugate3(S, gram.adj);
    double mean = (S[0][0] + S[1][1] + S[2][2]) / 3.0;
    gram.regular = gram.det > SINGULAR * mean * mean * mean;
    return gram;
}

static void column(double J[][MOC_MAX_JOINTS], int k, double out[3])
{
    for (int i = 0; i < 3; i++)
        out[i] = J[i][k];
}

/* mu = sqrt(det(J J^T)); dmu/dq_k = mu trace(dJ/dq_k pinv(J)).
 * J_k is column k of J, and ang_k the angular velocity of joint k at unit speed. In a serial chain,
 * dJ_j/dq_k = ang_min(j,k) x J_max(j,k). With the rows P_j = (J J^T)^-1 J_j of pinv(J), dmu/dq_k =
 * mu (ang_k . sum_{j>=k} J_j x P_j + J_k . sum_{j<k} P_j x ang_j). */
double moc_manipulability(int n, const moc_twist *twist, double J[][MOC_MAX_JOINTS], moc_gram *gram, double *gradient)
{
    double P[MOC_MAX_JOINTS][3], Jk[3], sum[3] = {0.0, 0.0, 0.0}, mu = sqrt(larger(gram->det, 0.0));

    if (gradient == NULL)
        return mu;
    memset(gradient, 0, (unsigned)n * sizeof *gradient);
    if (!gram->regular)
        return mu;
    for (int k = 0; k < n; k++) { /* adj = mu^2 (J J^T)^-1 */
        column(J, k, Jk);
        times3(gram->adj, Jk, P[k]);
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

/* mu_s = sqrt(pdet(C)), C = J_W (I - pinv(J_T) J_T) J_W^T, the mobility of the wrist while the tip is held.
 *
 * C u = 0 for the shaft's axis u. pdet(C), the product of the other two eigenvalues, is the same in every frame.
 * In a frame that turns with the tool, dJ_j/dq_k = ang_j x J_k - ang_k x J_j for j < k, and zero for j >= k.
 * Let f(J, P) = mu_s (J_k . sum_{j<k} P_j x ang_j - ang_k . sum_{j<k} J_j x P_j), where J_j and P_j are columns j.
 * Let N = I - pinv(J_T) J_T and K = J_W pinv(J_T).
 * Then dmu_s/dq_k = f(J_W, C^+ J_W N) + f(J_T, -K^T C^+ J_W N). */
double moc_shaft_manipulability(int n, const moc_twist *twist, double A[][MOC_MAX_JOINTS], moc_gram *gram,
                                const double u[3], double *gradient)
{
    double(*T)[MOC_MAX_JOINTS] = A, (*W)[MOC_MAX_JOINTS] = A + 3;
    double adj[3][3], mixed[3], K[3][3], C[3][3];

    memset(gradient, 0, (unsigned)n * sizeof *gradient);
    if (!gram->regular)
        return 0.0;
    double inverse = 1.0 / gram->det;
    for (int a = 0; a < 3; a++) {
        for (int b = 0; b < 3; b++)
            mixed[b] = dot(n, W[a], T[b]) * inverse;
        times3(gram->adj, mixed, K[a]);
        for (int b = 0; b <= a; b++)
            C[a][b] = C[b][a] = dot(n, W[a], W[b]) - gram->det * dot3(K[b], mixed);
    }

    /* C has rank two, so that pdet(C) is the sum of the principal 2x2 minors */
    double minors = 0.0, trace = C[0][0] + C[1][1] + C[2][2];
    for (int a = 0, b = 1; a < 3; a++, b = (b + 1) % 3)
        minors += C[a][a] * C[b][b] - C[a][b] * C[b][a];
    double mu = sqrt(larger(minors, 0.0));
    if (!(minors > SINGULAR * trace * trace))
        return mu;
    for (int a = 0; a < 3; a++) /* make C invertible */
        for (int b = 0; b < 3; b++)
            C[a][b] += trace * u[a] * u[b];
    double shrink = mu / adjugate3(C, adj);

    double turns[2][3] = {{0.0}}, pulls[2][3] = {{0.0}}; /* sums over j < k */
    for (int k = 0; k < n; k++) {
        double Jk[2][3], P[2][3], moved[3];
        column(T, k, Jk[MOC_TIP]);
        column(W, k, Jk[MOC_WRIST]);
        for (int a = 0; a < 3; a++)
            moved[a] = shrink * (Jk[MOC_WRIST][a] - dot3(K[a], Jk[MOC_TIP]));
        times3(adj, moved, P[MOC_WRIST]);
        for (int a = 0; a < 3; a++)
            P[MOC_TIP][a] = -(K[0][a] * P[MOC_WRIST][0] + K[1][a] * P[MOC_WRIST][1] + K[2][a] * P[MOC_WRIST][2]);
        for (int i = 0; i < 2; i++) {
            gradient[k] += dot3(Jk[i], pulls[i]) - dot3(twist[k].ang, turns[i]);
            add_cross(1.0, P[i], twist[k].ang, pulls[i]);
            add_cross(1.0, Jk[i], P[i], turns[i]);
        }
    }
    return mu;
}
