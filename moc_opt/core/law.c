/* The law (Su et al. 2019, docs/method.md) and the subproblem.
 *
 *   tau = h + J_T^T F_T + (I - J_T^T Jbar_T^T) J_W^T F_W + tau_ff - r + s M Z^T (Z M Z^T)^-1 Z tau_0,
 *   tau_0 = K_N2 (x - v) - D_N2 v.
 * r, s, Z: external, share, Z of moc_memory. F_T, F_W: see moc_tracking_torque. Jbar_T, tau_ff: see add_dynamic. */
#include "vec.h"

#define STRAIGHT 1e-3  /* add_dynamic drops one of the wrist's two rows if it is shorter than this * (the other) */
#define SHAFT_PULL 0.1 /* [m^3]. moc_shaft_push is at most SHAFT_PULL / mu_shaft (mu_shaft: see moc_terms) */
#define SHAFT_LOST 0.1 /* moc_shaft_push is largest near mu_shaft = SHAFT_LOST shaft_margin */
#define BOX_OPENS 3.0  /* the bounds on x are widest for mu_shaft <= (1 - 1/BOX_OPENS) shaft_margin */

typedef struct {
    double distance; /* |P_t - X| [m] */
    double e[3];     /* (P_t - X) / |P_t - X| */
    double closing;  /* e^T (dP_t - dX) [m/s] */
    double turn[3];  /* de/dt = (I - e e^T)(dP_t - dX) / |P_t - X| [1/s] */
} line;

static line shaft_line(const double X[3], const double dX[3], const moc_trocar *trocar)
{
    line s;
    for (int i = 0; i < 3; i++) {
        s.e[i] = trocar->P[i] - X[i];
        s.turn[i] = trocar->dP[i] - dX[i];
    }
    s.distance = normalise3(s.e);
    s.closing = dot3(s.e, s.turn);
    for (int i = 0; i < 3; i++)
        s.turn[i] = (s.turn[i] - s.closing * s.e[i]) / s.distance;
    return s;
}

void moc_desired_wrist(const double X[3], const double dX[3], const moc_trocar *trocar, double span, double N_d[3],
                       double dN_d[3])
{
    line s = shaft_line(X, dX, trocar);
    for (int i = 0; i < 3; i++) {
        N_d[i] = X[i] + span * s.e[i];
        dN_d[i] = dX[i] + span * s.turn[i];
    }
}

/* tau += scale J^T F */
static void add_force(int n, double J[][MOC_MAX_JOINTS], double scale, const double F[3], double *tau)
{
    for (int j = 0; j < n; j++)
        tau[j] += scale * (J[0][j] * F[0] + J[1][j] * F[1] + J[2][j] * F[2]);
}

static void times(int n, double J[][MOC_MAX_JOINTS], const double *v, double out[3])
{
    for (int i = 0; i < 3; i++)
        out[i] = dot(n, J[i], v);
}

/* Compute ddN_d of N_d = X + L e for a trocar without acceleration. With w = P_t - X = |w| e, and ' for d/dt:
 * e'' = (I - e e^T)(w'' - 2 |w|' e') / |w| - |e'|^2 e. */
static void desired_wrist_acceleration(const line *s, double span, const double ddX_d[3], double out[3])
{
    double bend[3], square = dot3(s->turn, s->turn); /* w'' - 2 |w|' e' */
    for (int i = 0; i < 3; i++)
        bend[i] = -ddX_d[i] - 2.0 * s->closing * s->turn[i];
    double along = dot3(s->e, bend);
    for (int i = 0; i < 3; i++)
        out[i] = ddX_d[i] + span * ((bend[i] - along * s->e[i]) / s->distance - square * s->e[i]);
}

/* Add the wrist's torque (only with MOC_DYNAMIC), and tau_ff = A5^T (A5 M^-1 A5^T)^-1 a (Khatib 1987, eq. 51):
 *
 *   tau += (I - J_T^T Jbar_T^T) tau_W + tau_ff,  Jbar_T = M^-1 J_T^T (J_T M^-1 J_T^T)^-1,
 *   a = [ddX_d - dJ_T v; b^T (ddN_d - dJ_W v)], or 0 without a feed-forward.
 *
 * A5 = [J_T; b^T J_W]. The columns of b (3, 2) are across the shaft. M = H H^T (Cholesky). `rows` has A5 H^-T, which is
 * orthogonalized (A5 M^-1 A5^T would have the square of its condition number), and below it (H^-1 tau_W)^T.
 * With a straight elbow, the wrist cannot be accelerated in one direction. tau_ff leaves out this direction. */
static void add_dynamic(const moc_law *law, int n, moc_terms *t, const double *ddX_d, const double *ddN_d,
                        const double *tau_W, double *tau)
{
    enum { TAU_W = 5 };
    double H[MOC_MAX_JOINTS][MOC_MAX_JOINTS], inverse[MOC_MAX_JOINTS], rows[6][MOC_MAX_JOINTS], b[2][3];
    double column[MOC_MAX_JOINTS][6], a[6] = {0.0}, c[6]; /* tau += H sum(c_i rows_i) */

    cholesky(n, t->M, H, inverse);
    across(t->u, b);
    five_rows(n, t->A, b, rows);
    memcpy(rows[TAU_W], tau_W, (unsigned)n * sizeof *tau_W);
    for (int i = 0; i < n; i++) { /* multiply the rows by H^-T */
        for (int k = 0; k < 6; k++)
            column[i][k] = rows[k][i];
        for (int j = 0; j < i; j++)
            for (int k = 0; k < 6; k++)
                column[i][k] -= H[i][j] * column[j][k];
        for (int k = 0; k < 6; k++)
            rows[k][i] = column[i][k] *= inverse[i];
    }
    for (int i = 0; i < 3 && law->feedforward; i++) {
        double gap = ddN_d[i] - t->drift[3 + i];
        a[i] = ddX_d[i] - t->drift[i];
        a[3] += b[0][i] * gap;
        a[4] += b[1][i] * gap;
    }
    for (int i = 0; i < 6; i++) { /* make the tip's rows orthonormal, the others orthogonal to them */
        for (int k = 0; k < i && k < 3; k++) {
            double along = dot(n, rows[k], rows[i]);
            a[i] -= along * c[k];
            for (int j = 0; j < n; j++)
                rows[i][j] -= along * rows[k][j];
        }
        if (i < 3) {
            double shrink = 1.0 / sqrt(dot(n, rows[i], rows[i]));
            c[i] = a[i] * shrink;
            for (int j = 0; j < n; j++)
                rows[i][j] *= shrink;
        }
    }
    /* a Jacobi rotation (Golub and Van Loan, 8.5.2) makes the wrist's two rows orthogonal */
    double product = dot(n, rows[3], rows[4]), squares = dot(n, rows[3], rows[3]) - dot(n, rows[4], rows[4]);
    double size = fabs(squares) + sqrt(squares * squares + 4.0 * product * product);
    double tangent = size > 0.0 ? copysign(2.0, squares) * product / size : 0.0, third = a[3];
    a[3] += tangent * a[4];
    a[4] -= tangent * third;
    for (int j = 0; j < n; j++) {
        third = rows[3][j];
        rows[3][j] += tangent * rows[4][j];
        rows[4][j] -= tangent * third;
    }
    double one = dot(n, rows[3], rows[3]), other = dot(n, rows[4], rows[4]);
    double least = STRAIGHT * STRAIGHT * larger(one, other);
    c[3] = one > least ? a[3] / one : 0.0;
    c[4] = other > least ? a[4] / other : 0.0;
    c[TAU_W] = law->projector == MOC_DYNAMIC;
    for (int k = 0; k < n; k++) {
        double sum = 0.0;
        for (int i = 0; i < 6; i++)
            sum += c[i] * rows[i][k];
        for (int i = k; i < n; i++)
            tau[i] += H[i][k] * sum;
    }
}

/* tau += (I - J^T G) tau_W. MOC_STATIC: G is pinv(J)^T. MOC_AS_PUBLISHED: G is J. */
static void add_at_rest(moc_projector projector, int n, double J[][MOC_MAX_JOINTS], const double *tau_W, double *tau)
{
    double at_tip[3], gram[3][MOC_MAX_JOINTS], factor[3][MOC_MAX_JOINTS], diagonal[3];

    times(n, J, tau_W, at_tip);
    if (projector == MOC_STATIC) {
        for (int i = 0; i < 3; i++)
            times(n, J, J[i], gram[i]);
        cholesky(3, gram, factor, diagonal);
        solve_factored(3, factor, diagonal, at_tip);
    }
    for (int j = 0; j < n; j++)
        tau[j] += tau_W[j];
    add_force(n, J, -1.0, at_tip, tau);
}

void moc_tracking_torque(const moc_law *law, int n, const moc_terms *terms, const moc_reference *ref,
                         const moc_trocar *trocar, double *tau)
{
    moc_terms *t = (moc_terms *)terms; /* only read */
    double(*J_T)[MOC_MAX_JOINTS] = t->A, (*J_W)[MOC_MAX_JOINTS] = t->A + 3;
    double dX[3], dN[3], F[3], ddN_d[3], tau_W[MOC_MAX_JOINTS] = {0.0}, factor = 1.0;

    times(n, J_T, t->v, dX);
    times(n, J_W, t->v, dN);

    /* Tip: F_T = K_X (X_d - X) + D_X (dX_d - dX). */
    for (int i = 0; i < 3; i++)
        F[i] = law->K_X * (ref->X[i] - t->tip[i]) + law->D_X * (ref->dX[i] - dX[i]);
    memcpy(tau, t->h, (unsigned)n * sizeof *tau);
    add_force(n, J_T, 1.0, F, tau);

    /* Shaft: F_W = factor K_N (N_d - N) + D_N (dN_d - dN), N_d = X + L e. factor is 1 or, if rcm_lambda > 0,
     * d / (rcm_lambda |N_d - N|) with the RCM error d, as in Su et al. With the angle theta between e and -u (from X
     * to N), d = |P_t - X| sin(theta) and |N_d - N| = 2 L sin(theta/2). */
    line s = shaft_line(t->tip, dX, trocar);
    if (law->rcm_lambda > 0.0)
        factor = s.distance / t->span * sqrt(larger(0.5 * (1.0 - dot3(s.e, t->u)), 0.0)) / law->rcm_lambda;
    for (int i = 0; i < 3; i++)
        F[i] = law->K_N * factor * (t->tip[i] + t->span * s.e[i] - t->wrist[i]) +
               law->D_N * (dX[i] + t->span * s.turn[i] - dN[i]);
    add_force(n, J_W, 1.0, F, tau_W);

    desired_wrist_acceleration(&s, t->span, ref->ddX, ddN_d);
    if (law->feedforward || law->projector == MOC_DYNAMIC)
        add_dynamic(law, n, t, ref->ddX, ddN_d, tau_W, tau);
    if (law->projector != MOC_DYNAMIC)
        add_at_rest(law->projector, n, J_T, tau_W, tau);
}

double moc_shaft_push(double mu_shaft, double margin)
{
    double lost = SHAFT_LOST * margin;
    return mu_shaft < margin ? SHAFT_PULL * (1.0 - mu_shaft / margin) * mu_shaft / (mu_shaft * mu_shaft + lost * lost)
                             : 0.0;
}

void moc_fill_problem(const moc_law *law, int n, const moc_terms *t, const moc_reference *ref,
                      const moc_trocar *trocar, const double *x_d, moc_problem *p)
{
    double N_d[3], gap = 0.0, push = moc_shaft_push(t->mu_shaft, law->shaft_margin);
    double nearness = larger(BOX_OPENS * (1.0 - t->mu_shaft / law->shaft_margin), 0.0);
    double wider = 1.0 + law->spare_speed * smaller(nearness, 1.0);

    p->n = n;
    memcpy(p->A, t->A, sizeof p->A);
    memcpy(p->q, t->q, sizeof p->q);
    moc_desired_wrist(t->tip, ref->dX, trocar, t->span, N_d, p->b + 3);
    for (int i = 0; i < 3; i++) {
        p->b[i] = ref->dX[i];
        gap += t->u[i] * (p->b[i] - p->b[3 + i]);
    }
    for (int i = 0; i < 3; i++) /* change v_W, b's lower half, so that u^T (v_T - v_W) = 0: the tool is rigid */
        p->b[3 + i] += gap * t->u[i];
    for (int j = 0; j < n; j++) {
        double v_max = law->v_max[j] * wider;
        p->grad_mu[j] = t->grad_mu[j];
        p->pull[j] = x_d ? law->rho / law->c2 * x_d[j] : t->grad_mu[j] + push * t->grad_mu_shaft[j];
        /* lower <= upper even if q is beyond a limit */
        p->lower[j] = smaller(larger(-law->k0 * (t->q[j] - law->q_min[j]), -v_max), v_max);
        p->upper[j] = larger(smaller(-law->k0 * (t->q[j] - law->q_max[j]), v_max), -v_max);
    }
    p->c0 = law->c0;
    p->c1 = law->c1;
    p->c2 = law->c2;
    p->rho = law->rho;
}

void moc_add_third_level(const moc_law *law, int n, const moc_terms *terms, const moc_memory *memory, const double *x,
                         double *tau)
{
    moc_terms *t = (moc_terms *)terms;
    double asked[MOC_MAX_JOINTS], MZ[MOC_MAX_JOINTS][MOC_MAX_JOINTS], along[MOC_MAX_JOINTS];
    double S[MOC_MAX_JOINTS][MOC_MAX_JOINTS], H[MOC_MAX_JOINTS][MOC_MAX_JOINTS], inverse[MOC_MAX_JOINTS];
    int r = memory->rows;

    for (int j = 0; j < n; j++)
        asked[j] = memory->share * (law->K_N2[j] * (x[j] - t->v[j]) - law->D_N2[j] * t->v[j]);
    for (int i = 0; i < r; i++) {
        for (int j = 0; j < n; j++)
            MZ[i][j] = dot(n, t->M[j], memory->Z[i]);
        along[i] = dot(n, memory->Z[i], asked);
    }
    for (int i = 0; i < r; i++)
        for (int k = 0; k < r; k++)
            S[i][k] = dot(n, memory->Z[i], MZ[k]);
    cholesky(r, S, H, inverse);
    solve_factored(r, H, inverse, along);
    for (int j = 0; j < n; j++) {
        for (int i = 0; i < r; i++)
            tau[j] += MZ[i][j] * along[i];
        tau[j] = clip(tau[j], -law->tau_max[j], law->tau_max[j]); /* NaN stays NaN: the safety filter checks tau */
    }
}

void moc_observe(int n, const moc_terms *t, int i, double tau, double gain, double period, double *integral, double *r)
{
    *integral += (tau + t->energy_slope[i] - t->gravity[i] + *r) * period;
    *r = gain * (dot(n, t->M[i], t->v) - *integral);
}
