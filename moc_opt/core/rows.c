/* The subproblem as a QP library takes it: 1/2 x^T P x + p^T x, and five independent equality rows.
 *
 * Tip and wrist are rigidly tied, u^T (J_T - J_W) = 0 for the direction u of the tool: the wrist's row along u repeats
 * the tip's. Left are the tip's three rows and the wrist's two across u: A5 = lift A, and A5^T y5 = A^T (lift^T y5). */
#include <string.h>

#include "tools.h"
#include "vec.h"

#define TIED 1e-7 /* sixth singular value of A over its norm, below which tip and wrist are tied (qp/residuals.py) */

/* The unit vector u with u^T (J_T - J_W) = 0, its largest entry positive; 0 where tip and wrist are not tied.
 * The adjugate of (J_T - J_W)(J_T - J_W)^T is a multiple of u u^T; its longest column is taken. */
static int tool_direction(const moc_problem *p, double u[3])
{
    double D[3][MOC_MAX_JOINTS], G[3][3] = {{0.0}}, adj[3][3], size = 0.0, apart = 0.0;
    int k = 0, most = 0, n = p->n;

    for (int i = 0; i < 3; i++)
        for (int j = 0; j < n; j++)
            D[i][j] = p->A[i][j] - p->A[3 + i][j];
    for (int i = 0; i < 6; i++)
        size += dot(n, p->A[i], p->A[i]);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            for (int c = 0; c < n; c++) /* in order, as qp/problem.py does: D may have lost two directions */
                G[i][j] += D[i][c] * D[j][c];
    adjugate3(G, adj);
    for (int i = 1; i < 3; i++)
        k = adj[i][i] > adj[k][k] ? i : k;
    memcpy(u, adj[k], 3 * sizeof *u);
    for (int i = 1; i < 3; i++)
        most = fabs(u[i]) > fabs(u[most]) ? i : most;
    double sign = u[most] < 0.0 ? -1.0 : 1.0;
    if (n < 3 || !(normalise3(u) > 0.0))
        return 0;
    for (int i = 0; i < 3; i++)
        u[i] *= sign;
    for (int j = 0; j < n; j++) {
        double gap = u[0] * D[0][j] + u[1] * D[1][j] + u[2] * D[2][j];
        apart += gap * gap;
    }
    /* [u; -u] / sqrt(2) is the left singular vector of A that belongs to its sixth singular value */
    return 0.5 * apart <= TIED * TIED * size;
}

void moc_cost(const moc_problem *p, double P[][MOC_MAX_JOINTS], double *linear)
{
    for (int i = 0; i < p->n; i++) {
        linear[i] = -p->c2 * p->pull[i];
        for (int j = 0; j <= i; j++)
            P[i][j] = i == j ? p->rho : 0.0;
        for (int k = 0; k < 6; k++) {
            double weighed = (k < 3 ? p->c0 : p->c1) * p->A[k][i];
            linear[i] -= weighed * p->b[k];
            for (int j = 0; j <= i; j++)
                P[i][j] += weighed * p->A[k][j];
        }
        for (int j = 0; j < i; j++)
            P[j][i] = P[i][j];
    }
}

int moc_equalities(const moc_problem *p, int five, double A[6][MOC_MAX_JOINTS], double b[6], double lift[6][6])
{
    double u[3], two[2][3];

    memset(lift, 0, 6 * sizeof *lift);
    if (!five || !tool_direction(p, u)) {
        memcpy(A, p->A, sizeof p->A);
        memcpy(b, p->b, sizeof p->b);
        for (int i = 0; i < 6; i++)
            lift[i][i] = 1.0;
        return 6;
    }
    across(u, two);
    five_rows(p->n, ((moc_problem *)p)->A, two, A);
    for (int i = 0; i < 3; i++) {
        b[i] = p->b[i];
        lift[i][i] = 1.0;
    }
    for (int i = 0; i < 2; i++) {
        b[3 + i] = dot3(two[i], p->b + 3);
        memcpy(lift[3 + i] + 3, two[i], sizeof two[i]);
    }
    return 5;
}
