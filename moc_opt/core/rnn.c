/* The recurrent neural network of Su et al. 2019, integrated by Euler steps of h = dt/eps:
 *
 *   eps dx/dt = -x + clip(x - k (c0 J_T^T (J_T x - v_T) + c1 J_W^T (J_W x - v_W) + rho x - c2 pull + A^T y))
 *   eps dy/dt = k (A x - b)
 * clip: to the bounds lower and upper. c0, c1, c2, rho: those of the subproblem, times `scale`. */
#include "tools.h"
#include "vec.h"

moc_status moc_step_network(const moc_problem *p, const moc_network *net, double *x, double y[6], int *made)
{
    double c0 = net->scale * p->c0, c1 = net->scale * p->c1, c2 = net->scale * p->c2, rho = net->scale * p->rho;
    double speed = HUGE_VAL;
    int n = p->n;

    for (*made = 0; *made < net->steps && speed > net->rest; ++*made) {
        double gap[6], weight[6];
        speed = 0.0;
        for (int i = 0; i < 6; i++) {
            gap[i] = dot(n, p->A[i], x) - p->b[i];
            weight[i] = (i < 3 ? c0 : c1) * gap[i] + y[i];
        }
        for (int j = 0; j < n; j++) {
            double force = rho * x[j] - c2 * p->pull[j];
            for (int i = 0; i < 6; i++)
                force += p->A[i][j] * weight[i];
            double wanted = clip(x[j] - net->k * force, p->lower[j], p->upper[j]), move = wanted - x[j];
            speed = fmax(speed, fabs(move));
            x[j] = net->h_x == 1.0 ? wanted : x[j] + net->h_x * move;
        }
        for (int i = 0; i < 6; i++) {
            speed = fmax(speed, net->k * fabs(gap[i]));
            if (net->implicit)
                gap[i] = dot(n, p->A[i], x) - p->b[i];
            y[i] += net->h_y * net->k * gap[i];
        }
    }
    if (!all_finite(n, x) || !all_finite(6, y))
        return MOC_DOUBTFUL;
    return speed <= net->rest ? MOC_OK : MOC_UNFINISHED;
}
