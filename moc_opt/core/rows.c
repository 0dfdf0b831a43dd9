/* The subproblem as a QP library takes it: 1/2 x^T P x + p^T x, and five independent equality rows.
 *
 * Tip and wrist are rigidly tied, u^T (J_T - J_W) = 0 for the direction u of the tool: the wrist's row along u repeats
 * the tip's. Left are the tip's three rows and the wrist's two across u: A5 = lift A, and A5^T y5 = A^T (lift^T y5). */
#include <string.h>

#include "tools.h"
#include "vec.h"

#define TIED 1e-7 /* sixth singular value of A, relative to its norm, below which tip and wrist are tied (qp/residuals.py) */

/* The unit vector u with u^T (J_T - J_W) = 0, its largest entry positive; 0 where tip and wrist are not tied.
 * The adjugate of (J_T - J_W)(J_T - J_W)^T is a multiple of u u^T; its longest column is taken. */
static int tool_direction(const moc_problem *p, double u[3])
{
    double D[3][MOC_MAX_JOINTS], G[3][3], minors[3], size = 0.0, apart = 0.0;
    int k = 0, most = 0, n = p->n;

    for (int i = 0; i < 3; i++)
        for (int j = 0; j < n; j++)
            D[i][j] = p->A[i][j] - p->A[3 + i][j];
    for (int i = 0; i < 6; i++)
        size += dot(n, p->A[i], p->A[i]);
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) {
            G[i][j] = 0.0;
            for (int c = 0; c < n; c++) /* in order, as qp/problem.py does: D may have lost two directions */
                G[i][j] += D[i][c] * D[j][c];
        }
    for (int i = 0; i < 3; i++) {
        int a = (i + 1) % 3, b = (i + 2) % 3;
        minors[i] = G[a][a] * G[b][b] - G[a][b] * G[b][a];
        k = minors[i] > minors[k] ? i : k;
    }
    for (int i = 0; i < 3; i++) { /* column k of the adjugate: the cross product of the two other columns of G */
        int a = (i + 1) % 3, b = (i + 2) % 3, c = (k + 1) % 3, d = (k + 2) % 3;
        u[i] = G[a][c] * G[b][d] - G[b][c] * G[a][d];
    }
    double length = sqrt(dot3(u, u));
    if (n < 3 || !(length > 0.0))
        return 0;
    for (int i = 1; i < 3; i++)
        most = fabs(u[i]) > fabs(u[most]) ? i : most;
    length = u[most] < 0.0 ? -length : length;
    for (int i = 0; i < 3; i++)
        u[i] /= length;
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
        double tip = 0.0, wrist = 0.0;
        for (int k = 0; k < 3; k++) {
            tip += p->A[k][i] * p->b[k];
            wrist += p->A[3 + k][i] * p->b[3 + k];
        }
        linear[i] = -p->c0 * tip - p->c1 * wrist - p->c2 * p->pull[i];
        for (int j = 0; j <= i; j++) {
            double of_tip = 0.0, of_wrist = 0.0;
            for (int k = 0; k < 3; k++) {
                of_tip += p->A[k][i] * p->A[k][j];
                of_wrist += p->A[3 + k][i] * p->A[3 + k][j];
            }
            P[i][j] = P[j][i] = p->c0 * of_tip + p->c1 * of_wrist + (i == j ? p->rho : 0.0);
        }
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
