/* The module's functions for subproblem, desired wrist and dynamic programming. */
#include "python.h"
#include "vec.h"

/* --- the subproblem --- */

FUNCTION(solve_exact, {"record", READ, ROW}, {"tolerance", NUMBER}, {"x", MADE, N}, {"y", MADE, 6})
{
    moc_problem problem;
    moc_copy_problem(&problem, c->n, c->array[0], UNPACK);
    moc_status status = moc_solve_exact(&problem, c->number[1], c->array[2], c->array[3]);
    return Py_BuildValue("iOO", (int)status, c->as[2], c->as[3]);
}

FUNCTION(solve_exact_rows, {"records", READ, K, ROW}, {"tolerance", NUMBER}, {"X", WRITE, K, N},
         {"Y", WRITE, K, 6}, {"status", WRITE, K})
{
    Py_BEGIN_ALLOW_THREADS;
    for (Py_ssize_t i = 0; i < c->k; i++) {
        moc_problem problem;
        moc_copy_problem(&problem, c->n, c->array[0] + i * (11 * c->n + 10), UNPACK);
        c->array[4][i] = moc_solve_exact(&problem, c->number[1], c->array[2] + i * c->n, c->array[3] + i * 6);
    }
    Py_END_ALLOW_THREADS;
    Py_RETURN_NONE;
}

FUNCTION(step_network, {"record", READ, ROW}, {"x", WRITE, N}, {"y", WRITE, 6}, {"steps", WHOLE},
         {"h_x", NUMBER}, {"h_y", NUMBER}, {"k", NUMBER}, {"scale", NUMBER},
         {"implicit", WHOLE}, {"rest", NUMBER})
{
    moc_problem problem;
    int made = 0;
    const moc_network net = {whole(c, 3), c->number[4], c->number[5], c->number[6], c->number[7], whole(c, 8),
                             c->number[9]};
    moc_copy_problem(&problem, c->n, c->array[0], UNPACK);
    moc_status status = moc_step_network(&problem, &net, c->array[1], c->array[2], &made);
    return Py_BuildValue("ii", (int)status, made);
}

/* --- `load` fills a QP library's buffers: cost 1/2 x^T P x + p^T x, and five or six equalities ---
 *
 * The five rows are A5 = lift A: three of the tip, and two of the wrist across the tool's direction u. If y5 are the
 * multipliers of A5, lift^T y5 are those of A. */

#define TIED 1e-7 /* a tool is rigid if (sixth singular value of A) / |A|_F is at most this */

/* Compute the unit vector u with u^T D = 0, D = J_T - J_W. A nonzero column of the adjugate of D D^T is parallel to u.
 * Returns false if the tool is not rigid. */
static bool tool_direction(const moc_problem *p, double u[3])
{
    double D[3][MOC_MAX_JOINTS], G[3][3], adj[3][3], size = 0.0, apart = 0.0;
    int longest = 0, n = p->n;

    for (int i = 0; i < 3; i++)
        for (int j = 0; j < n; j++)
            D[i][j] = p->A[i][j] - p->A[3 + i][j];
    for (int i = 0; i < 6; i++)
        size += dot(n, p->A[i], p->A[i]);
    for (int i = 0; i < 3; i++)
        for (int k = 0; k <= i; k++)
            G[i][k] = G[k][i] = dot(n, D[i], D[k]);
    adjugate3(G, adj);
    for (int i = 1; i < 3; i++)
        longest = adj[i][i] > adj[longest][longest] ? i : longest;
    memcpy(u, adj[longest], 3 * sizeof *u);
    if (n < 3 || !(normalise3(u) > 0.0))
        return false;
    for (int j = 0; j < n; j++) {
        double gap = u[0] * D[0][j] + u[1] * D[1][j] + u[2] * D[2][j];
        apart += gap * gap;
    }
    /* [u; -u] / sqrt(2) is the sixth left singular vector of A */
    return 0.5 * apart <= TIED * TIED * size;
}

static void cost(const moc_problem *p, double P[][MOC_MAX_JOINTS], double *linear)
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

/* Write five rows if `five` is set and the tool is rigid, else six. Returns their number. */
static int equalities(moc_problem *p, int five, double A[6][MOC_MAX_JOINTS], double b[6], double lift[6][6])
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
    five_rows(p->n, p->A, two, A);
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

static void put(const call *c, int argument, double scale, const double *from)
{
    PyArrayObject *to = c->as[argument];
    int matrix = PyArray_NDIM(to) > 1;
    for (npy_intp i = 0; i < PyArray_DIM(to, 0); i++)
        for (npy_intp j = 0; j < (matrix ? PyArray_DIM(to, 1) : 1); j++)
            *(double *)(matrix ? PyArray_GETPTR2(to, i, j) : PyArray_GETPTR1(to, i)) =
                scale * from[matrix ? i * MOC_MAX_JOINTS + j : i];
}

/* The three signs multiply p, lower and upper. packed gets the upper triangle of P by columns, or is empty. */
FUNCTION(load, {"record", READ, ROW}, {"five", WHOLE}, {"scale", NUMBER}, {"signs", READ, 3}, {"P", STRIDED, N, N},
         {"p", STRIDED, N}, {"A", STRIDED, K, N}, {"low", STRIDED, K}, {"high", STRIDED, K}, {"lower", STRIDED, N},
         {"upper", STRIDED, N}, {"packed", STRIDED, ANY}, {"lift", WRITE, K, 6})
{
    enum { FIVE = 1, SCALE, SIGNS, COST, LINEAR, ROWS, LOW, HIGH, LOWER, UPPER, PACKED, LIFT };
    moc_problem problem;
    double P[MOC_MAX_JOINTS][MOC_MAX_JOINTS], linear[MOC_MAX_JOINTS], A[6][MOC_MAX_JOINTS], b[6], lift[6][6];
    double triangle[MOC_MAX_JOINTS * MOC_MAX_JOINTS], scale = c->number[SCALE], *signs = c->array[SIGNS];
    int n = c->n, size = 0;

    if (!all_finite(10 * n + 10, c->array[0])) /* only q, the last part, may be NaN */
        return PyErr_Format(PyExc_ValueError, "record: the subproblem holds a number that is not finite");
    moc_copy_problem(&problem, n, c->array[0], UNPACK);
    if (equalities(&problem, whole(c, FIVE), A, b, lift) != c->k)
        return PyBool_FromLong(0);
    cost(&problem, P, linear);
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++)
            triangle[size++] = P[j][i];
    if (rows_of(c, PACKED) != 0 && rows_of(c, PACKED) != size)
        return PyErr_Format(PyExc_ValueError, "packed: give %d numbers, or none", size);
    put(c, COST, scale, P[0]);
    put(c, PACKED, scale, triangle);
    put(c, LINEAR, scale * signs[0], linear);
    put(c, ROWS, 1.0, A[0]);
    put(c, LOW, 1.0, b);
    put(c, HIGH, 1.0, b);
    put(c, LOWER, signs[1], problem.lower);
    put(c, UPPER, signs[2], problem.upper);
    memcpy(c->array[LIFT], lift, (size_t)c->k * sizeof *lift);
    return PyBool_FromLong(1);
}

/* --- desired wrist, dynamic programming --- */

FUNCTION(desired_wrist, {"X", READ, 3}, {"dX", READ, 3}, {"trocar", READ, 2, 3}, {"span", NUMBER},
         {"wanted", MADE, 2, 3})
{
    const moc_trocar *trocar = (const moc_trocar *)c->array[2];
    moc_desired_wrist(c->array[0], c->array[1], trocar, c->number[3], c->array[4], c->array[4] + 3);
    return Py_BuildValue("O", c->as[4]);
}

FUNCTION(advance, {"branches", WHOLE}, {"q", READ, K, N}, {"slack", READ, K, N}, {"gain", READ, K},
         {"q_next", READ, ANY, N}, {"slack_next", READ, ANY, N}, {"value_next", READ, ANY}, {"step", READ, N},
         {"crossing", READ, ANY}, {"price", NUMBER}, {"sorted", WHOLE}, {"reach", NUMBER}, {"value", MADE, K})
{
    int branches = whole(c, 0), m = rows_of(c, 8), after = rows_of(c, 4), sorted = whole(c, 10);
    int fits = branches >= 1 && (branches & (branches - 1)) == 0 && c->k == (npy_intp)branches * m &&
               after % branches == 0 && rows_of(c, 5) == after && rows_of(c, 6) == after &&
               c->k <= INT_MAX / c->n && after <= INT_MAX / c->n && sorted >= 0 && sorted < c->n;
    for (int j = 0; j < m; j++)
        fits &= c->array[8][j] >= 0.0 && c->array[8][j] < branches;
    if (!fits)
        return PyErr_Format(PyExc_ValueError, "advance: the rows do not match the counts of branches and crossings");
    const plan_stage stage = {branches,    m,           after / branches, c->n,        sorted,
                              c->array[1], c->array[2], c->array[3],      c->array[4], c->array[5],
                              c->array[6], c->array[7], c->array[8],      c->number[9], c->number[11]};
    plan_advance(&stage, c->array[12]);
    return Py_BuildValue("O", c->as[12]);
}

PyMethodDef moc_subproblem_functions[] = {
    ENTRY(core, solve_exact), ENTRY(core, solve_exact_rows), ENTRY(core, step_network), ENTRY(core, load),
    ENTRY(core, desired_wrist), ENTRY(core, advance), {NULL, NULL, 0, NULL},
};
